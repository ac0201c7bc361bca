"""Sentences of the study of a real gyro, from its rows and tables."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import pandas as pd

from studies.validation.broad import ATTRIBUTION
from studies.validation.real_gyro.tables import (
    EVERY,
    LAST,
    RUNGS,
    change,
    of_kind,
    records,
    remaining,
    samples,
    sizes,
    tried,
    value_of,
)


def findings(rows: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    """What the rows and the ladder's table say, a sentence or two each."""
    every = partial(value_of, table, EVERY)
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
    found = of_kind(rows, "diagnosis")
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
    held = of_kind(rows, "held")
    keys = ["unit", "trial", "interval"]
    for before, after in pairwise(RUNGS):
        for unit, part in held.groupby("unit"):
            one = part[part["name"] == before].set_index(keys).sort_index()["series_deg2"].to_numpy(float)
            two = part[part["name"] == after].set_index(keys).sort_index()["series_deg2"].to_numpy(float)
            if np.allclose(one, two, rtol=1e-12):
                out.append(f"{after}, unit {unit}: not chosen by the other trials, or without any effect.")
                continue
            low, high = change(one, two, rng)
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
    tones = of_kind(rows, "tone")
    for row in records(tones):
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


def _range(values: pd.Series, digits: int) -> str:
    return f"{values.min():.{digits}f} to {values.max():.{digits}f}"
