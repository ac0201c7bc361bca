"""Monte Carlo cases in a process of their own: ``python -m benchmarks.cases COUNT`` prints what they cost as JSON.

A case is noise on gyro and references of the TRMM scenario and one iteration. Results are kept a chunk at a time and
written, so that nothing but the code decides how memory grows.
"""

import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.streams import ENTROPY, Flight
from gyrocal import attitude
from gyrocal.calibration.increment_packing import compute_packed_shape
from simulator.simulate import realise
from simulator.streams import generator
from studies.calibration.shared_truth import get_workspace

Array = NDArray[np.float64]

CHUNK = 250
BLOCK = 1000  # cases over which processor time is taken; the least of the blocks counts
KIB = 1024


def case(flight: Flight, number: int) -> Array:
    """x (12,) and its sigma (12,) of one case: one pass over the samples, as an onboard calibration would do it."""
    gyro_rng, reference_rng = (generator(ENTROPY, number, name) for name in ("gyro_noise", "reference_noise"))
    noisy = get_workspace("rates", flight.rates.shape)
    rates, quaternions = realise(flight.scenario, flight.motion, flight.rates, gyro_rng, reference_rng, out=noisy)
    packed = get_workspace("packed", compute_packed_shape(flight.problem.measurements.arcs.pieces))
    problem = flight.problem.replace_case(rates, attitude.matrix_from_quaternion(quaternions), packed)
    result = problem.iterate(flight.initial.vector, 1, look_back=False)
    return np.concatenate([result.x[1], np.sqrt(np.diag(result.P))])


def peak_rss_mb() -> float:
    """Largest resident memory of this process, MB.

    Where the kernel tells, that of this program alone: ru_maxrss starts from the parent's, which exec does not reset.
    """
    status = Path("/proc/self/status")
    if status.exists():
        kib = next(line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return float(kib) * KIB / 1e6
    unit = 1 if sys.platform == "darwin" else KIB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def run(count: int, folder: Path) -> dict[str, float | int | None]:
    """Do the cases; chunks go to the folder."""
    flight = Flight.trmm()
    case(flight, 0)
    chunk = np.empty((min(CHUNK, count), 24))
    blocks = []
    wall, cpu = time.perf_counter(), time.process_time()
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    block = cpu
    for number in range(count):
        chunk[number % CHUNK] = case(flight, number)
        if number % CHUNK == CHUNK - 1 or number == count - 1:
            np.save(folder / f"part{number // CHUNK}.npy", chunk[: number % CHUNK + 1])
        if number % BLOCK == BLOCK - 1:
            now = time.process_time()
            blocks.append((now - block) / BLOCK)
            block = now
    total = time.process_time() - cpu
    return {
        "cases": count,
        "wall_s": time.perf_counter() - wall,
        "cpu_ms_per_case_mean": 1e3 * total / count,
        "cpu_ms_per_case_least": 1e3 * min(blocks) if blocks else None,
        "page_faults_per_case": (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - faults) / count,
        "peak_rss_mb": peak_rss_mb(),
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as parts:
        print(json.dumps(run(int(sys.argv[1]), Path(parts))))
