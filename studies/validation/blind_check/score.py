"""Scoring: what a diagnosis said against what was in the recording, with Wilson intervals.

An answer is **right** if each effect in it is named, on its axis; **in the group** if what is there is among what the
diagnosis says could stand in the place of a cause. It is a **confident wrong name** if the verdict is "named" and a cause is
not in the recording nor has the truth in its group. An effect on all axes without one given counts as named when every
axis of it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from simulator.effects import EFFECTS
from studies.montecarlo.statistics import binomial_interval

Z95 = 1.959963984540054
DETECTABLE, CLEAR = 8.0, 12.0  # SNR from which the criteria count single effects, and unlisted ones
BINS = (4.0, 6.0, 8.0, 12.0, 20.0, 30.0, np.inf)
STATED = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-12)
FEWEST = 8  # statements in a bin of the reliability table that count for the criterion
SIZE_SIGMAS = 3.0
FLAGS = ("present", "exact", "in_group", "right_effect", "right_axis", "some_right", "wrong_name")
NUMBERS = (
    "probability", "unknown_probability", "closed", "closed_true", "G_error", "baseline_G_error", "runtime_s",
)  # fmt: skip


@dataclass(frozen=True)
class Scores:
    """What was counted.

    Attributes
    ----------
    rows : a row a case, as made by `case_row`
    criteria : criterion, asked, value, low, high, met, of
    table : rates with their intervals
    by_snr : detection and right causes over SNR bins, for single and for unlisted effects
    reliability : stated probability against frequency
    by_effect : counts for each effect, listed or not
    confusion : what was in, what was said, how often
    """

    rows: pd.DataFrame
    criteria: pd.DataFrame
    table: pd.DataFrame
    by_snr: pd.DataFrame
    reliability: pd.DataFrame
    by_effect: pd.DataFrame
    confusion: pd.DataFrame


def label(effect: str, axis: str | None) -> str:
    """Effect and axis, as in a group."""
    return effect if axis is None else f"{effect}:{axis}"


def merged(causes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Causes with an effect that is named on all three axes, and may act on all at once, as one without an axis."""
    out: list[dict[str, Any]] = []
    for cause in causes:
        effect = EFFECTS.get(cause["effect"])
        same = [other for other in causes if other["effect"] == cause["effect"]]
        if effect is None or not effect.axis_optional or {other["axis"] for other in same} != {"x", "y", "z"}:
            out.append(cause)
        elif cause is same[0]:
            whole = dict(cause)
            for key in ("size", "sigma", "probability"):
                whole[key] = float(np.mean([other[key] for other in same]))
            whole["axis"], whole["group"] = None, [cause["effect"], *(item for other in same for item in other["group"])]
            out.append(whole)
    return out


def case_row(answer: dict[str, Any], result: dict[str, Any], reached: float | None = None) -> dict[str, Any]:
    """A case's row.

    Parameters
    ----------
    answer, result : as written by the first and the second step
    reached : closure that the true model reaches, if known
    """
    truth = answer["effects"]
    unlisted = answer["unlisted"]
    labels = [label(one["effect"], one["axis"]) for one in truth]
    snrs = [one["snr"] for one in truth if one["snr"] is not None]
    row: dict[str, Any] = {
        "case": answer["case"],
        "kind": answer["kind"],
        "truth": " + ".join(labels) if unlisted is None else label(unlisted["effect"], unlisted["axis"]),
        "snr": unlisted["snr"] if unlisted else min(snrs, default=np.nan),
        "novelty": unlisted["novelty"] if unlisted else np.nan,
        "separate_snr": min((one["separate_snr"] for one in truth if one["separate_snr"] is not None), default=np.nan),
        "error": result["error"],
    }
    if result["error"]:
        empty = {"groups": "", "statements": [], "size_sigmas": []}
        return (
            row | {"verdict": "failed", "said": "failed"} | empty | dict.fromkeys(FLAGS, False) | dict.fromkeys(NUMBERS, np.nan)
        )
    found = result["diagnosis"]
    causes = merged(found["causes"])
    said = [label(cause["effect"], cause["axis"]) for cause in causes]
    wrong = [cause for cause in causes if not _in_group(cause, labels)]
    row |= {
        "verdict": found["verdict"],
        "said": " + ".join(said) if said and found["verdict"] in ("named", "group") else found["verdict"],
        "groups": " | ".join(",".join(cause["group"]) for cause in causes),
        "present": bool(found["gap"]["present"]),
        "exact": bool(labels) and sorted(said) == sorted(labels),
        "in_group": bool(labels) and len(said) == len(labels) and not wrong and _all_covered(causes, labels),
        "right_effect": bool(labels) and sorted(cause["effect"] for cause in causes) == sorted(one["effect"] for one in truth),
        "right_axis": _axes_right(causes, truth),
        "some_right": any(item in labels for item in said),
        "wrong_name": found["verdict"] == "named" and bool(wrong),
        "probability": float(np.prod([cause["probability"] for cause in causes])) if causes else np.nan,
        "unknown_probability": found["unknown_probability"],
        "statements": [[cause["probability"], label(cause["effect"], cause["axis"]) in labels] for cause in causes],
        "size_sigmas": size_errors(causes, truth),
        "closed": found["closure"]["closed"] if found["closure"] else np.nan,
        "closed_true": np.nan if reached is None else reached,
        "G_error": _error(found["calibration"]["G"], answer["true_G"]),
        "baseline_G_error": _error(found["calibration"]["baseline_G"], answer["true_G"]),
        "runtime_s": found["runtime_s"],
    }
    return row


