"""The simulated load of a cluster against closed forms."""

from dataclasses import replace

import pytest

from studies.montecarlo.cluster_load import ClusterCosts, compute_throughput_bound, simulate_cluster

COSTS = ClusterCosts(case_s=0.02, parent_task_s=2e-3, parent_case_s=1e-4, scheduler_task_s=3e-3, scheduler_case_s=2e-5)


def test_one_task_takes_the_sum_of_its_stations():
    assert simulate_cluster(COSTS, 5, 10, 10) == pytest.approx(2e-3 + 1e-3 + 3e-3 + 2e-4 + 0.2)


def test_workers_alone_take_their_share():
    free = replace(COSTS, parent_task_s=0.0, parent_case_s=0.0, scheduler_task_s=0.0, scheduler_case_s=0.0)
    assert simulate_cluster(free, 4, 10, 400) == pytest.approx(400 * 0.02 / 4)
    assert simulate_cluster(free, 4, 10, 410) == pytest.approx(11 * 10 * 0.02)  # one worker has an eleventh task


@pytest.mark.parametrize("workers", [1, 3, 30, 300])
@pytest.mark.parametrize("chunk", [1, 16, 64])
def test_a_long_study_reaches_the_bound_of_its_slowest_station(workers, chunk):
    """Filling and draining take at most the time of all tasks in flight at the slowest station, twice."""
    tasks = 40 * workers + 400
    parent, scheduler, worker = COSTS.compute_service_times(chunk)
    least = tasks * chunk / compute_throughput_bound(COSTS, workers, chunk)
    found = simulate_cluster(COSTS, workers, chunk, tasks * chunk)
    assert least <= found * (1 + 1e-9)
    assert found <= least + 2 * (2 * workers * max(parent, scheduler, worker / workers) + parent + scheduler + worker)


def test_more_workers_than_the_bound_knows_of_gain_nothing():
    """At which number another worker helps no more: the service time of a task by that of the slowest single server."""
    _, scheduler, worker = COSTS.compute_service_times(16)
    enough = round(worker / scheduler)
    half, same, double = (simulate_cluster(COSTS, count, 16, 16 * 20_000) for count in (enough // 2, enough, 2 * enough))
    assert half > 1.8 * same
    assert double > 0.95 * same
