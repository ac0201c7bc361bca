"""Optimised plans on the terminal: slews or dither with the sigmas of G and b, and plans that separate two effects."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from diagnosis.plan.optimise import OptimisedPlan
from diagnosis.plan.separate import OWN_PLAN, Separation
from gyrocal.calibration.parameters import NAMES
from simulator.effects import EFFECTS
from studies.report import tables
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES


def show(console: Console, found: OptimisedPlan, path: Path) -> None:
    """Print the plan that was found."""
    console.print(format_headline(found), highlight=False, markup=False, style="bold")
    if any(one.control_motion for one in found.scenario.interval):
        tables.print_table(console, "Dither", build_dither_table(found))
    else:
        tables.print_table(console, "Slews", build_slew_table(found))
    tables.print_table(console, "Sigmas of G and b", build_sigma_table(found), "Ratio: after over before.", {"ratio": ".3f"})
    console.print(f"The plan is in {path}; gyrocal simulate {path} OUT simulates it.", highlight=False, markup=False)


def format_headline(found: OptimisedPlan) -> str:
    """The answer in a line."""
    dithered = sum(one.control_motion is not None for one in found.scenario.interval)
    if dithered:
        ratio = found.sigma / found.baseline_sigma
        unseen = "; it is zero at the references, which are at the ends of intervals, and gains nothing"
        unseen = unseen if found.scenario.reference.at == "ends" else ""
        return (
            f"{found.baseline.title}: a dither in {dithered} of {len(found.scenario.interval)} intervals, sigmas of G and b "
            f"{ratio.min():.3f} to {ratio.max():.3f} times those without it{unseen}"
        )
    share = f" ({found.slew_s / found.baseline_slew_s:.0%})" if found.baseline_slew_s else ""
    times = f"{found.baseline.title}: {found.slew_s:.0f} s of slews in place of {found.baseline_slew_s:.0f} s{share}"
    if found.separation:
        before, after = found.separation
        return (
            f"{times}. Size that separates {before.effect} from {before.other} before: {_format_size(before)}; {after.effect} "
            f"from {after.other} with these slews: {_format_size(after)}"
        )
    return f"{times}, worst sigma of G and b {found.worst_ratio:.2f} times that before"


def build_slew_table(found: OptimisedPlan) -> pd.DataFrame:
    """A row for each slew, and one for each interval without any."""
    rows = []
    for one in found.scenario.interval:
        interval = {
            "interval": one.name,
            "activity": one.activity,
            "mode": one.mode,
            "length_s": f"{one.stop_s - one.start_s:.0f}",
        }
        for slew in one.slew or [None]:
            shown = ("", "", "", "", "")
            if slew is not None:
                rate = slew.angle_deg / slew.duration_s / (1 - slew.ramp_fraction)
                axis = " ".join(f"{value + 0.0:.2f}" for value in np.round(slew.axis, 2))
                shown = (axis, f"{slew.angle_deg:.1f}", f"{slew.start_s:.0f}", f"{slew.duration_s:.0f}", f"{rate:.3f}")
            rows.append(interval | dict(zip(("axis", "angle_deg", "start_s", "duration_s", "rate_deg_s"), shown, strict=True)))
    return pd.DataFrame(rows)


def build_dither_table(found: OptimisedPlan) -> pd.DataFrame:
    """A row for each interval with a dither: the amplitude about each axis, and the three periods."""
    rows = []
    for one in found.scenario.interval:
        if one.control_motion:
            periods = dict(zip(("period_x_s", "period_y_s", "period_z_s"), one.control_motion.period_s, strict=True))
            rows.append({"interval": one.name, "amplitude_deg": one.control_motion.amplitude_deg[0], **periods})
    return pd.DataFrame(rows)


def build_sigma_table(found: OptimisedPlan) -> pd.DataFrame:
    """A row for each parameter, in ppm and deg/h."""
    before, after = found.baseline_sigma * PPM_DEG_H, found.sigma * PPM_DEG_H
    return pd.DataFrame(
        {"parameter": NAMES, "before": before, "after": after, "ratio": after / before, "unit": PPM_DEG_H_NAMES}
    )


def show_separations(console: Console, found: Sequence[Separation]) -> None:
    """Print how each plan separates two effects, and the best plan beside the scenario itself."""
    own = next(one for one in found if one.plan == OWN_PLAN)
    best = found[0]
    console.print(
        f"Best of {len(found)} plans: {best.plan}. Size that separates {own.effect} from {own.other} without it: "
        f"{_format_size(own)}; {best.effect} from {best.other} with it: {_format_size(best)}",
        highlight=False,
        markup=False,
        style="bold",
    )
    rows = [
        {"plan": one.plan, "effect": one.effect, "beside": one.other, "share": one.share, "size": _format_size(one)}
        for one in found
    ]
    note = "Share: of the effect that the other reproduces. Size: that separates them with a probability of 0.95."
    tables.print_table(console, "Separation", pd.DataFrame(rows), note, {"share": ".4f"})


def _format_size(one: Separation) -> str:
    unit = EFFECTS[one.effect.partition(":")[0]].unit
    return f"{one.size:.3g} {unit}" if np.isfinite(one.size) else "never"
