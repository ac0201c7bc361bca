"""A diagnosis in a separate process: ``python -m benchmarks.diagnosis SAMPLES REFERENCES EFFECTS GAP`` prints its cost.

The recording is M0: twenty intervals at 100 Hz, each a rest, a slew and another rest, with white noise as stated. A small
diagnosis, which is not counted, first loads the compiled code; the memory includes the recording. The effects are the first
EFFECTS of the list, with all unlisted rivals. With a GAP of 1 the bias of the first gyro steps in the middle, and causes are
searched for; with 0 there is nothing to find.
"""

import json
import sys
import time
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from diagnosis.diagnose import diagnose
from gyrocal import Attitudes, GyroStream, Interval, Recording
from gyrocal.arrays import Array
from simulator.effects import EFFECTS
from studies.peak_memory import read_peak_memory_mb

SAMPLE_S = 0.01
INTERVALS = 20
GAP_S = 300.0
SLEW = np.deg2rad(1.5)
AXES = np.vstack([np.eye(3), -np.eye(3), np.full((1, 3), 1 / np.sqrt(3)), [[np.sqrt(0.5), -np.sqrt(0.5), 0.0]]])
ARW = float(np.deg2rad(1.5e-4))
SIGMA = float(np.deg2rad(0.005))
SEED = 20260501
STEP_SIGMAS = 10.0  # sigmas of a reference: apparent turn in an interval due to the step


def build_recording(samples: int, references: int) -> Recording:
    """Build a recording of M0 with about so many samples and references."""
    rng = np.random.default_rng(SEED)
    count, references_each = max(samples // INTERVALS, 100), max(references // INTERVALS, 2)
    length, edges = count * SAMPLE_S, SAMPLE_S * np.arange(count + 1.0)
    t_s, rates, t_ref, attitudes, intervals = [], [], [], [], []
    for number in range(INTERVALS):
        start, axis = number * (length + GAP_S), AXES[number % len(AXES)]
        # The mean rate of a sample is the angle that the body gains in it.
        rates.append(np.diff(_compute_angle(edges, length))[:, None] / SAMPLE_S * axis)
        t_s.append(start + edges[:-1])
        times: Array = np.linspace(0.0, length, references_each)
        t_ref.append(start + times)
        rotation = Rotation.from_rotvec(_compute_angle(times, length)[:, None] * axis)  # as a matrix, Aᵀ of an attitude A
        error = Rotation.from_rotvec(SIGMA * rng.normal(size=(references_each, 3)))
        attitudes.append((Rotation.from_rotvec([0.3, 0.2 * number, -0.9]) * rotation * error).as_quat())
        intervals.append(Interval(f"i{number + 1}", "rest, slew, rest", start, start + length))
    noisy_rates = np.concatenate(rates)
    noisy_rates += rng.normal(size=noisy_rates.shape) * ARW / np.sqrt(SAMPLE_S)
    reference_times = np.concatenate(t_ref)
    return Recording(
        title=f"{noisy_rates.shape[0]} samples, {reference_times.size} references",
        epoch="2000-01-01T00:00:00Z",
        gyro=GyroStream(np.concatenate(t_s), noisy_rates, SAMPLE_S, ARW),
        attitudes=Attitudes(reference_times, np.concatenate(attitudes), np.full((reference_times.size, 3), SIGMA)),
        intervals=tuple(intervals),
    )


def _compute_angle(t_s: Array, length: float) -> Array:
    """Compute the angle since the start of an interval of some length, whose slew starts after a third of it, rad."""
    return np.asarray(SLEW * np.clip(t_s - length / 3, 0.0, min(60.0, length / 3)))


def add_step(recording: Recording) -> Recording:
    """Add a step of the first gyro's bias between the intervals, in the middle of all."""
    gyro, middle = recording.gyro, recording.intervals[INTERVALS // 2]
    rates = gyro.rates.copy()
    rates[gyro.t_s >= middle.start_s, 0] += STEP_SIGMAS * SIGMA / (middle.stop_s - middle.start_s)
    return replace(recording, gyro=replace(gyro, rates=rates))


def run(samples: int, references: int, effects: int, gap: int) -> dict[str, float | int | str]:
    """Measure the cost of one diagnosis."""
    library = list(EFFECTS)[:effects]
    diagnose(build_recording(2000, 40), library=library)
    recording = build_recording(samples, references)
    if gap:
        recording = add_step(recording)
    start = time.process_time()
    result = diagnose(recording, library=library)
    return {
        "samples": int(recording.gyro.t_s.size),
        "references": int(recording.attitudes.t_s.size),
        "effects": len(library),
        "gap": gap,
        "verdict": result.verdict,
        "cpu_s": time.process_time() - start,
        "peak_rss_mb": read_peak_memory_mb(),
    }


if __name__ == "__main__":
    print(json.dumps(run(*map(int, sys.argv[1:]))))
