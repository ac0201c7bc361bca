"""Change of a calibration against a saved one: its table, and whether it keeps stated limits."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from gyrocal.calibration.parameters import NAMES, SCALE_FACTORS, select
from gyrocal.errors import InputError
from gyrocal.importing.units import ANGLE_UNITS, RATE_UNITS
from studies.report.junit import Verdict

if TYPE_CHECKING:
    from gyrocal.calibration.change import CalibrationChange

RATIO_UNITS = {"ppm": 1e-6, "%": 1e-2}
LIMIT_FORM = re.compile(r"\s*([\w,\s-]+?)\s*<\s*(\d*\.?\d+(?:[eE][-+]?\d+)?)\s*([a-z%/]+)\s*")


def parse_limit(text: str) -> tuple[tuple[str, ...], float, str, float]:
    """Parse a limit such as "G_zz<50ppm", "misalignment<20arcsec" or "b_x<0.1deg/h".

    Returns the names of the parameters, the limit, its unit, and the factor from this unit to rad/s or a dimensionless number.
    An `InputError` if the text is no limit.
    """
    match = LIMIT_FORM.fullmatch(text)
    if match is None or not 0 < float(match[2]) < math.inf:
        raise InputError(f"--max-change {text}: give NAME<LIMIT with a positive limit and its unit, as in 'G_zz<50ppm'")
    names, unit = select(match[1]), match[3]
    for name in names:
        known = RATE_UNITS if name.startswith("b") else RATIO_UNITS if name in SCALE_FACTORS else RATIO_UNITS | ANGLE_UNITS
        if unit not in known:
            raise InputError(f"--max-change {text}: {unit} is no unit of {name}; its units are {', '.join(known)}")
    return names, float(match[2]), unit, known[unit]


def check_limits(change: CalibrationChange, max_sigma: float | None, max_change: Sequence[str]) -> list[Verdict]:
    """Check a change: each limit in a unit; and in sigmas each parameter alone, and all together by the same probability."""
    out = []
    if max_sigma is not None:
        for name, moved in zip(NAMES, change.in_sigma, strict=True):
            out.append(Verdict(f"{name} < {max_sigma:g} sigma", f"moved by {moved:.1f} sigma" if moved >= max_sigma else ""))
        together = f"χ² = {change.chi2:.1f} of {change.dof}" if change.p_value <= math.erfc(max_sigma / math.sqrt(2)) else ""
        out.append(Verdict(f"all parameters together < {max_sigma:g} sigma", together))
    size = dict(zip(NAMES, np.abs(change.difference), strict=True))
    for text in max_change:
        names, limit, unit, factor = parse_limit(text)
        beyond = [f"{name} moved by {size[name] / factor:.4g} {unit}" for name in names if size[name] >= limit * factor]
        out.append(Verdict(text.strip(), "; ".join(beyond)))
    return out


def show_change(console: Console, change: CalibrationChange, file: str, verdicts: Sequence[Verdict]) -> None:
    """Print the change by parameter, that of all together, and the limits that are not met."""
    import pandas as pd

    from studies.report import tables
    from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES

    sigma = change.sigma * PPM_DEG_H
    columns = {
        "parameter": NAMES,
        "unit": PPM_DEG_H_NAMES,
        "change": map(tables.format_to_sigma, change.difference * PPM_DEG_H, sigma),
        "sigma": [tables.format_to_sigma(one, one) if one else "held" for one in sigma],
        "in sigma": [f"{one:.1f}" for one in change.in_sigma],
    }
    tables.print_table(console, f"Change against {file}", pd.DataFrame(columns))
    how = "The two recordings are taken as independent: the sigma of a change is √(σ₁² + σ₂²)."
    if change.is_same_recording:
        how = "Both calibrate the same recording and share its noise: the sigmas are those of the saved calibration."
    lines = [f"{how} All parameters together: χ² = {change.chi2:.1f} of {change.dof}, p = {change.p_value:.2g}."]
    for line in [*lines, *(f"Not met: {one.name}: {one.failure}" for one in verdicts if one.failure)]:
        console.print(line, highlight=False, markup=False)
