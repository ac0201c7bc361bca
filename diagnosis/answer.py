"""The pieces of an answer: where, by which cause, how far the gap closes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]
Verdict = Literal["none", "named", "group", "partial", "unknown", "not identifiable"]
Explanations = tuple[tuple[tuple[str, ...], float], ...]  # labels of each, and its probability; the likeliest first


@dataclass(frozen=True)
class Finding:
    """One place where the recording departs from the baseline.

    Attributes
    ----------
    signal : "attitude" or "gyro stream"
    interval, axis : where; None for all of them
    window_s : since the interval's start, s
    statistic, value, p_value : the test; p already corrected for the number of tests
    text : a sentence for people
    """

    signal: str
    interval: str | None
    axis: str | None
    window_s: tuple[float, float] | None
    statistic: str
    value: float
    p_value: float
    text: str


@dataclass(frozen=True)
class Cause:
    """An effect of the best explanation.

    Attributes
    ----------
    effect, axis : which, and about which body axis
    size, unit, sigma : how large
    parameters : its other numbers, such as phase_deg or time_s
    probability : that this effect (and axis) is at work
    group : what could stand in its place, as effect:axis, itself included, the likeliest first
    group_probability : that one of the group is at work
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

    @property
    def label(self) -> str:
        """effect:axis."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes in which the named effects are linear, with G, b and the start attitudes estimated beside them.

    Attributes
    ----------
    labels : (k,) effect:axis that each belongs to
    values : (k,) in the effect's unit, as of `simulator.effects.base.Effect.amplitudes`
    covariance : (k, k)
    """

    labels: tuple[str, ...] = ()
    values: Array = field(default_factory=lambda: np.empty(0))
    covariance: Array = field(default_factory=lambda: np.empty((0, 0)))


@dataclass(frozen=True)
class Regressor:
    """What a remainder follows.

    Attributes
    ----------
    name : in words, with the axis
    p_value : of a score test in the presence of the remainder, corrected for the number of tests
    share : of the misfit beyond the stated noise that it explains
    """

    name: str
    p_value: float
    share: float


@dataclass(frozen=True)
class RemainderSummary:
    """The part of the misfit that no identified cause explains.

    Attributes
    ----------
    share, interval_90 : of the held-out misfit, and its 90 % interval
    gyro_deg_h : (3,) standard deviation of the rate error about each body axis, deg/h
    reference_deg : (3,) standard deviation of the error of the references about each body axis, deg
    time_tags_s : standard deviation of the error of the time tags, s
    rate_share : standard deviation of a rate error in proportion to the rate
    noise_factor : by which white noise is larger than stated
    side : "gyro", "reference", "time tags" or "white noise": which of them makes most of it
    time_scale_s : correlation time of that part; 0 for white noise
    regressors : what the remainder follows
    """

    share: float
    interval_90: tuple[float, float]
    gyro_deg_h: tuple[float, ...]
    reference_deg: tuple[float, ...]
    time_tags_s: float
    rate_share: float
    noise_factor: float
    side: str
    time_scale_s: float
    regressors: tuple[Regressor, ...]

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
            "regressors": [{"name": one.name, "p_value": one.p_value, "share": one.share} for one in self.regressors],
        }


@dataclass(frozen=True)
class Closure:
    """Reduction of the misfit by the causes on held-out data, from which no amplitude was estimated.

    Attributes
    ----------
    measure, split : what is compared and how the data were parted
    before, after, floor : the measure under M0, with the causes in, and what M0 has on data of its own making
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
