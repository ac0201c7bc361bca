"""The forms of N Tables 2 to 5: what a cell is, N's rows and columns, and the ways of calibrating side by side."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from studies.natanson import flight
from studies.report.tables import number

Array = NDArray[np.float64]

PHASES = {"prelaunch": "before", "calibrated": "first", "second iteration": "second"}
COLUMNS = {"prelaunch": "pre-launch", "calibrated": "1st iteration", "second iteration": "2nd iteration"}


@dataclass(frozen=True)
class Layout:
    """Of a table of N: the columns that name a row, decimals of its cells, and of those with the ways side by side.

    Without the latter there is no such table; without the former numbers are as short as they can be.
    """

    rows: tuple[str, ...]
    digits: int | None
    ways_digits: int | None


LAYOUTS = {
    "table2": Layout(("interval", "axis"), 3, 4),
    "table3": Layout(("quantity", "gyro"), 6, 6),
    "table4": Layout(("statistic", "axis"), 4, 5),
    "table5": Layout(("quantity", "row", "gyro"), None, None),
}
TABLE4 = {
    "mean": lambda x: x.mean(axis=1),
    "paper_rms": lambda x: flight.paper_rms(x.transpose(1, 0, 2)),
    "rms": lambda x: flight.rms(x.transpose(1, 0, 2)),
}
TABLE3_ORDER = {
    name: k for k, name in enumerate(["bias_deg_s", "scale_factor", *(f"misalignment_{a}_deg" for a in "xyz"), *"xyz"])
}
DIGITS = {"table2": 3, "table4": 4}  # as printed


def gyro_form(vectors: Array) -> tuple[list[tuple[str, str]], Array]:
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


def changed_digits(first: Array, second: Array) -> tuple[Array, Array]:
    """How many printed digits a further iteration changes: of N Table 2, and of both of N Table 4's statistics, (n,) each.

    Parameters
    ----------
    first, second : (n, intervals, 3) residuals after each iteration, deg
    """

    def cells(x: Array) -> tuple[Array, Array]:
        statistics = np.concatenate([TABLE4[name](x) for name in ("mean", "paper_rms")], axis=1)
        return np.round(x, DIGITS["table2"]).reshape(len(x), -1), np.round(statistics, DIGITS["table4"])

    table2, table4 = (np.sum(a != b, axis=1) for a, b in zip(cells(first), cells(second), strict=True))
    return table2, table4


def paper_form(table: pd.DataFrame, name: str, psi: str = "full", resampling: str = "skip") -> pd.DataFrame:
    """A table of distributions, made by `studies.natanson.paper_tables`, in N's rows and columns, as texts."""
    rows, digits = list(LAYOUTS[name].rows), LAYOUTS[name].digits
    chosen = table.query("psi == @psi and resampling == @resampling")
    if "phase" in chosen:
        chosen = chosen[chosen["phase"] != "second iteration"]
    wide = _pivot(
        chosen, rows, [_heading(row) for _, row in chosen.iterrows()], [_cell(row, digits) for _, row in chosen.iterrows()]
    )
    if name != "table3":
        return wide
    start = chosen.drop_duplicates(rows)[[*rows, "prelaunch"]]
    start["prelaunch"] = [number(value, digits) for value in start["prelaunch"]]
    wide = start.merge(wide, on=rows).rename(columns={"prelaunch": COLUMNS["prelaunch"]})
    return wide.sort_values(rows, key=lambda column: column.map(TABLE3_ORDER), ignore_index=True)


def ways_form(table: pd.DataFrame, name: str, resampling: str = "skip") -> pd.DataFrame:
    """Full beside linear ψ and one iteration beside two, at every step: mean ± standard deviation over the seeds, as texts."""
    digits = LAYOUTS[name].ways_digits
    chosen = table.query("resampling == @resampling and phase != 'prelaunch'").sort_values("step_s", kind="stable")
    headings = [f"{row['psi']} ψ, {COLUMNS[row['phase']]}" for _, row in chosen.iterrows()]
    return _pivot(chosen, ["step_s", *LAYOUTS[name].rows], headings, [_spread(row, digits) for _, row in chosen.iterrows()])


def _heading(row: pd.Series) -> str:
    """The heading of N's column a row belongs in."""
    phase = COLUMNS[row["phase"]] if "phase" in row else f"{'1st' if row['iteration'] == 1 else '2nd'} iteration"
    return f"{phase}, Δt = {row['step_s']:g} s"


def _pivot(chosen: pd.DataFrame, rows: list[str], headings: list[str], texts: list[str]) -> pd.DataFrame:
    """Texts under their headings, columns in the order of N: all steps before launch, then all of each iteration."""
    cells = chosen.assign(heading=headings, text=texts)
    wide = cells.pivot_table(index=rows, columns="heading", values="text", aggfunc="first", sort=False)
    by_phase = sorted(dict.fromkeys(headings), key=lambda heading: list(COLUMNS.values()).index(_phase_of(heading)))
    return wide[by_phase].reset_index().rename_axis(columns=None)


def _phase_of(heading: str) -> str:
    return next(name for name in COLUMNS.values() if name in heading)


def _spread(row: pd.Series, digits: int | None) -> str:
    return f"{number(row['mean'], digits)} ± {number(row['std'], digits)}"


def _cell(row: pd.Series, digits: int | None) -> str:
    """Mean ± standard deviation and, where it flew, the flight's value and its percentile."""
    text = _spread(row, digits)
    if pd.isna(row["flight"]):
        return text
    return f"{number(row['flight'], digits)} | {text} | {row['flight_percentile']:.0f} %"
