"""Tables, figures and sentences of the study of a real gyro, from its rows."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from studies.broad import ATTRIBUTION
from studies.figures import COLOURS, STYLE, save
from studies.real_gyro import LADDER
from studies.report import Draw, Report

Array = NDArray[np.float64]

RUNGS = ("M0", *(f"+ {effect}" for effect in LADDER))
LAST = RUNGS[-1]
BOOTSTRAP = 4000
INTERVAL = (5.0, 95.0)
EVERY = "all"
UNIT_COLOURS = ("#d1495b", "#00798c", "#30343f", "#edae49", "#66a182")
MEASURES = {"end": "end_deg2", "series": "series_deg2"}


def _kind(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    return rows[rows["kind"] == kind].reset_index(drop=True)


def _records(rows: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in rows.to_dict("records")]


def _value(table: pd.DataFrame, trial: str, measure: str, rung: str, column: str) -> Any:
    """One number of the ladder."""
    chosen = table[(table["trial"] == trial) & (table["measure"] == measure) & (table["rung"] == rung)]
    return chosen[column].to_numpy()[0]


def _interval(squares: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Bootstrap interval of the RMS, over the intervals."""
    drawn = rng.integers(0, squares.size, (BOOTSTRAP, squares.size))
    low, high = np.percentile(np.sqrt(squares[drawn].mean(axis=1)), INTERVAL)
    return float(low), float(high)


