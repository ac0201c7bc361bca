"""Timings of the slews, which N and R do not publish: the assumed ones, and a scan over others.

The scan says how much the agreement with the flight owes to the assumed timings.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd

from simulator.scenario import IntervalSection, Scenario
from studies.natanson import flight
from studies.natanson.flight_diagnosis.table import simulate_residuals
from studies.natanson.flight_diagnosis.timings import replace_slew_timings
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS, compute_noise_free_residuals, predict_residuals

SLEWING = (*YAW_INTERVALS, MINUS_Y)


class CommonTiming(NamedTuple):
    """Timings common to all maneuvers."""

    delay_s: float  # from an interval's start to its first slew
    slew_rate_deg_s: float  # rate all slews coast at
    ramp_fraction: float  # share of a slew spent on speeding up, and again on slowing down
    stay_s: float  # from the middle of the slew into -y forward to the middle of the slew out of it

    def compute_duration(self, section: IntervalSection) -> float:
        """Compute the duration of a slew of an interval, s."""
        return abs(section.slew[0].angle_deg) / (self.slew_rate_deg_s * (1 - self.ramp_fraction))

    def is_flyable(self, section: IntervalSection) -> bool:
        """Whether the slews fit into their interval, and the stay between them."""
        duration = self.compute_duration(section)
        stay = self.stay_s if len(section.slew) > 1 else duration
        last = self.delay_s + duration + (len(section.slew) - 1) * stay
        return duration <= stay and last <= section.stop_s - section.start_s


SCANNED = {
    "delay_s": (0.0, 30.0, 60.0, 90.0, 120.0),
    "slew_rate_deg_s": (0.2, 0.25, 0.3, 0.35),
    "ramp_fraction": (0.02, 0.1, 0.3, 0.5),
    "stay_s": (3400.0, 3600.0, 3800.0),
}


def scan_common_timings(scenario: Scenario) -> pd.DataFrame:
    """Gap and clean gap over a grid of all four common timings together; slews that do not fit their interval are left out."""
    flown, clean = flight.read_published_residuals("prelaunch"), compute_noise_free_residuals()
    still = [k for k in range(len(scenario.interval)) if k not in SLEWING]
    kept = predict_residuals(scenario)[still]
    candidates = [CommonTiming(*values) for values in product(*SCANNED.values())]
    timings = [one for one in candidates if all(one.is_flyable(scenario.interval[k]) for k in SLEWING)]
    # Sums of squares of both gaps, over the intervals without slews and over each with them.
    of_still = np.array([np.sum((cells[still] - kept) ** 2) for cells in (flown, clean)])
    of_slewing = {}
    for k in SLEWING:  # the residuals of the yaw maneuvers do not depend on the stay
        keys = [one if k == MINUS_Y else one._replace(stay_s=0.0) for one in timings]
        different = list(dict.fromkeys(keys))
        section = scenario.interval[k]
        moved = [
            replace_slew_timings(section, one.delay_s, one.compute_duration(section), one.ramp_fraction, one.stay_s)
            for one in different
        ]
        theta, _ = simulate_residuals(moved)
        found = dict(zip(different, theta, strict=True))
        values = np.array([found[key] for key in keys])
        of_slewing[k] = np.array([np.sum((cells[k] - values) ** 2, axis=1) for cells in (flown, clean)])
    gap, clean_gap = np.sqrt((of_still[:, None] + sum(of_slewing.values())) / flown.size)
    return pd.DataFrame(timings, columns=list(SCANNED)).assign(gap_rms_deg=gap, clean_gap_rms_deg=clean_gap)