def _in_group(cause: dict[str, Any], labels: Sequence[str]) -> bool:
    return label(cause["effect"], cause["axis"]) in labels or any(item in labels for item in cause["group"])


def _all_covered(causes: Sequence[dict[str, Any]], labels: Sequence[str]) -> bool:
    return all(
        any(item == label(cause["effect"], cause["axis"]) or item in cause["group"] for cause in causes) for item in labels
    )


def _axes_right(causes: Sequence[dict[str, Any]], truth: Sequence[dict[str, Any]]) -> bool:
    """Whether the axes named are those acted on, whatever the effect; a cause counts by its group where the truth is in it."""
    if len(causes) != len(truth) or not truth:
        return False
    labels = [label(one["effect"], one["axis"]) for one in truth]
    inside = [item for cause in causes for item in labels if item in cause["group"]]
    return sorted(inside) == sorted(labels) or sorted(str(cause["axis"]) for cause in causes) == sorted(
        str(one["axis"]) for one in truth
    )


def size_errors(causes: Sequence[dict[str, Any]], truth: Sequence[dict[str, Any]]) -> list[float]:
    """(size − true size)/sigma of each cause that is there, on its axis and, where there is one, towards the same other."""
    out = []
    for cause in causes:
        for one in truth:
            same = (cause["effect"], cause["axis"]) == (one["effect"], one["axis"])
            toward = one["parameters"].get("toward")
            if same and cause["parameters"].get("toward", toward) == toward and cause["sigma"]:
                out.append((cause["size"] - one["size"]) / cause["sigma"])
    return out


def _error(value: Any, true: Any) -> float:
    return float(np.sqrt(np.mean((np.array(value) - np.array(true)) ** 2)))


def scored(rows: pd.DataFrame) -> Scores:
    """All counts from the cases' rows."""
    good = rows[rows["error"] == ""].astype(dict.fromkeys(FLAGS, bool)).astype(dict.fromkeys(NUMBERS, float))
    return Scores(
        rows=rows,
        criteria=_criteria(good),
        table=_table(good),
        by_snr=_by_snr(good),
        reliability=reliability(_statements(good)),
        by_effect=_by_effect(good),
        confusion=_confusion(good),
    )


def _rate(name: str, values: Sequence[Any] | pd.Series) -> dict[str, Any]:
    """A proportion with its interval."""
    hits, total = int(np.sum(np.asarray(values, dtype=bool))), len(values)
    low, high = binomial_interval(hits, total)
    return {"what": name, "value": hits / total if total else np.nan, "low": low, "high": high, "hits": hits, "of": total}


def _of(rows: pd.DataFrame, kind: str, least: float | None = None, samples_too: bool = False) -> pd.DataFrame:
    """Cases of a kind, from an SNR on; effects that have none are left out unless asked for."""
    chosen = rows[rows["kind"] == kind]
    if least is None:
        return chosen
    strong = chosen["snr"] >= least
    return chosen[strong | chosen["snr"].isna()] if samples_too else chosen[strong]


