"""The forms of N Tables 2 to 5: what a cell is, N's rows and columns, and the ways of calibrating side by side."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from studies.natanson import flight
from studies.report.tables import format_number

Array = NDArray[np.float64]

ITERATION_PHASES = {"prelaunch": "before", "calibrated": "first", "second iteration": "second"}
TABLE_COLUMN_TITLES = {"prelaunch": "pre-launch", "calibrated": "1st iteration", "second iteration": "2nd iteration"}


@dataclass(frozen=True)
class Layout:
    """Of a table of N: the columns that name a row, decimals of its cells, and of those with the ways side by side.

    Without the latter there is no such table; without the former numbers are as short as they can be.
    """

    rows: tuple[str, ...]
    digits: int | None
    ways_digits: int | None


TABLE_LAYOUTS = {
    "table2": Layout(("interval", "axis"), 3, 4),
    "table3": Layout(("quantity", "gyro"), 6, 6),
    "table4": Layout(("statistic", "axis"), 4, 5),
    "table5": Layout(("quantity", "row", "gyro"), None, None),
}
TABLE4_STATISTICS = {
    "mean": lambda x: x.mean(axis=1),
    "paper_rms": lambda x: flight.compute_paper_rms(x.transpose(1, 0, 2)),
    "rms": lambda x: flight.compute_rms(x.transpose(1, 0, 2)),
}
TABLE3_ORDER = {
    name: k for k, name in enumerate(["bias_deg_s", "scale_factor", *(f"misalignment_{a}_deg" for a in "xyz"), *"xyz"])
}
PRINTED_DIGITS = {"table2": 3, "table4": 4}  # as printed


def convert_to_gyro_form(vectors: Array) -> tuple[list[tuple[str, str]], Array]:
    """Cells of N Table 3 and their values from (n, 12) of G and b in deg/s."""
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
    """Count the printed digits that one more iteration changes: N Table 2 and both statistics of N Table 4, (n,) each.

    Parameters
    ----------
    first, second : (n, intervals, 3) residuals after each iteration, deg
    """

    def cells(x: Array) -> tuple[Array, Array]:
        statistics = np.concatenate([TABLE4_STATISTICS[name](x) for name in ("mean", "paper_rms")], axis=1)
        return np.round(x, PRINTED_DIGITS["table2"]).reshape(len(x), -1), np.round(statistics, PRINTED_DIGITS["table4"])

    table2, table4 = (np.sum(a != b, axis=1) for a, b in zip(cells(first), cells(second), strict=True))
    return table2, table4


def format_paper_table(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """A table of `studies.natanson.paper_tables`, of full ψ and skipped samples, in N's rows and columns, as texts."""
    rows, digits = list(TABLE_LAYOUTS[name].rows), TABLE_LAYOUTS[name].digits
    chosen = table.query("psi == 'full' and resampling == 'skip'")
    if "phase" in chosen:
        chosen = chosen[chosen["phase"] != "second iteration"]
    wide = _arrange_by_heading(
        chosen,
        rows,
        [_format_heading(row) for _, row in chosen.iterrows()],
        [_format_paper_cell(row, digits) for _, row in chosen.iterrows()],
    )
    if name != "table3":
        return wide
    start = chosen.drop_duplicates(rows)[[*rows, "prelaunch"]]
    start["prelaunch"] = [format_number(value, digits) for value in start["prelaunch"]]
    wide = start.merge(wide, on=rows).rename(columns={"prelaunch": TABLE_COLUMN_TITLES["prelaunch"]})
    return wide.sort_values(rows, key=lambda column: column.map(TABLE3_ORDER), ignore_index=True)


def format_ways_table(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Full beside linear ψ and one iteration beside two, at every step: mean ± standard deviation over the seeds, as texts."""
    digits = TABLE_LAYOUTS[name].ways_digits
    chosen = table.query("resampling == 'skip' and phase != 'prelaunch'").sort_values("step_s", kind="stable")
    headings = [f"{row['psi']} ψ, {TABLE_COLUMN_TITLES[row['phase']]}" for _, row in chosen.iterrows()]
    return _arrange_by_heading(
        chosen, ["step_s", *TABLE_LAYOUTS[name].rows], headings, [_format_spread(row, digits) for _, row in chosen.iterrows()]
    )


def _format_heading(row: pd.Series) -> str:
    """The heading of N's column a row belongs in."""
    phase = TABLE_COLUMN_TITLES[row["phase"]] if "phase" in row else f"{'1st' if row['iteration'] == 1 else '2nd'} iteration"
    return f"{phase}, Δt = {row['step_s']:g} s"


def _arrange_by_heading(chosen: pd.DataFrame, rows: list[str], headings: list[str], texts: list[str]) -> pd.DataFrame:
    """Texts under their headings, columns in the order of N: all steps before launch, then all of each iteration."""
    cells = chosen.assign(heading=headings, text=texts)
    wide = cells.pivot_table(index=rows, columns="heading", values="text", aggfunc="first", sort=False)
    phases = list(TABLE_COLUMN_TITLES.values())
    by_phase = sorted(dict.fromkeys(headings), key=lambda heading: [name in heading for name in phases].index(True))
    return wide[by_phase].reset_index().rename_axis(columns=None)


def _format_spread(row: pd.Series, digits: int | None) -> str:
    return f"{format_number(row['mean'], digits)} ± {format_number(row['std'], digits)}"


def _format_paper_cell(row: pd.Series, digits: int | None) -> str:
    """Mean ± standard deviation and, where it flew, the flight's value and its percentile."""
    text = _format_spread(row, digits)
    if pd.isna(row["flight"]):
        return text
    return f"{format_number(row['flight'], digits)} | {text} | {row['flight_percentile']:.0f} %"
