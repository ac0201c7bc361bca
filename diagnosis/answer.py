"""Parts of an answer: findings, causes, the remainder, and how much of the misfit the causes close."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd

from diagnosis.inference.levels import Levels
from gyrocal.arrays import Array

Verdict = Literal["none", "named", "group", "partial", "unknown", "not identifiable"]
Explanations = tuple[tuple[tuple[str, ...], float], ...]  # labels of each, and its probability; the likeliest first

UNDECIDED = "undecided"  # side of a remainder, or of a random error
MOST = 0.5  # share of the misfit beyond which a remainder is most of it
SAME_S = 0.005  # difference of two times that are stated as one


def label_by_character(label: str) -> str:
    """Label a random process by side and character in place of its name, and by its axis."""
    effect, separator, axis = label.partition(":")
    sides = (("reference", "references"), ("time", "time tags"))
    side = next((side for word, side in sides if effect.startswith(word)), "gyro")
    return f"{side} slow random{separator}{axis}"


def format_span(start_s: float, stop_s: float) -> str:
    """Format two times in s with as many decimals as distinguish them."""
    if stop_s - start_s < SAME_S:
        return f"{start_s:.3g} s"
    decimals = 0 if stop_s - start_s >= 10 else 1 if stop_s - start_s >= 1 else 2
    return f"{start_s:.{decimals}f} to {stop_s:.{decimals}f} s"


@dataclass(frozen=True)
class Finding:
    """One place where the recording departs from the baseline."""

    signal: str  # "attitude" or "gyro stream"
    interval: str | None  # interval, axis: where; None for all of them
    axis: str | None
    window_s: tuple[float, float] | None  # since the interval's start, s
    statistic: str  # statistic, value, p_value: the test; p already corrected for the number of tests
    value: float
    p_value: float
    text: str  # a sentence for people


@dataclass(frozen=True)
class Cause:
    """An effect of the best explanation.

    Attributes
    ----------
    effect, axis : which, and about which body axis
    size, unit, sigma : how large
    parameters : its other numbers, such as phase_deg or time_s
    probability : that this effect (and axis) is at work
    group : effects that fit in its place, as effect:axis, itself included, the likeliest first
    group_probability : that one of the group is at work, or a random error of its side and axis where no effect is named
    named : whether the effect is stated; else side, axis and character alone, whose probability it then is
    levels : side, axis and character of all candidates in its place; None for a cause that the samples show by themselves
    """

    effect: str
    axis: str | None
    size: float
    unit: str
    sigma: float
    parameters: dict[str, float | str]
    probability: float
    group: tuple[str, ...]
    group_probability: float
    levels: Levels | None = None
    named: bool = True

    @property
    def label(self) -> str:
        """effect:axis, or side and character in place of the effect."""
        label = self.effect if self.axis is None else f"{self.effect}:{self.axis}"
        return label if self.named else label_by_character(label)


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes in which the named effects are linear, estimated together with G, b and the start attitudes."""

    labels: tuple[str, ...] = ()  # (k,) effect:axis that each belongs to
    # (k,) in the effect's unit, as of `simulator.effects.base.Effect.amplitudes`
    values: Array = field(default_factory=lambda: np.empty(0))
    covariance: Array = field(default_factory=lambda: np.empty((0, 0)))  # (k, k)


@dataclass(frozen=True)
class Regressor:
    """A time series that the remainder correlates with."""

    name: str  # in words, with the axis
    p_value: float  # bound by its evidence with all other members in the model, for all candidates
    share: float  # of the held-out misfit that it closes, beside the causes and the regressors before it


@dataclass(frozen=True)
class RemainderSummary:
    """The part of the misfit that no identified cause explains."""

    share: float  # share, interval_90: of the held-out misfit, and its 90 % interval
    interval_90: tuple[float, float]
    gyro_deg_h: tuple[float, ...]  # (3,) standard deviation of the rate error about each body axis, deg/h
    reference_deg: tuple[float, ...]  # (3,) standard deviation of the error of the references about each body axis, deg
    time_tags_s: float  # standard deviation of the error of the time tags, s
    rate_share: float  # standard deviation of a rate error in proportion to the rate
    noise_factor: float  # white noise beside all members of the model, over the stated one
    side: str  # source of most of it, "gyro", "reference", "time tags" or "white noise"; or `UNDECIDED`
    time_scale_s: float  # correlation time of that part; 0 for white noise
    regressors: tuple[Regressor, ...]  # what the remainder follows

    def to_json(self) -> dict[str, Any]:
        """Return the remainder as in the documented format."""
        return {
            "share": self.share,
            "interval_90": list(self.interval_90),
            "gyro_deg_h": list(self.gyro_deg_h),
            "reference_deg": list(self.reference_deg),
            "time_tags_s": self.time_tags_s,
            "rate_share": self.rate_share,
            "noise_factor": self.noise_factor,
            "side": self.side,
            "time_scale_s": self.time_scale_s,
            "regressors": [
                {"name": regressor.name, "p_value": regressor.p_value, "share": regressor.share}
                for regressor in self.regressors
            ],
        }


@dataclass(frozen=True)
class Closure:
    """Reduction of the misfit by the causes on held-out data, from which no amplitude was estimated.

    Attributes
    ----------
    measure, split : statistic that is compared and how the data were split
    before, after, floor : the statistic under M0, with the causes in the model, and of data simulated under M0
    closed : 1 − (after − floor)/(before − floor)
    interval_90 : its 90 % interval
    by_interval : columns interval, before, after, floor
    """

    measure: str
    split: str
    before: float
    after: float
    floor: float
    closed: float
    interval_90: tuple[float, float]
    by_interval: pd.DataFrame

    def to_json(self) -> dict[str, Any]:
        """Return plain values in the documented format."""
        return {
            "measure": self.measure,
            "split": self.split,
            "before": self.before,
            "after": self.after,
            "floor": self.floor,
            "closed": self.closed,
            "interval_90": list(self.interval_90),
        }
