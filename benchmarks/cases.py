"""Monte Carlo cases in a separate process: ``python -m benchmarks.cases COUNT`` prints their cost as JSON.

A case is noise on gyro and references of the TRMM scenario and one iteration.
"""

import json
import sys
import time

import numpy as np

from benchmarks.streams import ENTROPY, Flight
from gyrocal import attitude
from gyrocal.arrays import Array
from gyrocal.calibration.increment_packing import compute_packed_shape
from simulator.simulate import realise
from simulator.streams import generator
from studies.calibration.shared_truth import get_workspace
from studies.peak_memory import read_peak_memory_mb

BLOCK = 1000  # cases over which processor time is measured; the least of the blocks counts


def compute_case(flight: Flight, number: int) -> Array:
    """Compute x (12,) and its sigma (12,) of one case in one pass over the samples, like an onboard calibration."""
    gyro_rng, reference_rng = (generator(ENTROPY, number, name) for name in ("gyro_noise", "reference_noise"))
    workspace = get_workspace("rates", flight.rates.shape)
    rates, quaternions = realise(flight.scenario, flight.motion, flight.rates, gyro_rng, reference_rng, out=workspace)
    packed = get_workspace("packed", compute_packed_shape(flight.problem.measurements.arcs.pieces))
    problem = flight.problem.replace_case(rates, attitude.matrix_from_quaternion(quaternions), packed)
    result = problem.iterate(flight.initial.vector, 1, look_back=False)
    return np.concatenate([result.x[1], np.sqrt(np.diag(result.P))])


def run(count: int) -> dict[str, float | int | None]:
    """Run the cases and return their cost; the largest sigma shows that each was computed."""
    flight = Flight.load_trmm()
    compute_case(flight, 0)
    blocks, wall, start = [], time.perf_counter(), time.process_time()
    block_start, largest = start, 0.0
    for number in range(count):
        largest = max(largest, float(compute_case(flight, number)[12:].max()))
        if number % BLOCK == BLOCK - 1:
            now = time.process_time()
            blocks.append((now - block_start) / BLOCK)
            block_start = now
    return {
        "cases": count,
        "wall_s": time.perf_counter() - wall,
        "cpu_ms_per_case_mean": 1e3 * (time.process_time() - start) / count,
        "cpu_ms_per_case_least": 1e3 * min(blocks) if blocks else None,
        "largest_sigma": largest,
        "peak_rss_mb": read_peak_memory_mb(),
    }


if __name__ == "__main__":
    print(json.dumps(run(int(sys.argv[1]))))