def _size_errors_of(rows: pd.DataFrame) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Size errors in sigma of the causes in named cases."""
    named = rows[rows["verdict"] == "named"]
    return np.array([error for errors in named["size_sigmas"] for error in errors], dtype=float)


def _statements(rows: pd.DataFrame) -> list[tuple[float, bool]]:
    return [(float(p), bool(true)) for items in rows["statements"] for p, true in items]


def _table(rows: pd.DataFrame) -> pd.DataFrame:
    """All rates; criteria are a choice of them."""
    out: list[dict[str, Any]] = []
    none = _of(rows, "none")
    out.append(_rate("false alarm, nothing there", none["verdict"] != "none"))
    single = _of(rows, "one")
    for name, chosen in (
        (f"single, SNR ≥ {DETECTABLE:g}", _of(rows, "one", DETECTABLE)),
        (f"single, SNR < {DETECTABLE:g}", single[single["snr"] < DETECTABLE]),
        ("single, seen in the samples", single[single["snr"].isna()]),
    ):
        out += [
            _rate(f"{name}: detected", chosen["present"]),
            _rate(f"{name}: cause and axis exact", chosen["exact"]),
            _rate(f"{name}: cause exact or in group", chosen["exact"] | chosen["in_group"]),
            _rate(f"{name}: axis", chosen["right_axis"]),
            _rate(f"{name}: confident wrong name", chosen["wrong_name"]),
        ]
    pairs = _of(rows, "two")
    out += [
        _rate("pair: detected", pairs["present"]),
        _rate("pair: exact", pairs["exact"]),
        _rate("pair: exact or in groups", pairs["exact"] | pairs["in_group"]),
        _rate("pair: at least one of the two", pairs["some_right"]),
        _rate("pair: confident wrong name", pairs["wrong_name"]),
    ]
    novel = rows[(rows["kind"] == "unlisted") & (rows["novelty"] >= DETECTABLE)]
    for kind, name, chosen in (
        ("unlisted", "unlisted", _of(rows, "unlisted")),
        ("unlisted", f"unlisted, SNR ≥ {CLEAR:g}", _of(rows, "unlisted", CLEAR)),
        ("unlisted", f"unlisted, no listed effect explains all but {DETECTABLE:g} sigma of it", novel),
        ("withheld", "withheld", _of(rows, "withheld")),
    ):
        if len(_of(rows, kind)):
            out += [
                _rate(f"{name}: detected", chosen["present"]),
                _rate(f"{name}: unknown", chosen["verdict"] == "unknown"),
                _rate(f"{name}: group", chosen["verdict"] == "group"),
                _rate(f"{name}: confident wrong name", chosen["verdict"] == "named"),
            ]
    named = rows[rows["verdict"] == "named"]
    out.append(_rate("wrong, of all named", named["wrong_name"]))
    out.append(_rate(f"size within {SIZE_SIGMAS:g} sigma, of named and right", np.abs(_size_errors_of(rows)) <= SIZE_SIGMAS))
    return pd.DataFrame(out)


def _criteria(rows: pd.DataFrame) -> pd.DataFrame:
    """What was asked for, and whether it is met; a criterion without a case is left open."""
    rates = _table(rows).set_index("what")
    out: list[dict[str, Any]] = []

    def add(criterion: str, what: str, limit: float, at_most: bool = False, upper: float | None = None) -> None:
        if what not in rates.index or not rates.loc[what, "of"]:
            return
        rate: dict[str, Any] = {str(key): value for key, value in rates.loc[what].items()}
        met = rate["value"] <= limit if at_most else rate["value"] >= limit
        if upper is not None:
            met = met and rate["high"] <= upper
        asked = f"{'≤' if at_most else '≥'} {100 * limit:g} %" + (f", upper bound ≤ {100 * upper:g} %" if upper else "")
        out.append({"criterion": criterion, "asked": asked, **rate, "met": "yes" if met else "no"})

    strong = f"single, SNR ≥ {DETECTABLE:g}"
    clear = f"unlisted, SNR ≥ {CLEAR:g}"
    add("false alarms", "false alarm, nothing there", 0.02, at_most=True, upper=0.05)
    add(f"right cause or group, {strong}", f"{strong}: cause exact or in group", 0.95)
    add(f"right axis, {strong}", f"{strong}: axis", 0.95)
    add("pairs exact", "pair: exact", 0.80)
    add("unlisted: confident wrong name", "unlisted: confident wrong name", 0.05, at_most=True)
    add(f"{clear}: unknown", f"{clear}: unknown", 0.75)
    add("withheld: confident wrong name", "withheld: confident wrong name", 0.05, at_most=True)
    add("size within 3 sigma", f"size within {SIZE_SIGMAS:g} sigma, of named and right", 0.97)
    out += _reliability_criterion(rows) + _closure_criterion(rows)
    return pd.DataFrame(out, columns=["criterion", "asked", "value", "low", "high", "hits", "of", "met"])


def _reliability_criterion(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Calibrated: in every bin that has enough statements, the mean stated probability lies in the frequency's interval."""
    table = reliability(_statements(rows))
    enough = table[table["of"] >= FEWEST]
    if enough.empty:
        return []
    inside = (enough["stated"] >= enough["low"]) & (enough["stated"] <= enough["high"])
    rate = _rate("", inside)
    return [
        {
            "criterion": "stated probabilities calibrated, bins",
            "asked": "all inside",
            **rate,
            "met": "yes" if inside.all() else "no",
        }
    ]


