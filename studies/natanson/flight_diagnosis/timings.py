"""Timings of slews and of the hold, which N and R leave open: broad priors, and the motion they make.

A timing is a number between zero and one, uniform there a priori. Prior ranges: slews of 0.1 to 0.6 deg/s on average (what
fits), from a jerk to all ramp, anywhere in their interval; a stay in -y forward of "about one hour"; the hold begins within
five minutes, as in `studies.natanson.flight_gap`. Timings common to all slews fit into the shortest interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal.arrays import Array
from simulator.scenario import IntervalSection
from studies.natanson.flight_gap import HOLD, MINUS_Y, YAW_INTERVALS

MEAN_RATES_DEG_S, COMMON_RATES_DEG_S, RAMPS = (0.1, 0.6), (0.17, 0.6), (0.02, 0.5)
SHORTEST_STAY_S, COMMON_STAY_S, COMMON_DELAY_S = 3000.0, (3000.0, 3900.0), 300.0
HOLD_START_S, HOLD_TRANSITION_S = 300.0, (10.0, 600.0)


@dataclass(frozen=True)
class Timings:
    """Timings that change together."""

    axis: str  # for people: the interval as N counts them, or "common" for those of all slews
    intervals: tuple[int, ...]  # that they move, counted from 0
    names: tuple[str, ...]  # of the timings

    def values(self, sections: Sequence[IntervalSection], u: Array) -> Array:
        """Timings (m,) of numbers (m,) between zero and one, s; the ramp's share has no unit, a mean rate is in deg/s."""
        moved = [sections[k] for k in self.intervals]
        if self.axis == "common":
            rate, stay = _scale_logarithmically(COMMON_RATES_DEG_S, u[1]), _scale_evenly(COMMON_STAY_S, u[3])
            delay = min(
                COMMON_DELAY_S,
                *(_compute_latest_start(section, _measure_slew_angle(section) / rate, stay) for section in moved),
            )
            return np.array([u[0] * delay, rate, _scale_evenly(RAMPS, u[2]), stay])
        (section,) = moved
        if section.hold:
            return np.array([HOLD_START_S * u[0], _scale_logarithmically(HOLD_TRANSITION_S, u[1])])
        slow, fast = MEAN_RATES_DEG_S
        duration = _scale_logarithmically(
            (_measure_slew_angle(section) / fast, min(_measure_slew_angle(section) / slow, section.stop_s - section.start_s)),
            u[1],
        )
        if len(section.slew) == 1:
            return np.array([u[0] * _compute_latest_start(section, duration), duration, _scale_evenly(RAMPS, u[2])])
        stay = _scale_evenly((SHORTEST_STAY_S, _compute_latest_start(section, duration)), u[2])
        return np.array([u[0] * _compute_latest_start(section, duration, stay), duration, stay, _scale_evenly(RAMPS, u[3])])

    def apply_timings(self, sections: Sequence[IntervalSection], u: Array) -> dict[int, IntervalSection]:
        """The intervals with these timings; their slews keep their directions."""
        values = self.values(sections, u).tolist()
        if self.axis == "common":
            delay, rate, ramp, stay = values
            return {
                k: replace_slew_timings(sections[k], delay, _measure_slew_angle(sections[k]) / rate, ramp, stay)
                for k in self.intervals
            }
        (k,) = self.intervals
        section = sections[k]
        if section.hold:
            hold = section.hold.model_copy(update={"start_s": values[0], "transition_s": values[1]})
            return {k: section.model_copy(update={"hold": hold})}
        start, duration, *stay, ramp = values
        return {k: replace_slew_timings(section, start, duration, ramp, *stay)}


TIMINGS = (
    *(Timings(f"{k + 1}", (k,), ("start_s", "duration_s", "ramp_fraction")) for k in YAW_INTERVALS),
    Timings(f"{MINUS_Y + 1}", (MINUS_Y,), ("start_s", "duration_s", "stay_s", "ramp_fraction")),
    Timings(f"{HOLD + 1}", (HOLD,), ("start_s", "transition_s")),
    Timings("common", (*YAW_INTERVALS, MINUS_Y), ("delay_s", "mean_rate_deg_s", "ramp_fraction", "stay_s")),
)


def replace_slew_timings(
    section: IntervalSection, start: float, duration: float, ramp: float, stay: float = 0.0
) -> IntervalSection:
    """An interval with other timings of its slews; the stay is the time between two of them."""
    slews = tuple(
        slew.model_copy(update={"start_s": start + j * stay, "duration_s": duration, "ramp_fraction": ramp})
        for j, slew in enumerate(section.slew)
    )
    return section.model_copy(update={"slew": slews})


def _compute_latest_start(section: IntervalSection, duration: float, stay: float = 0.0) -> float:
    """Compute the latest time at which the first slew may begin, s."""
    return section.stop_s - section.start_s - duration - (stay if len(section.slew) > 1 else 0.0)


def _measure_slew_angle(section: IntervalSection) -> float:
    return abs(section.slew[0].angle_deg)


def _scale_evenly(bounds: tuple[float, float], u: float) -> float:
    """A value of a flat prior."""
    return bounds[0] + (bounds[1] - bounds[0]) * u


def _scale_logarithmically(bounds: tuple[float, float], u: float) -> float:
    """A value of a prior that is flat in its logarithm."""
    return float(bounds[0] * (bounds[1] / bounds[0]) ** u)
