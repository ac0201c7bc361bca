"""The forms of N Tables 2 to 5: N's rows and columns, the flight's value beside the simulated one and their difference."""

from collections.abc import Hashable
from typing import Any

import numpy as np
import pandas as pd

from gyrocal.arrays import Array
from studies.natanson import flight
from studies.report.tables import NO_VALUE

ITERATION_PHASES = {"prelaunch": "before", "calibrated": "first", "second iteration": "second"}
WORDS = {"bias_deg_s": "bias", "scale_factor": "scale factor"}
WORDS |= {f"misalignment_{axis}_deg": f"misalignment to {axis}" for axis in "xyz"}
WORDS |= {"paper_rms": "RMS as printed", "rms": "true RMS", "G_inverse": "G⁻¹"}
WORDS |= {"prelaunch": "before", "calibrated": "after"}
LABELS = {  # form of the row names of each table
    "table2": "{phase}, {interval} {axis}",
    "table3": "{gyro} gyro, {quantity}",
    "table4": "{phase}, {statistic} {axis}",
    "table5": "first, {quantity} {row}{gyro}",
}
DECIMALS = {"table2": 3, "table3": 3, "table4": 4, "table5": 2}  # as printed
UNITS = {  # offset, one over the unit, and decimals, if they are not 0, 1 and those of the table
    ("table3", "bias_deg_s"): (0.0, 1e4, 2),
    ("table3", "scale_factor"): (1.0, 1e5, 0),
    ("table5", "G_inverse"): (0.0, 1e3, 2),
    ("table5", "bias_deg_s"): (0.0, 1e5, 2),
}
TABLE4_STATISTICS = {
    "mean": lambda x: x.mean(axis=1),
    "paper_rms": lambda x: flight.compute_paper_rms(x.transpose(1, 0, 2)),
    "rms": lambda x: flight.compute_rms(x.transpose(1, 0, 2)),
}


def convert_to_gyro_form(vectors: Array) -> tuple[list[tuple[str, str]], Array]:
    """Convert (n, 12) of G and b in deg/s to the cells of N Table 3 and their values (n, cells)."""
    G, bias = vectors[:, :9].reshape(-1, 3, 3), vectors[:, 9:]
    cells, columns = [], []
    for i, gyro in enumerate("xyz"):
        cells += [("bias_deg_s", gyro), ("scale_factor", gyro)]
        columns += [bias[:, i], G[:, i, i]]
        for j, axis in enumerate("xyz"):
            if i != j:
                cells.append((f"misalignment_{axis}_deg", gyro))
                columns.append(np.rad2deg(G[:, i, j]))
    return cells, np.stack(columns, axis=1)


def count_digit_changes(first: Array, second: Array) -> tuple[Array, Array]:
    """Count the printed digits of N Tables 2 and 4 that one more iteration changes, (n,) each.

    Parameters
    ----------
    first, second : (n, intervals, 3) residuals after each iteration, deg
    """
    table2 = np.round(first, DECIMALS["table2"]) != np.round(second, DECIMALS["table2"])
    table4 = [
        np.round(TABLE4_STATISTICS[name](first), DECIMALS["table4"])
        != np.round(TABLE4_STATISTICS[name](second), DECIMALS["table4"])
        for name in ("mean", "paper_rms")
    ]
    return np.sum(table2, axis=(1, 2)), np.sum(table4, axis=(0, 2))


def format_paper_table(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Format N Table 2, 3 or 4 with full ψ and skipped samples: a row for each number and step, as texts."""
    rows = table.query("psi == 'full' and resampling == 'skip' and phase != 'second iteration'")
    if name == "table3":  # in N's order, a quantity after the other
        order = rows["quantity"].map(list(WORDS).index)
        rows = rows.assign(order=order).sort_values(["step_s", "order"], kind="stable")
    return pd.DataFrame([{"Δt (s)": f"{row['step_s']:g}", **_format_row(row, name)} for row in rows.to_dict("records")])


def format_corrections(table: pd.DataFrame, second: pd.DataFrame | None = None) -> pd.DataFrame:
    """Format N Table 5 as texts: first iteration simulated, second one recalculated from the flight's residuals."""
    first_iteration = table.query("psi == 'full' and resampling == 'skip' and iteration == 1").fillna({"row": ""})
    flown = first_iteration["flight"].notna()
    first = first_iteration[flown if flown.any() else first_iteration["step_s"] == first_iteration["step_s"].min()]
    rows = [_format_row(row, "table5") for row in first.to_dict("records")]
    for row in second.fillna({"row": ""}).to_dict("records") if second is not None else ():
        name = f"{WORDS.get(row['quantity'], row['quantity'])} {row['row']}{row['gyro']}"
        cells = _format_beside(row["flight"], row["gyro_space"], None, DECIMALS["table5"])
        rows.append({"number": f"second, {name}", **cells})
    return pd.DataFrame(rows)


def _format_row(row: dict[Hashable, Any], name: str) -> dict[str, str]:
    """Format a row of a table: label, flown and simulated values, and their difference."""
    label = LABELS[name].format(**{str(column): WORDS.get(str(value), value) for column, value in row.items()})
    offset, scale, digits = UNITS.get((name, str(row.get("quantity"))), (0.0, 1.0, DECIMALS[name]))
    start = {"before launch": _round_text((row["prelaunch"] - offset) * scale, digits)} if name == "table3" else {}
    cells = _format_beside((row["flight"] - offset) * scale, (row["mean"] - offset) * scale, row["std"] * scale, digits)
    return {"number": label} | start | cells


def _format_beside(flown: float, mean: float, std: float | None, digits: int) -> dict[str, str]:
    """Format the flight's value, the simulated mean ± standard deviation over seeds, and their difference."""
    simulated = _round_text(mean, digits) + ("" if std is None else f" ± {_round_text(std, digits)}")
    if pd.isna(flown):
        return {"flown": NO_VALUE, "simulated": simulated, "difference": NO_VALUE}
    flown_text = _round_text(flown, digits)
    if flown != 0 and float(flown_text) == 0:  # N prints two residuals with a fourth digit
        flown_text = f"{flown:g}"
    return {"flown": flown_text, "simulated": simulated, "difference": f"{round(mean - flown, digits) + 0.0:+.{digits}f}"}


def _round_text(value: float, digits: int) -> str:
    """Format a number with `digits` decimals, and zero without a sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"