def _change(before: Array, after: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Bootstrap interval of the RMS after over that before, the same intervals drawn for both."""
    drawn = rng.integers(0, before.size, (BOOTSTRAP, before.size))
    low, high = np.percentile(np.sqrt(after[drawn].mean(axis=1) / before[drawn].mean(axis=1)), INTERVAL)
    return float(low), float(high)


def ladder(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per trial, measure and rung: RMS in deg with its interval, the floor, and the share of the gap closed so far."""
    held, floor = _kind(rows, "held"), _kind(rows, "floor")
    rng = np.random.default_rng(0)
    out = []
    named = sorted({(str(row["unit"]), str(row["trial"])) for row in _records(held)})
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
        cell = partial(_value, table, trial)
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
    base = _kind(rows, "held")
    base = base[base["name"] == LAST].set_index(keys).sort_index()
    rng = np.random.default_rng(0)
    out = []
    for name, part in _kind(rows, "tried").groupby("name", sort=False):
        other = part.set_index(keys).sort_index()
        same = base.loc[other.index]
        for measure, column in MEASURES.items():
            before, after = same[column].to_numpy(float), other[column].to_numpy(float)
            low, high = _change(before, after, rng)
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
    causes = _kind(rows, "cause")
    for row in _records(_kind(rows, "diagnosis").sort_values(["turn", "unit", "trial"])):
        own = causes[(causes["trial"] == row["trial"]) & (causes["turn"] == row["turn"])]
        text = "; ".join(f"{c['name']} {c['size']:.4g} ± {c['size_sigma']:.2g} {c['size_unit']}" for c in _records(own))
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
    own = _kind(rows, "own")
    fits = _kind(rows, "fit")
    fits = fits[fits["name"] == LAST]
    out = []
    for unit, part in own.groupby("unit", sort=True):
        mean = part["size"].mean()
        for row in _records(part):
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
    zero = _kind(rows, "zero")
    for row in _records(_kind(rows, "repeats").sort_values(["unit", "trial"])):
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
    increments = _kind(rows, "increments")
    info = {row["trial"]: row for row in _records(_kind(rows, "trial"))}
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


# --- Sentences ----------------------------------------------------------------------------------------------------------------


def _findings(rows: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    every = partial(_value, table, EVERY)
    steps = ", ".join(f"{name} {every('end', name, 'rms_deg'):.2f} / {every('series', name, 'rms_deg'):.2f}" for name in RUNGS)
    out = [
        f"Held-out attitude error, RMS in deg at an interval's end / over its series, {every('end', LAST, 'intervals')} "
        f"intervals with motion of {table['trial'].nunique() - 1} trials: {steps}. On simulated trials of the same "
        f"motion the same procedure leaves {every('end', LAST, 'floor_deg'):.2f} / {every('series', LAST, 'floor_deg'):.2f}. "
        f"The gap in mean square is closed by {100 * every('end', LAST, 'closed'):.0f} / "
        f"{100 * every('series', LAST, 'closed'):.0f} %."
    ]
    out += _verdicts(rows)
    out += _by_effect(rows, table)
    out += _tried_sentences(rows)
    out += _left(rows, table)
    out.append(ATTRIBUTION)
    return out


def _verdicts(rows: pd.DataFrame) -> list[str]:
    found = _kind(rows, "diagnosis")
    first, second = found[found["turn"] == 1], found[found["turn"] == 2]
    words = ", ".join(f"{verdict} {count}" for verdict, count in first["text"].value_counts().items())
    late = int((first["timing"] >= 0.9).sum())
    out = [
        f"Diagnosed alone against M0, {len(first)} trials: {words}. In {late} the explanations with a late gyro (time_offset "
        "or rate_lag, which are the same to first order) have a probability of 0.9 or more, also where the verdict is unknown."
    ]
    if len(second):
        words = ", ".join(f"{verdict} {count}" for verdict, count in second["text"].value_counts().items())
        out.append(
            f"Diagnosed again with the time offset found on the others undone: {words}; a late gyro then has a probability of "
            f"at most {second['timing'].max():.2g}."
        )
    return out


def _by_effect(rows: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    out = []
    offsets = sizes(rows)
    if len(offsets):
        words = []
        for unit, part in offsets.groupby("unit"):
            spread = f" (trials differ by {np.ptp(part['offset_ms']):.2f})" if len(part) > 1 else ""
            words.append(f"{unit} {part['offset_ms'].mean():.2f} ms{spread}")
        out.append(f"The gyro's tags are late: {', '.join(words)}.")
    shown = samples(rows)
    ratio = shown["zero_over_neighbours"].dropna()
    if len(ratio):
        out.append(
            f"While the rate sweeps through zero the bin of zero holds {ratio.min():.2f} to {ratio.max():.2f} times what its "
            "neighbours do: readings are cut toward zero (two), not rounded (one)."
        )
    words = [
        f"{unit} {part['repeats_in_motion'].sum():.0f} (by chance {part['by_chance_in_motion'].sum():.0f}; "
        f"{part['runs_of_two_or_more'].sum():.0f} runs of two or more anywhere)"
        for unit, part in shown.groupby("unit")
    ]
    out.append(f"Samples in motion that repeat the one before on all axes: {', '.join(words)}.")
    rng = np.random.default_rng(0)
    held = _kind(rows, "held")
    keys = ["unit", "trial", "interval"]
    for before, after in pairwise(RUNGS):
        for unit, part in held.groupby("unit"):
            one = part[part["name"] == before].set_index(keys).sort_index()["series_deg2"].to_numpy(float)
            two = part[part["name"] == after].set_index(keys).sort_index()["series_deg2"].to_numpy(float)
            if np.allclose(one, two, rtol=1e-12):
                out.append(f"{after}, unit {unit}: not chosen by the other trials, or without any effect.")
                continue
            low, high = _change(one, two, rng)
            better = int(np.count_nonzero(two < one))
            out.append(
                f"{after}, unit {unit}: the series RMS becomes {np.sqrt(two.mean() / one.mean()):.2f} times what it was (90 % "
                f"{low:.2f} to {high:.2f}), better in {better} of {one.size} intervals."
            )
    return out


def _tried_sentences(rows: pd.DataFrame) -> list[str]:
    table = tried(rows)
    series = table[table["measure"] == "series"]
    helped = series[series["ratio_high"] < 1]["tried"].tolist()
    hurt = series[series["ratio_low"] > 1]["tried"].tolist()
    neither = [name for name in series["tried"] if name not in helped and name not in hurt]
    words = [
        f"{label} {', '.join(names)}"
        for label, names in (("better", helped), ("worse", hurt), ("no clear change", neither))
        if names
    ]
    out = [f"Tried beside the last rung, by the 90 % interval of the series RMS on held-out data: {'; '.join(words)}."]
    tones = _kind(rows, "tone")
    for row in _records(tones):
        chance = 1 / max(row["count"], 1)
        error = abs(row["gain"]) * np.sqrt((1 / row["coherence"] - 1) * chance / 2)
        is_seen = row["coherence"] > 5 * chance and 0.5 < row["gain"] < 1.5
        verdict = (
            "they see it too: motion of the board, at least in part" if is_seen else "their noise hides whether it is motion"
        )
        out.append(
            f"The {row['name']} of trial {row['trial']} at {row['frequency']:.1f} Hz: coherence with the cameras at rest "
            f"{row['coherence']:.2f} (by chance {chance:.2f}), of its amplitude they see {row['gain']:.2f} ± {error:.2f}; "
            f"{verdict}."
        )
    return out


def _left(rows: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    left = remaining(rows)
    last = table[(table["rung"] == LAST) & (table["measure"] == "series") & (table["trial"] != EVERY)]
    over = (last["rms_deg"] / last["floor_deg"]).to_numpy(float)
    worst = last["trial"].to_numpy()[int(np.argmax(over))]
    out = [
        f"Unexplained: after all rungs the series RMS is {over.min():.1f} to {over.max():.1f} times the floor, most in trial "
        f"{worst}."
    ]
    if len(left) > 2:
        r = float(np.corrcoef(left["rate_deg_s"], left["walk_deg_sqrt_s"])[0, 1])
        times = left["walk_deg_sqrt_s"] / left["stated_arw_deg_sqrt_s"]
        white, walk = _range(left["white_deg"], 2), _range(left["walk_deg_sqrt_s"], 3)
        faster, along = _range(left["faster_over_slower"], 2), _range(left["share_along_turn"], 2)
        follows = "it may follow the rate" if r > 0.7 else "it does not grow with it"
        out += [
            f"What remains of turns over 0.05 to 4 s is like a white error of the references of {white} deg and a random walk "
            f"of {walk} deg/√s per axis, {_range(times, 0)} times that at rest.",
            f"Between trials that walk correlates with the rate by {r:.2f}: {follows}. Inside a trial the faster half has "
            f"{faster} times the RMS of the slower one, and {along} of the mean square is along the turn, where a third would "
            "be without preference.",
        ]
    return out


# --- Figures ------------------------------------------------------------------------------------------------------------------


def _range(values: pd.Series, digits: int) -> str:
    return f"{values.min():.{digits}f} to {values.max():.{digits}f}"


def _figure_ladder(table: pd.DataFrame, path: Path) -> Path:
    shown = table[table["measure"] == "series"]
    trials = shown["trial"].unique()
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 3.4), layout="constrained")
        axes = drawing.subplots()
        for k, name in enumerate(RUNGS):
            part = shown[shown["rung"] == name]
            x = np.arange(len(trials)) + 0.2 * (k - 1.5)
            rms = part["rms_deg"].to_numpy(float)
            spread = np.clip([rms - part["low_deg"], part["high_deg"] - rms], 0, None)
            axes.bar(x, rms, 0.18, yerr=spread, color=UNIT_COLOURS[k], label=name, error_kw={"lw": 0.8})
        floor = shown[shown["rung"] == LAST]["floor_deg"].to_numpy(float)
        axes.hlines(floor, np.arange(len(trials)) - 0.4, np.arange(len(trials)) + 0.4, color="0.2", lw=1.5, label="floor")
        units = shown.drop_duplicates("trial")["unit"]
        axes.set_xticks(range(len(trials)), [t if t == EVERY else f"{u} {t}" for u, t in zip(units, trials, strict=True)])
        axes.set_yscale("log")
        axes.set_ylabel("held-out error, RMS (deg)")
        axes.legend(ncols=5, fontsize=8, loc="lower right", bbox_to_anchor=(1, 1))
        return save(drawing, path)


def _figure_series(rows: pd.DataFrame, path: Path) -> Path:
    """The trial with the largest error before."""
    held = _kind(rows, "held")
    number = held[held["name"] == RUNGS[0]].groupby("trial")["series_deg2"].mean().idxmax()
    series = _kind(rows, "series")
    series = series[series["trial"] == number]
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 3.6), layout="constrained")
        panels = drawing.subplots(2, 1, sharex=True)
        for axes, name, words in zip(panels, (RUNGS[0], LAST), ("M0", "all found effects"), strict=True):
            for _, part in series[series["name"] == name].groupby("interval", sort=False):
                for axis in "xyz":
                    axes.plot(part["t_s"], part[f"error_{axis}"], color=COLOURS[axis], lw=1)
            axes.set_ylabel("error (deg)")
            axes.set_title(f"trial {number}, predicted from the other trials: {words}", loc="left", fontsize=9)
        panels[0].legend([f"{axis}" for axis in "xyz"], ncols=3, loc="upper right", fontsize=8)
        panels[1].set_xlabel("time (s)")
        return save(drawing, path)


