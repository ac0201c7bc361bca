"""The layout of N Tables 2 to 5: a row a cell of the paper's table, a column a step size."""

import pandas as pd

from studies.report.tables import number

LAYOUTS: dict[str, tuple[list[str], int | None]] = {  # columns that name a row, and decimals
    "table2": (["phase", "interval", "axis"], 3),
    "table3": (["quantity", "gyro"], 6),
    "table4": (["phase", "statistic", "axis"], 4),
    "table5": (["iteration", "quantity", "row", "gyro"], None),
}


def paper_layout(table: pd.DataFrame, name: str, psi: str = "full", resampling: str = "skip") -> pd.DataFrame:
    """A table of distributions, as made by `studies.natanson.paper_tables`, as texts in the paper's layout of that name."""
    rows, digits = LAYOUTS[name]
    chosen = table.query("psi == @psi and resampling == @resampling")
    texts = chosen.assign(text=[_cell(row, digits) for _, row in chosen.iterrows()])
    wide = texts.pivot_table(index=list(rows), columns="step_s", values="text", aggfunc="first", sort=False)
    wide.columns = [f"Δt = {step:g} s" for step in wide.columns]
    return wide.reset_index()


def _cell(row: pd.Series, digits: int | None) -> str:
    """Mean ± standard deviation and, where it flew, the flight's value and its percentile."""
    text = f"{number(row['mean'], digits)} ± {number(row['std'], digits)}"
    if pd.isna(row["flight"]):
        return text
    return f"{number(row['flight'], digits)} | {text} | {row['flight_percentile']:.0f} %"
