"""Where linear ψ stops being good enough: slew rate × step × slew angle, noise-free.

The relative error of linear ψ is of the order |ω|Δt/2 (N 11), so after one iteration what it leaves of a correction ΔG grows
with the slew rate and the step. Further iterations remove it, at another pass each: both are reported. Full ψ has an error of
its own: a sample is the mean rate over the step, and holding it while the rate changes is wrong to second order in Δt.

The slews of the scenario are flown at each rate and angle, their intervals made as long as that needs. Case i is point i of
the grid, the angle slowest and the step fastest.
"""

from functools import partial
from itertools import pairwise
from math import ceil
from pathlib import Path
from typing import Any, ClassVar

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pydantic import field_validator

from gyrocal import CalibrationResult, InputError, calibrate
from gyrocal.recording import Recording
from simulator.scenario import Scenario, override
from simulator.simulate import motion, observe
from studies.montecarlo.statistics import crossing, order, span
from studies.montecarlo.study import GridConfig, Streams, Study, base_scenario
from studies.report.entry import Entry, Report
from studies.report.panels import STYLE, save
from studies.report.tables import Table

RATES_DEG_S = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
STEPS_S = (0.5, 1.0, 2.0, 4.0, 8.0)
ANGLES_DEG = (45.0, 90.0, 180.0)
GOOD_ENOUGH = 1e-5  # in G: a tenth of what the TRMM references allow to be known
RAMP = 0.1
MARGIN_S = 60.0
SUBSTEP_S = 0.5  # of the truth's integration
MAX_ITERATIONS = 30
STEPS_PER_RAMP = 2.0  # fewer, and the error no longer follows a power of the step
ORDERED = ("G_difference", "bias_difference_deg_s", "full_error_G", "full_error_bias_deg_s")
FLOWN = (0.25, 0.5)  # rate and step of the TRMM calibration


