"""Tables of the study of a real gyro, from its rows."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from studies.validation.real_gyro.ladder import LADDER

Array = NDArray[np.float64]

RUNGS = ("M0", *(f"+ {effect}" for effect in LADDER))
LAST = RUNGS[-1]
BOOTSTRAP = 4000
INTERVAL = (5.0, 95.0)
EVERY = "all"
MEASURES = {"end": "end_deg2", "series": "series_deg2"}


def of_kind(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    """The rows of one kind."""
    return rows[rows["kind"] == kind].reset_index(drop=True)


def records(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows as dictionaries."""
    return [{str(key): value for key, value in row.items()} for row in rows.to_dict("records")]


def value_of(table: pd.DataFrame, trial: str, measure: str, rung: str, column: str) -> Any:
    """One number of the ladder."""
    chosen = table[(table["trial"] == trial) & (table["measure"] == measure) & (table["rung"] == rung)]
    return chosen[column].to_numpy()[0]


def _interval(squares: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Bootstrap interval of the RMS, over the intervals."""
    drawn = rng.integers(0, squares.size, (BOOTSTRAP, squares.size))
    low, high = np.percentile(np.sqrt(squares[drawn].mean(axis=1)), INTERVAL)
    return float(low), float(high)


def change(before: Array, after: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Bootstrap interval of the RMS after over that before, the same intervals drawn for both."""
    drawn = rng.integers(0, before.size, (BOOTSTRAP, before.size))
    low, high = np.percentile(np.sqrt(after[drawn].mean(axis=1) / before[drawn].mean(axis=1)), INTERVAL)
    return float(low), float(high)


def ladder(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per trial, measure and rung: RMS in deg with its interval, the floor, and the share of the gap closed so far."""
    held, floor = of_kind(rows, "held"), of_kind(rows, "floor")
    rng = np.random.default_rng(0)
    out = []
    named = sorted({(str(row["unit"]), str(row["trial"])) for row in records(held)})
    for unit, trial in [*named, (EVERY, EVERY)]:
        own = held if trial == EVERY else held[held["trial"] == trial]
        under = floor if trial == EVERY else floor[floor["trial"] == trial]
        for measure, column in MEASURES.items():
            first = own[own["name"] == RUNGS[0]][column].to_numpy(float)
            least = float(under[column].mean())
            for name in RUNGS:
                squares = own[own["name"] == name][column].to_numpy(float)
                low, high = _interval(squares, rng)
                gap = first.mean() - least
                out.append(
                    {
                        "unit": unit,
                        "trial": trial,
                        "measure": measure,
                        "rung": name,
                        "intervals": squares.size,
                        "rms_deg": float(np.sqrt(squares.mean())),
                        "low_deg": low,
                        "high_deg": high,
                        "floor_deg": float(np.sqrt(least)),
                        "closed": float((first.mean() - squares.mean()) / gap) if gap > 0 else np.nan,
                    }
                )
    return pd.DataFrame(out)


def wide(table: pd.DataFrame) -> pd.DataFrame:
    """The ladder for people: a row per trial, "end / series" in deg, and the 90 % interval of the last."""
    out = []
    for trial in table["trial"].unique():
        cell = partial(value_of, table, trial)
        row = {"unit": cell("end", LAST, "unit"), "trial": trial}
        for name in RUNGS:
            row[name] = " / ".join(f"{cell(measure, name, 'rms_deg'):.2f}" for measure in MEASURES)
        row["90 % of the last"] = " / ".join(
            f"{cell(measure, LAST, 'low_deg'):.2f}–{cell(measure, LAST, 'high_deg'):.2f}" for measure in MEASURES
        )
        row["floor"] = " / ".join(f"{cell(measure, LAST, 'floor_deg'):.2f}" for measure in MEASURES)
        out.append(row)
    return pd.DataFrame(out)


def tried(rows: pd.DataFrame) -> pd.DataFrame:
    """What was tried beside the last rung: RMS over all trials, and its ratio to that rung with a 90 % interval."""
    keys = ["unit", "trial", "interval"]
    base = of_kind(rows, "held")
    base = base[base["name"] == LAST].set_index(keys).sort_index()
    rng = np.random.default_rng(0)
    out = []
    for name, part in of_kind(rows, "tried").groupby("name", sort=False):
        other = part.set_index(keys).sort_index()
        same = base.loc[other.index]
        for measure, column in MEASURES.items():
            before, after = same[column].to_numpy(float), other[column].to_numpy(float)
            low, high = change(before, after, rng)
            ratio = float(np.sqrt(after.mean() / before.mean()))
            out.append(
                {
                    "tried": name,
                    "measure": measure,
                    "rms_deg": float(np.sqrt(after.mean())),
                    "ratio": ratio,
                    "ratio_low": low,
                    "ratio_high": high,
                }
            )
    return pd.DataFrame(out)


def diagnoses(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per trial and turn: verdict, probabilities, causes with their sizes."""
    out = []
    causes = of_kind(rows, "cause")
    for row in records(of_kind(rows, "diagnosis").sort_values(["turn", "unit", "trial"])):
        own = causes[(causes["trial"] == row["trial"]) & (causes["turn"] == row["turn"])]
        text = "; ".join(f"{c['name']} {c['size']:.4g} ± {c['size_sigma']:.2g} {c['size_unit']}" for c in records(own))
        out.append(
            {
                "turn": "as recorded" if row["turn"] == 1 else "time offset undone",
                "unit": row["unit"],
                "trial": row["trial"],
                "verdict": row["text"],
                "late, probability": row["timing"],
                "unlisted, probability": row["unknown"],
                "causes": text,
                "likeliest explanation of the attitudes": f"{row['name']} ({row['probability']:.2f})",
            }
        )
    return pd.DataFrame(out)


def sizes(rows: pd.DataFrame) -> pd.DataFrame:
    """Time offset of each trial by itself against its unit's mean, and the offset found on the others."""
    own = of_kind(rows, "own")
    fits = of_kind(rows, "fit")
    fits = fits[fits["name"] == LAST]
    out = []
    for unit, part in own.groupby("unit", sort=True):
        mean = part["size"].mean()
        for row in records(part):
            others = fits[fits["trial"] == row["trial"]]["size"]
            out.append(
                {
                    "unit": unit,
                    "trial": row["trial"],
                    "offset_ms": 1e3 * row["size"],
                    "formal_sigma_ms": 1e3 * row["size_sigma"],
                    "from_unit_mean_ms": 1e3 * (row["size"] - mean) if len(part) > 1 else np.nan,
                    "on_others_ms": 1e3 * others.mean(),
                }
            )
    return pd.DataFrame(out)


def samples(rows: pd.DataFrame) -> pd.DataFrame:
    """What the samples show: share of the zero bin, repeats against chance."""
    out = []
    zero = of_kind(rows, "zero")
    for row in records(of_kind(rows, "repeats").sort_values(["unit", "trial"])):
        own = zero[zero["trial"] == row["trial"]]
        beside = own[own["bin"].abs() == 1]["count"].mean() if len(own) else np.nan
        out.append(
            {
                "unit": row["unit"],
                "trial": row["trial"],
                "zero_over_neighbours": float(own[own["bin"] == 0]["count"].sum() / beside) if beside else np.nan,
                "repeats": row["count"],
                "by_chance": row["expected"],
                "repeats_in_motion": row["moving_count"],
                "by_chance_in_motion": row["moving_expected"],
                "runs_of_two_or_more": row["long_runs"],
            }
        )
    return pd.DataFrame(out)


def remaining(rows: pd.DataFrame) -> pd.DataFrame:
    """What is left of the turns, a row per trial: mean squares over time as white error of the references plus a random walk.

    A turn over a time T has the variance 2 s² + w² T per axis; the share along the turn would be a third if it had no
    preference.
    """
    increments = of_kind(rows, "increments")
    info = {row["trial"]: row for row in records(of_kind(rows, "trial"))}
    out = []
    for (unit, trial), part in increments.groupby(["unit", "trial"], sort=True):
        weight = part["count"]
        mean = (part["series_deg2"] * weight).groupby(part["lag_s"]).sum() / weight.groupby(part["lag_s"]).sum()
        along = (part["parallel_deg2"] * weight).groupby(part["lag_s"]).sum() / weight.groupby(part["lag_s"]).sum()
        T = mean.index.to_numpy(float)
        # Relative errors are alike at all lags.
        X = np.column_stack([np.full(T.size, 6.0), 3.0 * T]) / mean.to_numpy()[:, None]
        white, walk = np.linalg.lstsq(X, np.ones(T.size), rcond=None)[0]
        by_rate = part.groupby("name")["series_deg2"].mean()
        out.append(
            {
                "unit": unit,
                "trial": trial,
                "rate_deg_s": info[trial]["rate"],
                "stated_sigma_deg": info[trial]["sigma"],
                "white_deg": float(np.sqrt(max(white, 0.0))),
                "stated_arw_deg_sqrt_s": info[trial]["arw"],
                "walk_deg_sqrt_s": float(np.sqrt(max(walk, 0.0))),
                "rms_0.05s_deg": float(np.sqrt(mean.iloc[0])),
                "rms_4s_deg": float(np.sqrt(mean.iloc[-1])),
                "faster_over_slower": float(np.sqrt(by_rate["faster"] / by_rate["slower"])),
                "share_along_turn": float((along / mean).mean()),
            }
        )
    return pd.DataFrame(out)