def _figure_zero(rows: pd.DataFrame, path: Path) -> Path:
    zero = _kind(rows, "zero")
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(5.0, 3.0), layout="constrained")
        axes = drawing.subplots()
        for k, (unit, part) in enumerate(zero.groupby("unit")):
            total = part.groupby("bin")["count"].sum()
            away = total[total.index != 0].mean()
            axes.bar(total.index + 0.27 * (k - 1), total / away, 0.25, color=UNIT_COLOURS[k], label=f"unit {unit}")
        axes.axhline(1, color="0.3", lw=0.8)
        axes.axhline(2, color="0.3", lw=0.8, ls="--")
        axes.set_xlabel("reading (counts), while the rate sweeps through zero")
        axes.set_ylabel("relative to the other bins")
        axes.legend(fontsize=8)
        return save(drawing, path)


def _figure_sizes(table: pd.DataFrame, path: Path) -> Path:
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(5.0, 3.0), layout="constrained")
        axes = drawing.subplots()
        colour = {unit: UNIT_COLOURS[k] for k, unit in enumerate(sorted(table["unit"].unique()))}
        for k, row in enumerate(_records(table)):
            axes.errorbar(k, row["offset_ms"], 2 * row["formal_sigma_ms"], fmt="o", color=colour[row["unit"]], ms=4)
            axes.plot(k, row["on_others_ms"], "_", color="0.3", ms=12)
        axes.set_xticks(range(len(table)), [f"{u} {t}" for u, t in zip(table["unit"], table["trial"], strict=True)], fontsize=8)
        axes.set_ylabel("time offset (ms)")
        axes.set_title("own, ± 2 formal sigma; –: fitted on the others", loc="left", fontsize=9)
        return save(drawing, path)


def report(rows: pd.DataFrame) -> Report:
    """Findings, tables and figures."""
    table = ladder(rows)
    found, offsets = diagnoses(rows), sizes(rows)
    tables = {
        "Held-out error, RMS per rung": table,
        "Diagnosis of each trial": found,
        "Time offset per trial and unit": offsets,
        "Samples": samples(rows),
        "Tried beside the last rung": tried(rows),
        "What remains of the turns": remaining(rows),
    }
    figures: dict[str, Draw] = {
        "ladder": partial(_figure_ladder, table),
        "series": partial(_figure_series, rows),
        "zero": partial(_figure_zero, rows),
    }
    if len(offsets):
        figures["offsets"] = partial(_figure_sizes, offsets)
    return Report(tuple(_findings(rows, table)), tables, figures, {"Held-out error, RMS per rung": wide(table)})
