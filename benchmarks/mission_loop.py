"""The Mission Mode loop, compiled and as plain Python: ``python -m benchmarks.mission_loop SECONDS`` prints time and telemetry.

Both are the same functions, run by numba and, in a separate process with NUMBA_DISABLE_JIT, by the interpreter. This measures
the gain of compilation and checks it, since both must give the same run. They take turns, and the least time of each is kept.
"""

import json
import sys
import time
from typing import Any

from benchmarks.processes import run_module
from simulator.mission_mode.config import MissionConfig, build_period_tables
from simulator.mission_mode.flight import MissionRun, simulate_mission

SEED = 1997
AGREEMENT_DEG = 1e-9  # of any telemetered angle; rounding differs between the two
DAY = 86400.0


def fly(seconds: float) -> tuple[float, MissionRun]:
    """Simulate the calibrated configuration with telemetry once a minute; return the wall time, s, and the run."""
    config = MissionConfig(tables=build_period_tables()["postcalibration"])
    start = time.perf_counter()
    run = simulate_mission(config, seconds=seconds, seed=SEED)
    return time.perf_counter() - start, run


def run(days: float, plain_seconds: float, rounds: int) -> dict[str, Any]:
    """Measure both; an `AssertionError` if their telemetry differs.

    Parameters
    ----------
    days : length of the long compiled run
    plain_seconds : length of the runs that are compared; a run's 4 ms of tables and preparation are in it
    rounds : turns of the comparison
    """
    fly(1.0)  # compiles, or loads compiled code
    compiled_s, plain_s = float("inf"), float("inf")
    for _ in range(rounds):
        plain = run_module("benchmarks.mission_loop", plain_seconds, NUMBA_DISABLE_JIT="1")
        plain_s = min(plain_s, plain["wall_s"])
        compiled_wall_s, compiled = fly(plain_seconds)
        compiled_s = min(compiled_s, compiled_wall_s)
    difference = float(abs(compiled.telemetry.to_numpy() - plain["telemetry"]).max())
    if not difference < AGREEMENT_DEG:
        raise AssertionError(f"compiled and plain run differ by {difference:.1e} deg")
    long_s, _ = fly(days * DAY)
    return {
        "compiled_simulated_s_per_s": days * DAY / long_s,
        "plain_simulated_s_per_s": plain_seconds / plain_s,
        "plain_vs_compiled": plain_s / compiled_s,
        "difference_deg": difference,
        "days": days,
        "wall_s": long_s,
        "wall_s_30_days": long_s * 30.0 / days,
    }


if __name__ == "__main__":
    took, flown = fly(float(sys.argv[1]))
    print(json.dumps({"wall_s": took, "telemetry": flown.telemetry.to_numpy().tolist()}))
