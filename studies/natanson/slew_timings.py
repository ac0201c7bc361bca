"""A scan over timings of the slews, which N and R do not publish: how much the agreement depends on the assumed ones."""

from itertools import product
from typing import NamedTuple

import pandas as pd

from simulator.scenario import IntervalSection, Scenario
from studies.natanson.flight_diagnosis.table import simulate_residuals
from studies.natanson.flight_diagnosis.timings import SLEWING, replace_slew_timings
from studies.natanson.flight_gap import compute_clean_gap_rms, compute_gap_rms, predict_residuals


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
        """Check that the slews fit into their interval, and the stay between them."""
        duration = self.compute_duration(section)
        stay = self.stay_s if len(section.slew) > 1 else duration
        last = self.delay_s + duration + (len(section.slew) - 1) * stay
        return duration <= stay and last <= section.stop_s - section.start_s

    def apply(self, section: IntervalSection) -> IntervalSection:
        """Return an interval with these timings of its slews."""
        stay = self.stay_s if len(section.slew) > 1 else 0.0
        return replace_slew_timings(section, self.delay_s, self.compute_duration(section), self.ramp_fraction, stay)


SCANNED = {
    "delay_s": (0.0, 30.0, 60.0, 90.0, 120.0),
    "slew_rate_deg_s": (0.2, 0.25, 0.3, 0.35),
    "ramp_fraction": (0.02, 0.1, 0.3, 0.5),
    "stay_s": (3400.0, 3600.0, 3800.0),
}


def scan_common_timings(scenario: Scenario) -> pd.DataFrame:
    """Compute gap and clean gap over a grid of the common timings; slews that do not fit their interval are left out."""
    slewing, predicted, rows = [scenario.interval[k] for k in SLEWING], predict_residuals(scenario), []
    for timing in (CommonTiming(*values) for values in product(*SCANNED.values())):
        if all(timing.is_flyable(section) for section in slewing):
            predicted[list(SLEWING)] = simulate_residuals([timing.apply(section) for section in slewing])[0]
            gaps = {"gap_rms_deg": compute_gap_rms(predicted), "clean_gap_rms_deg": compute_clean_gap_rms(predicted)}
            rows.append(timing._asdict() | gaps)
    return pd.DataFrame(rows)
