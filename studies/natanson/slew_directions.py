"""Which way the spacecraft turned: the rate of -y forward, and the yaw maneuvers, by the gap of each direction.

A gap with fitted timings says that no timing that can be flown saves the other direction.
"""

import pandas as pd

from simulator.scenario import Scenario, override
from studies.natanson import flight
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS, compute_gap_rms, predict_residuals
from studies.natanson.slew_timings import fit_interval_timings


def set_minus_y_rate(scenario: Scenario, sign: int) -> Scenario:
    """The scenario with ω_x = sign RPO in interval 4: −1 is −y forward, +1 needs +y forward, the slews reversed."""
    slews = scenario.interval[MINUS_Y].slew
    return override(
        scenario, {f"interval.{MINUS_Y}.slew.{j}.angle_deg": sign * abs(s.angle_deg) * (-1) ** j for j, s in enumerate(slews)}
    )


def set_yaw_directions(scenario: Scenario, second: int, sixth: int) -> Scenario:
    """The scenario with the given signs of the 180 deg yaws in intervals 2 and 6."""
    return override(
        scenario,
        {f"interval.{k}.slew.0.angle_deg": 180.0 * sign for k, sign in zip(YAW_INTERVALS, (second, sixth), strict=True)},
    )


def list_direction_candidates(scenario: Scenario) -> list[tuple[Scenario, int]]:
    """Each direction of the three intervals, with the interval."""
    rates = [(set_minus_y_rate(scenario, sign), MINUS_Y) for sign in (-1, 1)]
    return rates + [(set_yaw_directions(scenario, sign, sign), k) for k in YAW_INTERVALS for sign in (1, -1)]


def _compare_timing_gaps(candidate: Scenario, k: int) -> dict[str, float]:
    """Gap of interval k with the scenario's timings, and with its own fitted to the three numbers free of noise."""
    fitted = fit_interval_timings(candidate, k)
    return {
        "gap_rms_deg": compute_gap_rms(predict_residuals(candidate), [k]),
        "fitted_gap_rms_deg": compute_gap_rms(predict_residuals(fitted), [k]),
    }


def compare_minus_y_rates(scenario: Scenario) -> pd.DataFrame:
    """Gap of interval 4 for either sign of its rate, with the scenario's timings and with its own fitted to that sign.

    The fitted gap of the favoured sign says little, three timings being fitted to three numbers; that of the other says that
    no timing that can be flown saves it.
    """
    rows = []
    for sign in (-1, 1):
        candidate = set_minus_y_rate(scenario, sign)
        gap = flight.read_published_residuals("prelaunch")[MINUS_Y] - predict_residuals(candidate)[MINUS_Y]
        row = {"rate_rpo": sign, "mode": "-y forward" if sign < 0 else "+y forward", **_compare_timing_gaps(candidate, MINUS_Y)}
        rows.append(row | {f"gap_{name}_deg": value for name, value in zip(flight.ROTATIONS, gap, strict=True)})
    return pd.DataFrame(rows)


def compare_yaw_directions(scenario: Scenario) -> pd.DataFrame:
    """Gap of intervals 2 and 6 for each direction of their yaw maneuvers, with and without fitted timings."""
    return pd.DataFrame(
        [
            {"interval": k + 1, "yaw_deg": 180 * sign, **_compare_timing_gaps(set_yaw_directions(scenario, sign, sign), k)}
            for k in YAW_INTERVALS
            for sign in (1, -1)
        ]
    )
