"""An optimised plan on the terminal: its slews or its dither, and the sigmas of G and b before and after."""

from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from diagnosis.plan.optimise import OptimisedPlan
from gyrocal.calibration.parameters import NAMES
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
    return (
        f"{found.baseline.title}: {found.slew_s:.0f} s of slews in place of {found.baseline_slew_s:.0f} s{share}, worst sigma "
        f"of G and b {found.worst_ratio:.2f} times that before"
    )


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