def _closure_criterion(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Mean closure over the mean of what the true model reaches, with a 95 % interval of the ratio by the delta method."""
    chosen = rows.dropna(subset=["closed", "closed_true"])
    chosen = chosen[(chosen["kind"] == "one") & chosen["exact"] & (chosen["verdict"] == "named") & (chosen["snr"] >= CLEAR)]
    if chosen.empty:
        return []
    ratio = float(chosen["closed"].sum() / chosen["closed_true"].sum())
    rest = chosen["closed"] - ratio * chosen["closed_true"]
    half = Z95 * float(np.sqrt(np.mean(rest**2) / len(chosen))) / float(chosen["closed_true"].mean())
    return [
        {
            "criterion": f"closure over that of the true model, named, SNR ≥ {CLEAR:g}",
            "asked": "≥ 90 %",
            "value": ratio,
            "low": ratio - half,
            "high": ratio + half,
            "of": len(chosen),
            "hits": int(np.sum(chosen["closed"] >= 0.9 * chosen["closed_true"])),
            "met": "yes" if ratio >= 0.9 else "no",
        }
    ]


def _by_snr(rows: pd.DataFrame) -> pd.DataFrame:
    out = []
    for kind in ("one", "unlisted"):
        chosen = _of(rows, kind)
        for low, high in pairwise(BINS):
            inside = chosen[(chosen["snr"] >= low) & (chosen["snr"] < high)]
            if inside.empty:
                continue
            place = {"kind": kind, "snr_from": low, "snr_to": high, "snr": float(np.exp(np.log(inside["snr"]).mean()))}
            out.append(place | _rate("detected", inside["present"]))
            if kind == "one":
                out.append(place | _rate("right cause or group", inside["exact"] | inside["in_group"]))
            else:
                out.append(place | _rate("unknown", inside["verdict"] == "unknown"))
    return pd.DataFrame(out, columns=["kind", "snr_from", "snr_to", "snr", "what", "value", "low", "high", "hits", "of"])


def reliability(statements: Sequence[tuple[float, bool]]) -> pd.DataFrame:
    """Stated probability of a cause against how often it is there, in bins.

    Parameters
    ----------
    statements : probability, and whether it is so
    """
    out = []
    for low, high in pairwise(STATED):
        inside = [(p, true) for p, true in statements if low <= p < high]
        if inside:
            stated = float(np.mean([p for p, _ in inside]))
            out.append({"from": low, "to": min(high, 1.0), "stated": stated} | _rate("", [true for _, true in inside]))
    table = pd.DataFrame(out, columns=["from", "to", "stated", "what", "value", "low", "high", "hits", "of"])
    return table.drop(columns="what").rename(columns={"value": "frequency"})


def _effect_name(truth: str) -> str:
    return truth.partition(":")[0]


def _by_effect(rows: pd.DataFrame) -> pd.DataFrame:
    out = []
    for kind in ("one", "unlisted", "withheld"):
        chosen = _of(rows, kind)
        for name, part in chosen.groupby(chosen["truth"].map(_effect_name), sort=True):
            errors = _size_errors_of(part)
            out.append(
                {
                    "kind": kind,
                    "effect": name,
                    "cases": len(part),
                    "detected": int(part["present"].sum()),
                    "exact": int(part["exact"].sum()),
                    "exact or in group": int((part["exact"] | part["in_group"]).sum()),
                    "unknown": int((part["verdict"] == "unknown").sum()),
                    "group": int((part["verdict"] == "group").sum()),
                    "wrong name": int((part["verdict"] == "named").sum() if kind != "one" else part["wrong_name"].sum()),
                    "size off by sigma, rms": float(np.sqrt(np.mean(errors**2))) if errors.size else np.nan,
                }
            )
    return pd.DataFrame(out)


def _confusion(rows: pd.DataFrame) -> pd.DataFrame:
    """Effects without axes; pairs sorted."""
    truth = rows["truth"].map(_plain_names).where(rows["truth"] != "", "nothing")
    said = rows["said"].map(_plain_names)
    table = pd.DataFrame({"kind": rows["kind"], "truth": truth, "said": said})
    counted = table.groupby(["kind", "truth", "said"]).size().rename("cases").reset_index()
    return counted.sort_values(["kind", "truth", "cases"], ascending=[True, True, False], ignore_index=True)


def _plain_names(text: str) -> str:
    return " + ".join(sorted(part.partition(":")[0] for part in text.split(" + ")))
