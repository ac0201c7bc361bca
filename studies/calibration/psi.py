"""Limits of linear ψ over slew rate × step × slew angle, noise-free.

The relative error of linear ψ is of the order |ω|Δt/2 (N 11), so after one iteration the rest of a correction ΔG grows with the
slew rate and the step. Further iterations remove it, each with another pass over the samples: both are reported. Full ψ has an
error, too: a sample is the mean rate over the step, and holding it while the rate changes is wrong to second order in Δt.

The slews of the scenario are simulated at each rate and angle, with intervals as long as they need. Case i is point i of the
grid; the angle varies slowest and the step fastest.
"""

from contextlib import suppress
from math import ceil
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from gyrocal import InputError, calibrate
from gyrocal.recording import Recording
from simulator.scenario import Scenario, override
from simulator.simulate import motion, observe
from studies.calibration.shared_truth import Different
from studies.calibration.summaries import find_level_crossing, fit_log_slope
from studies.montecarlo.study import GridConfig, Streams, Study, load_base_scenario
from studies.report import panels
from studies.report.checks import Check, bound_above, check_extremes
from studies.report.entry import Entry, Report
from studies.report.panels import Line
from studies.report.tables import Table, summarise_groups

SLEW_RATES_DEG_S = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
STEPS_S = (0.5, 1.0, 2.0, 4.0, 8.0)
ANGLES_DEG = (45.0, 90.0, 180.0)
GOOD_ENOUGH = 1e-5  # in G: a tenth of the sigma that the TRMM references allow
RAMP = 0.1
SLEW_MARGIN_S = 60.0
SUBSTEP_S = 0.5  # of the truth's integration
MAX_ITERATIONS = 30
STEPS_PER_RAMP = 2.0  # fewer, and the error no longer follows a power of the step
ORDERED = ("G_difference", "full_error_G")
FLOWN_RATE_AND_STEP = (0.25, 0.5)  # rate and step of the TRMM calibration


class PsiConfig(GridConfig):
    """The grid."""

    axes: ClassVar = ("slew_angles_deg", "slew_rates_deg_s", "steps_s")
    slew_rates_deg_s: Different = SLEW_RATES_DEG_S  # rates at which the slews coast
    steps_s: Different = STEPS_S  # gyro sample and propagation step
    slew_angles_deg: Different = ANGLES_DEG  # angle of the scenario's largest slew; the others are scaled with it


def scale_slew_angles(scenario: Scenario, angle_deg: float) -> Scenario:
    """Scale the slews of a scenario so that the largest turns through the angle.

    Raises `InputError` if the scenario has no slew.
    """
    largest = max((abs(slew.angle_deg) for interval in scenario.interval for slew in interval.slew), default=0.0)
    if largest == 0:
        raise InputError("the scenario has no slew whose angle could be changed")
    changes = {
        f"interval.{k}.slew.{j}.angle_deg": slew.angle_deg * angle_deg / largest
        for k, interval in enumerate(scenario.interval)
        for j, slew in enumerate(interval.slew)
    }
    return override(scenario, changes)


def set_slew_rate(scenario: Scenario, rate_deg_s: float) -> Scenario:
    """Return the scenario with every slew coasting at the rate; arcs at constant rate between slews keep their length."""
    changes: dict[str, float] = {}
    for k, interval in enumerate(scenario.interval):
        if not interval.slew:
            continue
        time_s, previous_stop = SLEW_MARGIN_S, None
        for j, slew in enumerate(interval.slew):
            if previous_stop is not None:  # the arc between two slews keeps its length
                time_s += slew.start_s - previous_stop
            duration = abs(slew.angle_deg) / (rate_deg_s * (1 - RAMP))
            path = f"interval.{k}.slew.{j}"
            changes |= {f"{path}.start_s": time_s, f"{path}.duration_s": duration, f"{path}.ramp_fraction": RAMP}
            time_s += duration
            previous_stop = slew.start_s + slew.duration_s
        changes[f"interval.{k}.stop_s"] = interval.start_s + 8.0 * ceil((time_s + SLEW_MARGIN_S) / 8.0)
    return override(scenario, changes)


