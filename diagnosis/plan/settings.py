"""Every number that decides something in a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PlanSettings:
    """Thresholds and draws of a plan."""

    power: float = 0.9  # probability with which an effect of its smallest visible size is seen; a convention
    null_draws: int = 2000  # of M0, for the threshold of the statistic
    power_draws: int = 200  # of each effect; their 10 % point is good to 2 % of a size
    near: float = 0.1  # of the statistic; a size is good to 0.3 % then
    steps: int = 14  # of the solution for a size at most
    snr: float = 6.5  # that an effect usually needs, where solutions start
    # size of a random effect, in terms of its strength, where solutions start; it needs about the square root of the number of
    # ways it can be
    random: float = 4.0
    gone: float = 1e-6  # share of a signature that is left, below which it acts like the calibration itself; rounding
    log_odds: float = float(np.log(19.0))  # that tell two effects apart, of a probability of 0.95
    limit_snr: float = 20.0  # from which on a pair that needs it counts as inseparable; by judgement
    exact: float = 1e-7  # of 1 − ρ², below which columns are the same; rounding
    gap_orbits: float = 1.0  # between the scenario's end and an extra maneuver


SETTINGS = PlanSettings()
