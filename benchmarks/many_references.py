"""References at 100 Hz in a process of their own: ``python -m benchmarks.many_references COUNT`` prints what they cost.

A prediction takes all of one interval, a calibration takes those of twenty. What numba compiles is loaded before by small ones,
which are not counted; the recordings are, in memory.
"""

import json
import sys
import time
from collections.abc import Callable

from benchmarks.cases import peak_rss_mb
from benchmarks.diagnosis import recording
from gyrocal import Recording, calibrate
from gyrocal.estimation.predict import Prediction, list_step_times, predict

SMALL_COUNT, ALONE_S = 2000, 2.0  # of the small ones, and how long the gyro is alone at the end


def run(count: int) -> dict[str, float | int]:
    """Cost of a prediction and of a calibration from so many references."""
    small, long, many = recording(SMALL_COUNT, SMALL_COUNT, 1), recording(count, count, 1), recording(count, count)
    calls: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
        "predict": (lambda: _predict(small), lambda: _predict(long)),
        "calibrate": (lambda: calibrate(recording(SMALL_COUNT, SMALL_COUNT)), lambda: calibrate(many)),
    }
    costs: dict[str, float | int] = {"references": int(many.attitudes.t_s.size)}
    for name, (warm, call) in calls.items():
        warm()
        cpu = time.process_time()
        call()
        costs |= {f"{name}_cpu_s": time.process_time() - cpu, f"{name}_peak_rss_mb": peak_rss_mb()}
    return costs


def _predict(one: Recording) -> Prediction:
    from_s = one.intervals[0].stop_s - ALONE_S
    return predict(one, from_s, list_step_times(one, from_s, 1.0))


if __name__ == "__main__":
    print(json.dumps(run(int(sys.argv[1]))))