def compare_psi(scenario: Scenario, rate_deg_s: float, step_s: float) -> dict[str, float]:
    """Compare both ψ at a slew rate and step: largest difference in G after an iteration, and each converged error.

    Errors and numbers of iterations are NaN where it did not converge.
    """
    recording = simulate_noise_free(scenario, rate_deg_s, step_s)
    row = {"slew_rate_deg_s": rate_deg_s, "step_s": step_s, "angle_per_step_deg": rate_deg_s * step_s}
    full, linear = (calibrate(recording, psi=psi, iterations=1).G for psi in ("full", "linear"))
    row["G_difference"] = float(np.abs(linear - full).max())
    for psi in ("full", "linear"):
        row[f"{psi}_error_G"], row[f"{psi}_iterations"] = np.nan, np.nan
        with suppress(InputError):  # diverged so far that the residual cannot be linearised
            final = calibrate(recording, psi=psi, max_iterations=MAX_ITERATIONS)
            row[f"{psi}_error_G"] = float(np.abs(final.G - np.array(scenario.gyro.true_G)).max())
            row[f"{psi}_iterations"] = float(len(final.corrections)) if final.converged else np.nan
    return row


def simulate_noise_free(scenario: Scenario, rate_deg_s: float, step_s: float) -> Recording:
    """Simulate the scenario without noise, its slews coasting at the rate, its gyro sampled at the step."""
    changed = override(set_slew_rate(scenario, rate_deg_s), {"gyro.sample_s": step_s})
    return observe(changed, motion(changed, substeps=ceil(step_s / SUBSTEP_S)), gyro_rng=None, reference_rng=None)


def run_case(config: PsiConfig, number: int, streams: Streams) -> dict[str, float]:
    """Compare both ψ at one point of the grid."""
    angle, rate, step = config.points()[number]
    return {"slew_angle_deg": angle} | compare_psi(scale_slew_angles(load_base_scenario(config), angle), rate, step)


def make_case_recording(config: PsiConfig, number: int, streams: Streams) -> Recording:
    """Simulate the recording of one point of the grid."""
    angle, rate, step = config.points()[number]
    return simulate_noise_free(scale_slew_angles(load_base_scenario(config), angle), rate, step)


STUDY = Study("studies.calibration.psi:STUDY", PsiConfig, run_case, make_case_recording)


def find_psi_limits(rows: pd.DataFrame) -> pd.DataFrame:
    """Find the slew rate, and angle per step, at which each ψ exceeds `GOOD_ENOUGH` in G, by slew angle and step.

    For linear ψ by its difference from full ψ after one iteration, for full ψ by its error when converged. NaN where the grid's
    rates do not reach it or begin above it.
    """

    def find_rates(part: pd.DataFrame) -> dict[str, object]:
        row: dict[str, object] = {}
        for psi, column in (("linear", "G_difference"), ("full", "full_error_G")):
            rate = find_level_crossing(part["slew_rate_deg_s"], part[column], GOOD_ENOUGH)
            row |= {f"{psi}_rate_deg_s": rate, f"{psi}_angle_per_step_deg": rate * part["step_s"].iloc[0]}
        return row

    keys = ["slew_angle_deg", "step_s"]
    return summarise_groups(rows.sort_values([*keys, "slew_rate_deg_s"]), keys, find_rates)


def estimate_step_orders(rows: pd.DataFrame) -> pd.DataFrame:
    """Estimate the order in Δt of linear ψ's difference, and of full ψ's converged error, by slew angle and rate.

    Over the steps that resolve the slews' ramps; NaN where fewer than two do.
    """
    keys = ["slew_angle_deg", "slew_rate_deg_s"]
    # Elsewhere the ramp of the largest slew lasts fewer steps, and there is no order.
    ramp_s = RAMP / (1 - RAMP) * rows["slew_angle_deg"] / rows["slew_rate_deg_s"]
    resolved = rows[ramp_s >= STEPS_PER_RAMP * rows["step_s"]]

    def fit_orders(part: pd.DataFrame) -> dict[str, object]:
        return {"steps": float(len(part)), **{name: fit_log_slope(part["step_s"], part[name]) for name in ORDERED}}

    table = summarise_groups(resolved.sort_values(keys), keys, fit_orders)
    return table.reindex(columns=[*keys, "steps", *ORDERED])


