"""A diagnosis in a process of its own: ``python -m benchmarks.diagnosis SAMPLES REFERENCES EFFECTS GAP`` prints what it costs.
With one number in place of these, COUNT, a prediction and a calibration from so many references.

The recording is M0: twenty intervals at 100 Hz, each a rest, a slew and another rest, with white noise as stated. What numba
compiles is loaded before by a small diagnosis, which is not counted; the recording itself is, in memory. The effects are the
first so many of the list, with all unlisted rivals. With a GAP of 1 the bias of the first gyro steps in the middle, and causes
are searched for; with 0 there is nothing to find.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.cases import peak_rss_mb
from diagnosis.diagnose import diagnose
from gyrocal import Attitudes, GyroStream, Interval, Recording, calibrate
from gyrocal.estimation.predict import Prediction, list_step_times, predict
from simulator.effects import EFFECTS

Array = NDArray[np.float64]

SAMPLE_S = 0.01
INTERVALS = 20
GAP_S = 300.0
SLEW = np.deg2rad(1.5)
AXES = np.vstack([np.eye(3), -np.eye(3), np.full((1, 3), 1 / np.sqrt(3)), [[np.sqrt(0.5), -np.sqrt(0.5), 0.0]]])
ARW = float(np.deg2rad(1.5e-4))
SIGMA = float(np.deg2rad(0.005))
SEED = 20260501
SMALL_COUNT, ALONE_S = 2000, 2.0  # references that compile a prediction, and how long its gyro is alone at the end
STEP_SIGMAS = 10.0  # of a reference, which the step turns the body by in an interval


def recording(samples: int, references: int, interval_count: int = INTERVALS) -> Recording:
    """A recording of M0 with about so many samples and references."""
    rng = np.random.default_rng(SEED)
    count = max(samples // interval_count, 100)
    length, each = count * SAMPLE_S, max(references // interval_count, 2)
    slew_s = min(60.0, length / 3)
    t_s, rates, t_ref, attitudes, intervals = [], [], [], [], []
    for number in range(interval_count):
        start, axis = number * (length + GAP_S), AXES[number % len(AXES)]
        own = SAMPLE_S * np.arange(count)
        # The mean rate of a sample is what the angle gains in it.
        angle = _turned(np.append(own, length), length, slew_s)
        t_s.append(start + own)
        rates.append(np.diff(angle)[:, None] / SAMPLE_S * axis)
        times = np.linspace(0.0, length, each)
        t_ref.append(start + times)
        turned = Rotation.from_rotvec(_turned(times, length, slew_s)[:, None] * axis)  # as a matrix, Aᵀ of an attitude A
        error = Rotation.from_rotvec(SIGMA * rng.normal(size=(each, 3)))
        attitudes.append((Rotation.from_rotvec([0.3, 0.2 * number, -0.9]) * turned * error).as_quat())
        intervals.append(Interval(f"i{number + 1}", "rest, slew, rest", start, start + length))
    noisy = np.concatenate(rates)
    noisy += rng.normal(size=noisy.shape) * ARW / np.sqrt(SAMPLE_S)
    when = np.concatenate(t_ref)
    return Recording(
        title=f"{noisy.shape[0]} samples, {when.size} references",
        epoch="2000-01-01T00:00:00Z",
        gyro=GyroStream(np.concatenate(t_s), noisy, SAMPLE_S, ARW),
        attitudes=Attitudes(when, np.concatenate(attitudes), np.full((when.size, 3), SIGMA)),
        intervals=tuple(intervals),
    )


def _turned(t_s: Array, length: float, slew_s: float) -> Array:
    """Angle turned since the start of an interval of some length, whose slew starts after a third of it, rad."""
    return np.asarray(SLEW * np.clip(t_s - length / 3, 0.0, slew_s))


def with_step(recording: Recording) -> Recording:
    """The recording with a step of the first gyro's bias between its intervals, in the middle of all."""
    gyro, middle = recording.gyro, recording.intervals[INTERVALS // 2]
    rates = gyro.rates.copy()
    rates[gyro.t_s >= middle.start_s, 0] += STEP_SIGMAS * SIGMA / (middle.stop_s - middle.start_s)
    return replace(recording, gyro=replace(gyro, rates=rates))


def run(samples: int, references: int, effects: int, gap: int) -> dict[str, float | int | str]:
    """Cost of one diagnosis; the silence is the longest processor time between two tellings of its progress."""
    library = list(EFFECTS)[:effects]
    diagnose(recording(2000, 40), library=library)
    one = recording(samples, references)
    one = with_step(one) if gap else one
    cpu = time.process_time()
    told = [cpu]
    found = diagnose(one, library=library, progress=lambda text, share: told.append(time.process_time()))
    told.append(time.process_time())
    return {
        "samples": int(one.gyro.t_s.size),
        "references": int(one.attitudes.t_s.size),
        "effects": len(library),
        "gap": gap,
        "verdict": found.verdict,
        "cpu_s": told[-1] - cpu,
        "silence_s": float(np.diff(told).max()),
        "peak_rss_mb": peak_rss_mb(),
    }


def run_many_references(count: int) -> dict[str, float | int]:
    """Cost of a prediction from so many references at 100 Hz in one interval, and of a calibration from as many in twenty."""
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
    numbers = [int(text) for text in sys.argv[1:]]
    print(json.dumps(run_many_references(*numbers) if len(numbers) == 1 else run(*numbers)))
