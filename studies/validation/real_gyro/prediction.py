"""G, b and a time offset of a unit fitted to some trials, and the attitude of another predicted with them.

Trials side by side have one linear model (`diagnosis.model.unit`), linearised again about what it gives until nothing changes.
Predictions go from the first reference of every interval with motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.amplitudes import fit
from diagnosis.model.calibration import calibrated
from diagnosis.model.groups import plain_group
from diagnosis.model.linear import Member
from diagnosis.model.linearise import linearised
from diagnosis.model.recording import RecordingModel
from diagnosis.model.unit import joined, unit_model
from gyrocal import Recording
from simulator.effects.gyro import rate_lag, rate_truncation, stale_samples, time_offset
from studies.validation.real_gyro.trials import Loaded

Array = NDArray[np.float64]

ITERATIONS = 6
SETTLED = 0.1  # sigmas
DELAY_S = np.array([0.02])  # prior sigma of a delay, s; in fast motion any is far more visible than a diagnosis would weigh


@dataclass(frozen=True)
class Rung:
    """What is undone in the samples before they are used.

    Attributes
    ----------
    name : for people
    late : as what effect a late gyro is undone, late tags or a first-order lag; "" for not at all
    cut : whether readings on a lattice are taken to be cut toward zero, and put in the middle of what they stand for
    bridged : whether stale samples are bridged
    """

    name: str
    late: str = ""
    cut: bool = False
    bridged: bool = False


LATE, LAG = time_offset.EFFECT, rate_lag.EFFECT  # the same column to first order
CUT, STALE = rate_truncation.EFFECT.name, stale_samples.EFFECT.name
LAGGED = f"{LAG.name} for {LATE.name}"  # what is tried beside the last rung
LADDER = (
    Rung("M0"),
    Rung(f"+ {LATE.name}", LATE.name),
    Rung(f"+ {CUT}", LATE.name, cut=True),
    Rung(f"+ {STALE}", LATE.name, cut=True, bridged=True),
)


@dataclass(frozen=True)
class Fit:
    """G, b (rad/s) of rates without the mean of the first rest, and the gyro's delay with its sigma (s)."""

    G: Array
    bias: Array
    delay: float = 0.0
    delay_sigma: float = 0.0


def undone(one: Loaded, rung: Rung, delay: float) -> Recording:
    """A trial with a rung's effects undone and the mean of the first rest taken off, of its specific force too."""
    gyro, table = one.recording.gyro, one.recording.tables["housekeeping"]
    table = table - table[one.first_rest].mean() * (table.columns != "t_s")
    rates = one.repaired(rung.cut, rung.bridged)
    rates = np.ascontiguousarray(rates - rates[one.first_rest].mean(axis=0))
    if rung.late == LAG.name:
        rates = rates + delay * np.gradient(rates, gyro.sample_s, axis=0)
        delay = 0.0
    return replace(one.recording, gyro=replace(gyro, rates=rates, t_s=gyro.t_s - delay), tables={"housekeeping": table})


def together(trials: Sequence[Loaded], rung: Rung, now: Fit) -> tuple[RecordingModel, tuple[str, ...]]:
    """The linearisation of some trials side by side, and whose each interval is."""
    unit = joined({one.number: undone(one, rung, now.delay) for one in trials})
    return linearised(unit.recording, now.G, now.bias), unit.owner


def fitted(trials: Sequence[Loaded], rung: Rung) -> Fit:
    """G, a common b, and the delay if the rung has one, by least squares over some trials."""
    now = Fit(np.eye(3), np.zeros(3))
    for _ in range(ITERATIONS):
        model, owner = together(trials, rung, now)
        late = [replace(plain_group(model, LATE, None, model.around), scales=DELAY_S)] if rung.late else []
        found = fit(unit_model(model, owner, [], late, rivals=False), [Member(0, 0, 0)]) if late else []
        change, covariance = calibrated(model, found)
        delay, sigma = (found[0].size, found[0].sigma) if found else (0.0, 0.0)
        now = Fit(now.G + change[:9].reshape(3, 3), now.bias + change[9:], now.delay + delay, sigma)
        steps = np.abs(change) / np.sqrt(np.diag(covariance)[:12])
        if max(steps.max(), abs(delay) / sigma if found else 0.0) < SETTLED:
            break
    return now


@dataclass(frozen=True)
class Prediction:
    """Errors of the predicted attitude of one interval: times (m,) s and rotation vectors (m, 3) deg in the cameras' axes."""

    interval: str
    t_s: Array
    error: Array

    @property
    def squares(self) -> tuple[float, float]:
        """Squared error at the interval's end and mean square over its references, deg²."""
        squares = np.square(self.error).sum(axis=1)
        return float(squares[-1]), float(squares.mean())


def predicted(one: Loaded, found: Fit, rung: Rung) -> list[Prediction]:
    """The attitude over every interval with motion, from its first reference with parameters from elsewhere."""
    model = linearised(undone(one, rung, found.delay), found.G, found.bias)
    out = []
    for number, block in enumerate(model.blocks):
        interval = one.recording.intervals[block.interval]
        if interval.activity != "rest":
            error = np.rad2deg(model.residuals[model.interval_of_reference == number])
            out.append(Prediction(interval.name, one.recording.attitudes.t_s[block.references[1:]], error[1:]))
    return out
