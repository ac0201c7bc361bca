"""A dither within a pointing budget: small sinusoids about x, y and z on the attitude of the intervals without a slew.

The angles are α_j = A sin(2π n_j t/L), t from the start of an interval of length L, with whole n_j: the attitude at both ends
is that without the dither. A reference attitude at t sees the error δG α(t) beside that without a dither, so that all gain
comes from references inside the interval, and none from those at its ends.

Among white references every τ the sinusoids are orthogonal for different n_j below the Nyquist number L/(2τ), and have half of
the power A² up to L/(2τ) − ½. The random walk of the gyro's angle has less power at higher frequencies. The three n_j are
therefore the highest ones up to there that the limits allow.

- Budget: R(e_z, α_z) R(e_y, α_y) R(e_x, α_x) turns by θ with cos θ/2 = c_x c_y c_z ± s_x s_y s_z, of the half angles. θ is
  largest at α_j = ±A, where cos θ/2 = c³ − s³.
- Rate: the axes of x and z are oblique by α_y, so that |ω|² ≤ u² (3 + 2 sin A) with u = 2π n A/L, for the largest n.
- Acceleration: |ω'| ≤ (2π n/L)² A (√(3 + 2 sin A) + 3 A); 3 A for three products of two rates.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from diagnosis.plan.optimise import OptimisedPlan
from diagnosis.plan.settings import SETTINGS
from diagnosis.plan.slew_design import SlewLimits, compute_slew_time
from gyrocal import calibrate
from gyrocal.errors import InputError
from simulator.scenario import TOUCH_TOLERANCE, ControlMotionSection, IntervalSection, Scenario, override
from simulator.simulate import simulate


def add_dither(scenario: Scenario, budget: float, limits: SlewLimits) -> OptimisedPlan:
    """Add a dither to each interval that has no slew and touches no other, and compute the sigmas with and without it.

    Parameters
    ----------
    scenario : the plan, whose slews stay
    budget : largest angle to the attitude without a dither, rad
    limits : of rate and acceleration relative to LVLH

    Raises
    ------
    InputError
        The scenario has a control motion or no references, or no interval has room for three frequencies.
    """
    if scenario.control_motion is not None or any(one.control_motion for one in scenario.interval):
        raise InputError("the scenario has a control motion already; take a scenario without [control_motion] for a dither")
    if scenario.reference.at == "none":
        raise InputError("the scenario has no reference attitudes to calibrate with; set [reference] at to ends or series")
    gaps = [second.start_s - first.stop_s > TOUCH_TOLERANCE for first, second in pairwise(scenario.interval)]
    is_alone = [before and after for before, after in pairwise([True, *gaps, True])]
    sections = [
        one.model_copy(update={"control_motion": build_dither(one, scenario, budget, limits)}) if free and not one.slew else one
        for one, free in zip(scenario.interval, is_alone, strict=True)
    ]
    if not any(one.control_motion for one in sections):
        raise InputError(
            "no interval has room for a dither: it takes an interval without slews that touches no other, and three periods "
            "within the limits; allow more with --max-rate or --max-acceleration, or a smaller --dither"
        )
    dithered = override(
        scenario.model_copy(update={"title": f"{scenario.title}, dither"}),
        {"interval": [one.model_dump(mode="json", exclude_none=True) for one in sections]},
    )
    before, after = (calibrate(simulate(one, noise=False)).sigma for one in (scenario, dithered))
    slew_s = compute_slew_time(scenario)
    return OptimisedPlan(dithered, scenario, limits, after, before, slew_s, slew_s)


def compute_dither_amplitude(budget: float) -> float:
    """Compute the amplitude of each of three sinusoids whose largest common turn is the budget, rad."""
    return float(brentq(lambda a: np.cos(a / 2) ** 3 - np.sin(a / 2) ** 3 - np.cos(budget / 2), 0.0, budget, xtol=1e-15))


def build_dither(
    section: IntervalSection, scenario: Scenario, budget: float, limits: SlewLimits
) -> ControlMotionSection | None:
    """Build the dither of an interval; None if the limits leave no three frequencies."""
    A, length = compute_dither_amplitude(budget), section.stop_s - section.start_s
    norm = np.sqrt(3 + 2 * np.sin(A))
    frequency = min(limits.rate / (A * norm), np.sqrt(limits.acceleration / (A * (norm + 3 * A)))) / (2 * np.pi)
    frequency = min(frequency, 1 / (SETTINGS.samples_per_period * scenario.gyro.sample_s))
    most = int(np.floor(length * frequency))
    if scenario.reference.every_s is not None:
        most = min(most, int(np.floor(length / (2 * scenario.reference.every_s) - 0.5)))
    if most < 3:
        return None
    period = length / np.array([most, most - 1, most - 2])
    return ControlMotionSection(
        amplitude_deg=(float(np.rad2deg(A)),) * 3,
        period_s=tuple(period.tolist()),
        phase_deg=tuple((-360 * np.mod(section.start_s, period) / period).tolist()),
    )