class PsiConfig(GridConfig):
    """The grid.

    Attributes
    ----------
    slew_rates_deg_s : rates at which the slews coast
    steps_s : gyro sample and propagation step
    slew_angles_deg : angle of the scenario's largest slew; the others are scaled with it
    """

    axes: ClassVar = ("slew_angles_deg", "slew_rates_deg_s", "steps_s")
    slew_rates_deg_s: tuple[float, ...] = RATES_DEG_S
    steps_s: tuple[float, ...] = STEPS_S
    slew_angles_deg: tuple[float, ...] = ANGLES_DEG

    @field_validator("slew_rates_deg_s", "steps_s", "slew_angles_deg")
    @classmethod
    def _positive(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not value or min(value) <= 0 or len(set(value)) < len(value):
            raise ValueError("must be one or more different numbers above zero")
        return value


def with_slew_angle(scenario: Scenario, angle_deg: float) -> Scenario:
    """The scenario with its largest slew turning through the angle, and the others scaled with it.

    Raises
    ------
    InputError
        The scenario has no slew.
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


def with_slew_rate(scenario: Scenario, rate_deg_s: float) -> Scenario:
    """The scenario with every slew coasting at the rate; constant-rate stretches between slews keep their length."""
    changes: dict[str, float] = {}
    for k, interval in enumerate(scenario.interval):
        if not interval.slew:
            continue
        clock, previous_stop = MARGIN_S, None
        for j, slew in enumerate(interval.slew):
            if previous_stop is not None:
                clock += slew.start_s - previous_stop
            duration = abs(slew.angle_deg) / (rate_deg_s * (1 - RAMP))
            path = f"interval.{k}.slew.{j}"
            changes |= {f"{path}.start_s": clock, f"{path}.duration_s": duration, f"{path}.ramp_fraction": RAMP}
            clock += duration
            previous_stop = slew.start_s + slew.duration_s
        changes[f"interval.{k}.stop_s"] = interval.start_s + 8.0 * ceil((clock + MARGIN_S) / 8.0)
    return override(scenario, changes)


def point(scenario: Scenario, rate_deg_s: float, step_s: float) -> dict[str, float]:
    """Both ψ at one slew rate and step.

    Returns
    -------
    slew_rate_deg_s, step_s, the angle turned in a step, the largest difference in G and in b (deg/s) between linear and full ψ
    after one iteration, each one's error in G and b then and when converged, and the iterations to convergence; NaN where it
    did not converge.
    """
    flown = override(with_slew_rate(scenario, rate_deg_s), {"gyro.sample_s": step_s})
    recording = observe(flown, motion(flown, substeps=ceil(step_s / SUBSTEP_S)), gyro_rng=None, reference_rng=None)
    row = {"slew_rate_deg_s": rate_deg_s, "step_s": step_s, "angle_per_step_deg": rate_deg_s * step_s}
    first = {psi: calibrate(recording, psi=psi, iterations=1) for psi in ("full", "linear")}
    row["G_difference"] = float(np.abs(first["linear"].G - first["full"].G).max())
    row["bias_difference_deg_s"] = float(np.rad2deg(np.abs(first["linear"].bias - first["full"].bias).max()))
    for psi in ("full", "linear"):
        try:
            final = calibrate(recording, psi=psi, max_iterations=MAX_ITERATIONS)
        except InputError:
            final = None  # diverged until the residual could not be linearised any more
        for label, result in ((f"{psi}_first", first[psi]), (psi, final)):
            row[f"{label}_error_G"], row[f"{label}_error_bias_deg_s"] = _errors(flown, result)
        row[f"{psi}_iterations"] = float(len(final.corrections)) if final and final.converged else np.nan
    return row


def _errors(scenario: Scenario, result: CalibrationResult | None) -> tuple[float, float]:
    """Largest error in G, and in b in deg/s; NaN without a result."""
    if result is None:
        return np.nan, np.nan
    gyro = scenario.gyro
    return (
        float(np.abs(result.G - np.array(gyro.true_G)).max()),
        float(np.abs(np.rad2deg(result.bias) - np.array(gyro.true_bias_deg_s)).max()),
    )


def run(scenario: Scenario, rates_deg_s: tuple[float, ...] = RATES_DEG_S, steps_s: tuple[float, ...] = STEPS_S) -> pd.DataFrame:
    """A row per slew rate and step, as in `point` but for the errors in b, with the scenario's own slew angles."""
    table = pd.DataFrame([point(scenario, rate, step) for rate in rates_deg_s for step in steps_s])
    return table[[name for name in table if not str(name).endswith("error_bias_deg_s")]]


def case(config: PsiConfig, number: int, streams: Streams) -> dict[str, float]:
    """One point of the grid."""
    angle, rate, step = config.points()[number]
    return {"slew_angle_deg": angle} | point(with_slew_angle(base_scenario(config), angle), rate, step)


def recording(config: PsiConfig, number: int, streams: Streams) -> Recording:
    """The recording of one point of the grid."""
    angle, rate, step = config.points()[number]
    flown = override(with_slew_rate(with_slew_angle(base_scenario(config), angle), rate), {"gyro.sample_s": step})
    return observe(flown, motion(flown, substeps=ceil(step / SUBSTEP_S)), gyro_rng=None, reference_rng=None)


STUDY = Study("studies.calibration.psi:STUDY", PsiConfig, case, recording)


def limits(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per slew angle and step: the slew rate, and the angle per step, at which each ψ exceeds `GOOD_ENOUGH` in G.

    For linear ψ by its difference from full ψ after one iteration, for full ψ by its error when converged. NaN where the grid's
    rates do not reach it or begin above it.
    """
    out = []
    for (angle, step), part in rows.sort_values("slew_rate_deg_s").groupby(["slew_angle_deg", "step_s"]):
        row: dict[str, Any] = {"slew_angle_deg": angle, "step_s": step}
        for psi, column in (("linear", "G_difference"), ("full", "full_error_G")):
            rate = crossing(part["slew_rate_deg_s"], part[column], GOOD_ENOUGH)
            row |= {f"{psi}_rate_deg_s": rate, f"{psi}_angle_per_step_deg": rate * row["step_s"]}
        out.append(row)
    return pd.DataFrame(out)


def _asymptotic(rows: pd.DataFrame) -> pd.DataFrame:
    """The points at which the ramp of the largest slew lasts `STEPS_PER_RAMP` steps or more: elsewhere there is no order."""
    ramp_s = RAMP / (1 - RAMP) * rows["slew_angle_deg"] / rows["slew_rate_deg_s"]
    return rows[ramp_s >= STEPS_PER_RAMP * rows["step_s"]]


def orders(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per slew angle and rate: the order in Δt of linear ψ's difference, and of full ψ's error when converged.

    Over the steps that resolve the slews' ramps; NaN where fewer than two do.
    """
    out = []
    for (angle, rate), part in _asymptotic(rows).groupby(["slew_angle_deg", "slew_rate_deg_s"]):
        row = {"slew_angle_deg": angle, "slew_rate_deg_s": rate, "steps": float(len(part))}
        for name in ORDERED:
            row[name] = order(part["step_s"], part[name])
        out.append(row)
    return pd.DataFrame(out, columns=["slew_angle_deg", "slew_rate_deg_s", "steps", *ORDERED])


def rate_orders(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per slew angle and pair of neighbouring rates: the order in the rate of linear ψ's difference, smallest step."""
    out = []
    for angle, part in rows[rows["step_s"] == rows["step_s"].min()].groupby("slew_angle_deg"):
        points = part.sort_values("slew_rate_deg_s")[["slew_rate_deg_s", "G_difference"]].to_numpy()
        for low, high in pairwise(points):
            slope = order([low[0], high[0]], [low[1], high[1]])
            out.append({"slew_angle_deg": angle, "from_deg_s": low[0], "to_deg_s": high[0], "G_difference": slope})
    return pd.DataFrame(out, columns=["slew_angle_deg", "from_deg_s", "to_deg_s", "G_difference"])


def _findings(rows: pd.DataFrame) -> list[str]:
    limit, slopes, by_rate = limits(rows), orders(rows), rate_orders(rows)
    angles = limit["linear_angle_per_step_deg"]
    out = []
    if angles.notna().any():
        smallest = limit.sort_values("linear_angle_per_step_deg").iloc[0]
        out.append(
            f"After one iteration linear ψ differs from full ψ by more than {GOOD_ENOUGH:g} in G from {span(angles)} deg per "
            f"step on ({angles.notna().sum()} of {len(limit)} pairs of slew angle and Δt cross it inside the grid); the "
            f"smallest is at {smallest['linear_rate_deg_s']:.2g} deg/s, Δt {smallest['step_s']:g} s and a slew of "
            f"{smallest['slew_angle_deg']:g} deg."
        )
    else:
        out.append(f"Inside this grid linear ψ nowhere crosses a difference of {GOOD_ENOUGH:g} in G from full ψ.")
    flown = rows[(rows["slew_rate_deg_s"] == FLOWN[0]) & (rows["step_s"] == FLOWN[1])]
    if len(flown):
        out.append(
            f"At TRMM's {FLOWN[0]:g} deg/s and {FLOWN[1]:g} s the difference is {span(flown['G_difference'])} in G and "
            f"{span(flown['bias_difference_deg_s'])} deg/s in b over the slew angles."
        )
    if slopes["G_difference"].notna().any():
        out.append(
            f"Linear ψ's difference in G is of order {span(slopes['G_difference'], 3)} in Δt, full ψ's error when converged of "
            f"order {span(slopes['full_error_G'], 3)} (first and second expected; over steps of at most 1/{STEPS_PER_RAMP:g} "
            "of a slew's ramp): what limits full ψ is holding the mean rate over a step."
        )
    if len(by_rate):
        lowest, highest = (
            by_rate[by_rate["from_deg_s"] == rate]["G_difference"]
            for rate in (by_rate["from_deg_s"].min(), by_rate["from_deg_s"].max())
        )
        out.append(
            f"In the slew rate the difference is of order {span(lowest, 3)} between the two lowest and {span(highest, 3)} "
            f"between the two highest rates, at {rows['step_s'].min():g} s: |ω|Δt sets its scale, but the angle per step alone "
            "does not fix it."
        )
    worst = rows.sort_values("full_error_G", na_position="first").iloc[-1]
    fine = limit["full_angle_per_step_deg"]
    out.append(
        f"Full ψ, converged, is wrong by at most {worst['full_error_G']:.2g} in G (at {worst['slew_rate_deg_s']:g} deg/s, "
        f"{worst['step_s']:g} s) and exceeds {GOOD_ENOUGH:g} from {span(fine)} deg per step on."
    )
    apart = (rows["linear_error_G"] - rows["full_error_G"]).abs().max()
    out.append(
        f"To convergence full ψ takes {span(rows['full_iterations'])} iterations, linear ψ {span(rows['linear_iterations'])}, "
        f"to errors in G that differ by at most {apart:.2g}; "
        f"not converged: {rows['full_iterations'].isna().sum()} full, {rows['linear_iterations'].isna().sum()} linear."
    )
    return out


def report(config: PsiConfig, rows: pd.DataFrame) -> Report:
    """Where linear ψ and full ψ stop being good enough, and how their errors scale."""
    tables = {
        "limits": Table("Where each ψ exceeds the limit in G", limits(rows)),
        "step_orders": Table("Order of the error in Δt", orders(rows)),
        "rate_orders": Table("Order of linear ψ's difference in the slew rate", rate_orders(rows)),
        "points": Table("Both ψ over slew angle, slew rate and step", rows.drop(columns=["case", "error"], errors="ignore")),
    }
    return Report(tables, {"psi": partial(figure, rows)}, findings=tuple(_findings(rows)))


ENTRY = Entry(STUDY, "linear against full ψ over slew rate, step and slew angle", report)


def figure(rows: pd.DataFrame, path: Path) -> Path:
    """Linear ψ's difference from full ψ as a map, and with full ψ's own error over the angle per step; largest slew angle."""
    shown = rows[rows["slew_angle_deg"] == rows["slew_angle_deg"].max()]
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 3.6), layout="constrained")
        left, right = drawing.subplots(1, 2, width_ratios=(1.25, 1))
        _map(left, shown)
        _curves(right, shown)
        drawing.suptitle(f"One iteration, slews of up to {shown['slew_angle_deg'].iloc[0]:g}°, no noise", fontsize=9)
        return save(drawing, path)


def _map(axes: Axes, rows: pd.DataFrame) -> None:
    grid = rows.pivot_table(index="slew_rate_deg_s", columns="step_s", values="G_difference")
    values = np.log10(grid.to_numpy())
    axes.grid(False)
    axes.pcolormesh(values, cmap="viridis", edgecolors="white", linewidth=1)
    for i, j in np.ndindex(values.shape):
        value = 10 ** values[i, j]
        text = f"{value:.0e}".replace("e-0", "e-") + (" ✗" if value > GOOD_ENOUGH else "")
        axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", color=_ink(values, values[i, j]), fontsize=8)
    axes.set_xticks(np.arange(len(grid.columns)) + 0.5, [f"{step:g}" for step in grid.columns])
    axes.set_yticks(np.arange(len(grid.index)) + 0.5, [f"{rate:g}" for rate in grid.index])
    axes.set_xlabel("step Δt (s)")
    axes.set_ylabel("slew rate (deg/s)")
    axes.set_title(f"|G(linear ψ) − G(full ψ)|; ✗ above {GOOD_ENOUGH:.0e}", loc="left", fontsize=9)


def _ink(values: np.ndarray, value: float) -> str:
    return "white" if value < values.mean() else "black"


def _curves(axes: Axes, rows: pd.DataFrame) -> None:
    shades = mpl.colormaps["viridis"](np.linspace(0, 0.85, rows["slew_rate_deg_s"].nunique()))
    for shade, (rate, part) in zip(shades, rows.sort_values("step_s").groupby("slew_rate_deg_s"), strict=True):
        angle = part["angle_per_step_deg"]
        axes.loglog(angle, part["G_difference"], "o-", color=shade, markersize=3, label=f"{rate:g} deg/s")
        axes.loglog(angle, part["full_error_G"], ":", color=shade)
    axes.axhline(GOOD_ENOUGH, color="#d1495b", linewidth=1)
    axes.set_xlabel("angle per step (deg)")
    axes.set_ylabel("largest element of G")
    axes.set_title("solid: linear − full; dotted: full's error, converged", loc="left", fontsize=9)
    axes.legend(fontsize=7, loc="lower right")
