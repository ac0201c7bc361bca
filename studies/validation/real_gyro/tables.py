"""Tables of the study of a real gyro, from its rows."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from studies.report.tables import by_group
from studies.validation.real_gyro.prediction import LADDER, LAGGED

Array = NDArray[np.float64]

RUNGS = tuple(rung.name for rung in LADDER)
LAST = RUNGS[-1]
BOOTSTRAP = 4000
INTERVAL = (5.0, 95.0)
EVERY = "all"
MEASURES = {"end": "end_deg2", "series": "series_deg2"}


def of_kind(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    """The rows of one kind, without the columns of others."""
    return rows[rows["kind"] == kind].dropna(axis=1, how="all").reset_index(drop=True)


def cell(table: pd.DataFrame, trial: str, measure: str, rung: str, column: str) -> float:
    """One number of the ladder."""
    chosen = (table["trial"] == trial) & (table["measure"] == measure) & (table["rung"] == rung)
    return float(table.loc[chosen, column].iloc[0])


def ladder(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per trial, measure and rung: RMS in deg with its interval, the floor, and the share of the gap closed so far."""
    held, floor = of_kind(rows, "held"), of_kind(rows, "floor")
    rng = np.random.default_rng(0)

    def lines(own: pd.DataFrame, under: pd.DataFrame) -> Iterator[dict[str, object]]:
        for measure, column in MEASURES.items():
            first, least = own.loc[own["name"] == RUNGS[0], column].mean(), under[column].mean()
            for name in RUNGS:
                squares = own.loc[own["name"] == name, column].to_numpy(float)
                drawn = squares[rng.integers(0, squares.size, (BOOTSTRAP, squares.size))]
                low, high = np.percentile(np.sqrt(drawn.mean(axis=1)), INTERVAL)
                yield {
                    "measure": measure,
                    "rung": name,
                    "intervals": squares.size,
                    "rms_deg": float(np.sqrt(squares.mean())),
                    "low_deg": low,
                    "high_deg": high,
                    "floor_deg": float(np.sqrt(least)),
                    "closed": float((first - squares.mean()) / (first - least)) if first > least else np.nan,
                }

    parts = [(unit, trial, own, floor[floor["trial"] == trial]) for (unit, trial), own in held.groupby(["unit", "trial"])]
    parts.append((EVERY, EVERY, held, floor))
    return pd.DataFrame([{"unit": unit, "trial": trial, **line} for unit, trial, *both in parts for line in lines(*both)])


def wide(table: pd.DataFrame) -> pd.DataFrame:
    """The ladder for people: a row per trial, "end / series" in deg, and the 90 % interval of the last."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        trial = str(part["trial"].iloc[0])

        def both(rung: str, form: str, *columns: str) -> str:
            return " / ".join(form.format(*(cell(part, trial, measure, rung, one) for one in columns)) for measure in MEASURES)

        return {
            **{rung: both(rung, "{:.2f}", "rms_deg") for rung in RUNGS},
            "90 % of the last": both(LAST, "{:.2f}–{:.2f}", "low_deg", "high_deg"),
            "floor": both(LAST, "{:.2f}", "floor_deg"),
        }

    return by_group(table, ["unit", "trial"], line)


def steps(rows: pd.DataFrame) -> pd.DataFrame:
    """What each step of the ladder does to the RMS over the series, per unit, with a 90 % interval over the intervals."""
    held = of_kind(rows, "held")
    squares = held.pivot_table(values="series_deg2", index=["unit", "trial", "interval"], columns="name")
    rng = np.random.default_rng(0)
    out = []
    for before, after in [*pairwise(RUNGS), (LAST, LAGGED)]:
        if after not in squares:
            continue
        for unit, part in squares[[before, after]].dropna().groupby("unit"):
            one, two = part[before].to_numpy(float), part[after].to_numpy(float)
            drawn = rng.integers(0, one.size, (BOOTSTRAP, one.size))
            low, high = np.percentile(np.sqrt(two[drawn].mean(axis=1) / one[drawn].mean(axis=1)), INTERVAL)
            ratio, better = float(np.sqrt(two.mean() / one.mean())), int(np.count_nonzero(two < one))
            line = {"step": after, "unit": unit, "ratio": ratio, "ratio_low": low, "ratio_high": high}
            out.append({**line, "better": better, "intervals": one.size})
    return pd.DataFrame(out)


def delays(rows: pd.DataFrame) -> pd.DataFrame:
    """The delay of each trial by itself, and as found on the others."""
    fits = of_kind(rows, "fit")
    others = fits[fits["name"] == LAST].groupby("trial")["delay_ms"].mean()
    own = of_kind(rows, "trial")[["unit", "trial", "delay_ms", "formal_sigma_ms"]]
    return own.assign(on_others_ms=own["trial"].map(others))
