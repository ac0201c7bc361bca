"""Timings of slews, which N and R leave open: broad priors, and the motion they make.

A timing is a number between zero and one, uniform there a priori. Prior ranges: slews of 0.1 to 0.6 deg/s on average, from a
jerk to all ramp, anywhere in their interval; a stay in -y forward of "about one hour", at least 3000 s.
"""

from collections.abc import Sequence

from gyrocal.arrays import Array
from simulator.scenario import IntervalSection
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS

SLEWING = (*YAW_INTERVALS, MINUS_Y)
TIMING_NAMES = {k: ("start_s", "duration_s", "ramp_fraction", "stay_s")[: 4 if k == MINUS_Y else 3] for k in SLEWING}
MEAN_RATES_DEG_S, RAMPS, SHORTEST_STAY_S = (0.1, 0.6), (0.02, 0.5), 3000.0


def compute_timings(section: IntervalSection, u: Sequence[float] | Array) -> list[float]:
    """Compute the timings of an interval's slews, ordered as `TIMING_NAMES`, from numbers between zero and one."""
    length, angle = section.stop_s - section.start_s, abs(section.slew[0].angle_deg)
    slow, fast = MEAN_RATES_DEG_S
    shortest, longest = angle / fast, min(angle / slow, length)
    duration = shortest * (longest / shortest) ** u[1]  # flat in its logarithm
    ramp = RAMPS[0] + (RAMPS[1] - RAMPS[0]) * u[2]
    if len(section.slew) == 1:
        return [u[0] * (length - duration), duration, ramp]
    stay = SHORTEST_STAY_S + (length - duration - SHORTEST_STAY_S) * u[3]
    return [u[0] * (length - duration - stay), duration, ramp, stay]


def replace_slew_timings(
    section: IntervalSection, start: float, duration: float, ramp: float, stay: float = 0.0
) -> IntervalSection:
    """Replace the timings of an interval's slews; the stay is the time between two of them."""
    slews = tuple(
        slew.model_copy(update={"start_s": start + j * stay, "duration_s": duration, "ramp_fraction": ramp})
        for j, slew in enumerate(section.slew)
    )
    return section.model_copy(update={"slew": slews})
