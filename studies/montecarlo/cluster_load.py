"""Load of a cluster: how many cases a second it computes, by the costs of a case and of a task.

A task of c cases passes five stations: it is handed out by the parent, accepted by the scheduler, computed by one of W workers,
reported by the scheduler, and stored by the parent. Parent and scheduler serve one task at a time. The parent keeps
`PER_WORKER` W tasks in flight (`studies.montecarlo.backends`). This is a closed queueing network with constant service times,
whose throughput is that of its slowest station once all are filled (the asymptotic bound of operational analysis: Denning and
Buzen 1978, "The operational analysis of queueing network models").
"""

import heapq
from dataclasses import dataclass

from studies.montecarlo.backends import PER_WORKER


@dataclass(frozen=True)
class ClusterCosts:
    """Processor times of a study on a cluster, s.

    Attributes
    ----------
    case_s : a worker's, of a case
    parent_task_s, parent_case_s : the parent's, of a task and of each case in it
    scheduler_task_s, scheduler_case_s : the scheduler's, of a task and of each case in it
    """

    case_s: float
    parent_task_s: float
    parent_case_s: float
    scheduler_task_s: float
    scheduler_case_s: float

    def compute_service_times(self, chunk: int) -> tuple[float, float, float]:
        """Time that parent, scheduler and one worker spend on a task of so many cases, s."""
        parent = self.parent_task_s + chunk * self.parent_case_s
        return parent, self.scheduler_task_s + chunk * self.scheduler_case_s, chunk * self.case_s


def compute_throughput_bound(costs: ClusterCosts, workers: int, chunk: int) -> float:
    """Compute the cases a second of the slowest station: parent, scheduler, or all workers together."""
    parent, scheduler, worker = costs.compute_service_times(chunk)
    return chunk / max(parent, scheduler, worker / workers)


def simulate_cluster(costs: ClusterCosts, workers: int, chunk: int, cases: int) -> float:
    """Simulate a study on a cluster event by event; returns its duration, s.

    Half of the time of parent and scheduler is spent before a task is computed, half after. Each station serves the task that
    came first. Messages take no time.
    """
    parent, scheduler, worker = costs.compute_service_times(chunk)
    stations = [("parent", parent / 2), ("scheduler", scheduler / 2), ("worker", worker)]
    stations += [("scheduler", scheduler / 2), ("parent", parent / 2)]
    free = {"parent": [0.0], "scheduler": [0.0], "worker": [0.0] * workers}  # when each server of a station is free
    tasks = -(-cases // chunk)
    given = min(tasks, PER_WORKER * workers)
    events = [(0.0, number, 0) for number in range(given)]
    end = 0.0
    while events:
        now, task, stage = heapq.heappop(events)
        if stage == len(stations):
            end = now
            if given < tasks:
                heapq.heappush(events, (now, given, 0))
                given += 1
            continue
        station, service_s = stations[stage]
        ready = max(now, free[station][0]) + service_s
        heapq.heapreplace(free[station], ready)
        heapq.heappush(events, (ready, task, stage + 1))
    return end