FIRST_ORDER_NOTE = (
    "Linear ψ's difference is of first order in the angle per step; steps that do not resolve a slew's ramp are left out."
)
SECOND = "Holding the mean rate over a step is what limits full ψ, an error of second order in the step."


def _build_checks(rows: pd.DataFrame) -> list[Check]:
    """Check the limits and the orders in Δt of both ψ, the error at TRMM's rate and step, and convergence."""
    limit, slopes = find_psi_limits(rows), estimate_step_orders(rows)
    checks = []
    for psi in ("linear", "full"):
        name = f"angle per step from which {psi} ψ exceeds a difference of {GOOD_ENOUGH:g} in G"
        checks += check_extremes(name, limit[f"{psi}_angle_per_step_deg"], None, "deg")
    trmm = rows[(rows["slew_rate_deg_s"] == FLOWN_RATE_AND_STEP[0]) & (rows["step_s"] == FLOWN_RATE_AND_STEP[1])]
    name = "G_difference of linear ψ at TRMM's rate and step, largest"
    checks.append(Check(name, trmm["G_difference"].max(), bound_above(GOOD_ENOUGH)))
    name = "order in Δt of linear ψ's difference in G"
    checks += check_extremes(name, slopes["G_difference"], (0.9, 1.1), "", FIRST_ORDER_NOTE)
    checks += check_extremes("order in Δt of full ψ's error in G", slopes["full_error_G"], (1.9, 2.1), "", SECOND)
    checks.append(Check("difference of the converged errors in G", (rows["linear_error_G"] - rows["full_error_G"]).abs().max()))
    for psi in ("full", "linear"):
        checks.append(Check(f"points at which {psi} ψ did not converge", rows[f"{psi}_iterations"].isna().sum(), (0, 0)))
    return checks


def report(config: PsiConfig, rows: pd.DataFrame) -> Report:
    """Report the limits of linear ψ and of full ψ; the checks say how their errors scale."""
    limits = Table("Where each ψ exceeds the limit in G", find_psi_limits(rows))
    return Report({"limits": limits}, {"psi": _draw_figure(rows)}, tuple(_build_checks(rows)))


ENTRY = Entry(STUDY, "linear against full ψ over slew rate, step and slew angle", report)


def _draw_figure(rows: pd.DataFrame) -> panels.Draw:
    """Draw linear ψ's difference as a map, and with full ψ's error over the angle per step; largest slew angle."""
    largest_slew_rows = rows[rows["slew_angle_deg"] == rows["slew_angle_deg"].max()].sort_values("step_s")
    difference_map = panels.make_heat_map(
        largest_slew_rows.pivot_table(index="slew_rate_deg_s", columns="step_s", values="G_difference"),
        mark_above=GOOD_ENOUGH,
        log=True,
        title=f"|G(linear ψ) − G(full ψ)|, one iteration; ✗ above {GOOD_ENOUGH:.0e}",
        x="step Δt (s)",
        y="slew rate (deg/s)",
    )
    lines = []
    for rate, colour in panels.make_shades(sorted(set(largest_slew_rows["slew_rate_deg_s"]))).items():
        part = largest_slew_rows[largest_slew_rows["slew_rate_deg_s"] == rate]
        lines.append(Line(part["angle_per_step_deg"], part["G_difference"], f"{rate:g} deg/s", colour))
        lines.append(Line(part["angle_per_step_deg"], part["full_error_G"], "", colour, ":"))
    axes: dict[str, Any] = {"log": "xy", "levels": [GOOD_ENOUGH], "legend": "lower right"}
    axes |= {"x": "angle per step (deg)", "y": "largest element of G"}
    curves = panels.make_curves(lines, title="solid: linear − full; dotted: full's error, converged", **axes)
    title = f"Slews of up to {largest_slew_rows['slew_angle_deg'].iloc[0]:g}°, no noise"
    return panels.build_sheet(difference_map, curves, size=(9.0, 3.6), widths=(1.25, 1), title=title)
