"""What the answers are worth, from the rows of cases.

The rows are those of `studies.validation.world.study`. An answer is a *detection* if it sees a misfit. Statements, rankings and
sets are scored in the terms of their own fields:

- **Reliability**: each cause that is stated has a probability p and is there or not, o ∈ {0, 1}. The Brier score is the mean of
  (p − o)², and the expected calibration error the mean over bins of |mean p − mean o|,
  weighted by the statements in them (Naeini, Cooper and Hauskrecht, AAAI 2015).
- **Unknown**: the stated probability of it orders detections of unlisted and of listed effects. Open-set AUC (Wang et al.,
  NeurIPS 2022) is the chance that a listed effect is rightly named *and* has less of it than an unlisted one.
- **Sizes**: d = (size − true size)/sigma; the shares within the normal quantiles, and the distribution of Φ(d), which is
  uniform where sigma and shape are right. Steps of lattices, limits and the like are read off the samples and stated to a few
  digits of a double: their sigma is a bound, not that of an estimate, and they are counted apart.
- **Conformal sets** (`diagnosis.inference.conformal`): the share that holds the truth, and their length.
- **Closure** of the right single cause: the share of the cases whose 90 % interval holds 1, what that cause closes on average.
- **Calibration**: of rightly answered cases one of the twelve parameters, another one from case to case since the sigmas are
  correlated, within 1 and 2 sigma.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import scipy.stats
from numpy.typing import ArrayLike, NDArray

from diagnosis.inference import conformal
from simulator.effects import EFFECTS
from studies.montecarlo.statistics import compute_binomial_interval
from studies.report.checks import Bounds, Check, bound_above, bound_below
from studies.validation.world.answers import CONFIDENT, GOOD, NAMING, compute_size_errors, label_effect

Array = NDArray[np.float64]

DETECTABLE, CLEAR = 8.0, 12.0  # SNR from which most effects must be seen, and unlisted ones told as such
STATED = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0 + 1e-9)
EXACT_SIZE_SIGMA = 1e-5  # of a size; a smaller sigma is that of digits
CREDIBLE_LEVELS = {"68 %": 0.6827, "95 %": 0.95, "99.7 %": 0.9973}
COVERAGE_NOTE = "The share of the cases, with its 95 % binomial interval in the table of rates."
ALL_AXES = ("x", "y", "z")


Row = dict[str, Any]


def list_records(rows: pd.DataFrame) -> list[Row]:
    """The rows one by one."""
    return [{str(key): value for key, value in row.items()} for row in rows.to_dict("records")]


def label_truth(row: Row) -> tuple[str, ...]:
    """Labels of what is in a recording; one outside the library is ``unknown``."""
    if row["kind"] in ("unlisted", "mixed"):
        return (conformal.UNKNOWN,)
    return tuple(row["effects"].split(" + ")) if row["effects"] else ()


def read_posterior(row: Row) -> list[tuple[list[str], float]]:
    """The posterior of an answer, an effect that is named about all axes and may act on all at once without an axis."""
    return [(_merge_axis_labels(one["effects"]), float(one["probability"])) for one in json.loads(row["posterior"])]


def _merge_axis_labels(labels: Sequence[str]) -> list[str]:
    out = list(labels)
    for name, effect in EFFECTS.items():
        each = [label_effect(name, axis) for axis in ALL_AXES]
        if effect.axis_optional and set(each) <= set(out):
            out = [one for one in out if one not in each] + [name]
    return out


# ---- rates ---------------------------------------------------------------------------------------------------------------


def compute_outcome_rates(rows: pd.DataFrame) -> pd.DataFrame:
    """Shares of the cases of each kind by what became of them, with their intervals."""
    kind = {name: rows[rows["kind"] == name] for name in ("none", "single", "pair", "unlisted", "mixed")}
    mixed = kind["mixed"]
    seen = kind["unlisted"][kind["unlisted"]["outcome"] != "missed"]
    clear = kind["unlisted"][kind["unlisted"]["snr"] >= CLEAR]
    told = ("right", "group")
    lines = [
        ("no effect: a false alarm", kind["none"], ("alarm",)),
        ("one effect: right or in the group", kind["single"], told),
        (f"one effect of SNR {DETECTABLE:g} and more: right or in the group", _select_strong(kind["single"]), told),
        ("one effect: exactly right", kind["single"], ("right",)),
        ("one effect: a confident wrong name", kind["single"], ("wrong name",)),
        ("two effects: both right or in the groups", kind["pair"], told),
        (f"two effects of SNR {DETECTABLE:g} and more: both right or in the groups", _select_strong(kind["pair"]), told),
        ("unlisted and detected: a confident wrong name", seen, ("wrong name",)),
        ("unlisted and detected: unknown", seen, ("unknown",)),
        (f"unlisted of SNR {CLEAR:g} and more: unknown", clear, ("unknown",)),
        (f"unlisted of SNR {CLEAR:g} and more, detected: unknown", clear[clear["outcome"] != "missed"], ("unknown",)),
        (f"unlisted of SNR {CLEAR:g} and more in the attitude: unknown", clear[clear["attitude_snr"] >= CLEAR], ("unknown",)),
        ("mixed: all that is named is there", mixed, ("part",)),
        ("mixed: unknown", mixed, ("unknown",)),
        ("mixed: a confident wrong name", mixed, ("wrong name",)),
    ]
    out = [build_rate_row(name, part["outcome"].isin(outcomes)) for name, part, outcomes in lines]
    causes = collect_cause_statements(mixed)
    out.append(build_rate_row("mixed: causes stated that are there", causes["there"]))
    out.append(
        build_rate_row("right single cause: 90 % interval of the closure holds 1", _test_closure_interval(kind["single"]))
    )
    out += [
        build_rate_row(f"G and b within {level} sigma, answered rightly", _test_calibration_errors(rows, level))
        for level in (1, 2)
    ]
    return pd.DataFrame(out)


def compute_mixed_rates(rows: pd.DataFrame) -> pd.DataFrame:
    """Rates of mixed recordings that the gap budget is judged by."""
    mixed = rows[rows["kind"] == "mixed"]
    causes = collect_cause_statements(mixed)
    sure = causes[causes["probability"] >= CONFIDENT]
    budget = mixed[mixed["true_closed"].notna() & mixed["closed_low"].notna()]
    holds = (budget["closed_low"] <= budget["true_closed"]) & (budget["true_closed"] <= budget["closed_high"])
    lines = [
        (f"causes stated at {CONFIDENT:g} and more that are there", sure["there"]),
        ("a confident wrong name", mixed["outcome"] == "wrong name"),
        ("90 % interval of the share closed holds the true one", holds),
    ]
    return pd.DataFrame([build_rate_row(name, hits) for name, hits in lines])


def _test_closure_interval(singles: pd.DataFrame) -> pd.Series:
    """Tell whether the interval holds 1, of rightly named causes that have one."""
    own = singles[(singles["outcome"] == "right") & singles["closed_low"].notna()]
    return (own["closed_low"] <= 1) & (own["closed_high"] >= 1)


def _test_calibration_errors(rows: pd.DataFrame, level: float) -> list[bool]:
    """Tell whether one parameter of each rightly answered case is within so many sigma."""
    errors = [json.loads(text) for text in rows[rows["outcome"] == "right"]["calibration_sigmas"]]
    return [abs(one[number % len(one)]) <= level for number, one in enumerate(errors) if one]


def _select_strong(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[rows["snr"] >= DETECTABLE]


def build_rate_row(name: str, hits: ArrayLike) -> dict[str, Any]:
    """Count hits under a name."""
    return {"what": name, **count_hits(hits)}


def count_hits(hits: ArrayLike) -> dict[str, Any]:
    """Count hits, with their share and its 95 % binomial interval."""
    values = np.asarray(hits, dtype=bool)
    count, of = int(values.sum()), int(values.size)
    low, high = compute_binomial_interval(count, of) if of else (np.nan, np.nan)
    return {"cases": of, "count": count, "share": count / of if of else np.nan, "low": low, "high": high}


def is_answered_well(rows: pd.DataFrame) -> pd.Series:
    """Tell of each case whether it is answered well."""
    good = [outcome in GOOD[kind] for kind, outcome in zip(rows["kind"], rows["outcome"], strict=True)]
    return pd.Series(good, index=rows.index, dtype=bool)


def count_good_by_group(rows: pd.DataFrame, column: str, sort: bool = True) -> pd.DataFrame:
    """Rates of right answers over the groups of a column, such as the kind of plan: no effect, one effect, unlisted."""
    out = []
    for (group, kind), part in rows.groupby([column, "kind"], sort=sort):
        wrong = int((part["outcome"] == "wrong name").sum())
        out.append({column: group, "kind": kind, **count_hits(is_answered_well(part)), "wrong_names": wrong})
    return pd.DataFrame(out)


# ---- statements ----------------------------------------------------------------------------------------------------------


def collect_cause_statements(rows: pd.DataFrame) -> pd.DataFrame:
    """Each cause that an answer states: its probability, and whether it is there."""
    out = []
    for row in list_records(rows):
        if row["verdict"] not in NAMING:
            continue
        truth = {label_effect(one["effect"], one["axis"]) for one in json.loads(row["truth"]) if one["listed"]}
        for cause in json.loads(row["causes"]):
            own = {label_effect(cause["effect"], cause["axis"]), cause["effect"]}
            out.append({"probability": cause["probability"], "there": bool(own & truth)})
    return pd.DataFrame(out, columns=["probability", "there"])


def compute_reliability(stated: pd.DataFrame) -> pd.DataFrame:
    """Mean probability stated and share that was there, in bins of what was stated."""
    out = []
    for low, high in pairwise(STATED):
        part = stated[(stated["probability"] >= low) & (stated["probability"] < high)]
        if len(part):
            found = count_hits(part["there"])
            line = {"from": low, "to": min(high, 1.0), "statements": len(part), "stated": float(part["probability"].mean())}
            out.append(line | {"there": found["share"], "low": found["low"], "high": found["high"]})
    return pd.DataFrame(out, columns=["from", "to", "statements", "stated", "there", "low", "high"])


def compute_calibration_error(table: pd.DataFrame) -> float:
    """Expected calibration error of a reliability table."""
    return float(np.average((table["stated"] - table["there"]).abs(), weights=table["statements"])) if len(table) else np.nan


def compute_brier_score(stated: pd.DataFrame) -> float:
    """Mean squared error of the probabilities."""
    return float(((stated["probability"] - stated["there"]) ** 2).mean())


# ---- rankings ------------------------------------------------------------------------------------------------------------


def collect_unknown_scores(rows: pd.DataFrame) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Stated probability of unknown of unlisted and of listed detections, and whether each of the latter is named rightly."""
    seen = rows[(rows["outcome"] != "missed") & ~rows["kind"].isin(["none", "mixed"])]
    unlisted, listed = seen[seen["kind"] == "unlisted"], seen[seen["kind"] != "unlisted"]
    right = listed["outcome"].isin(["right", "group"]).to_numpy()
    return unlisted["unknown_probability"].to_numpy(float), listed["unknown_probability"].to_numpy(float), right


def compute_open_set_auc(unlisted: Array, listed: Array, right: NDArray[np.bool_]) -> float:
    """Chance that a listed effect is named rightly and has less of unknown than an unlisted one, ties counted half."""
    if not unlisted.size or not listed.size:
        return np.nan
    below = (listed[:, None] < unlisted[None]) + 0.5 * (listed[:, None] == unlisted[None])
    return float((right[:, None] * below).mean())


# ---- sizes and sets ------------------------------------------------------------------------------------------------------


def collect_size_errors(rows: pd.DataFrame) -> pd.DataFrame:
    """(size − true size)/sigma of every cause that is there, and whether the size is read off the samples."""
    out = []
    for row in list_records(rows):
        truth = json.loads(row["truth"])
        for cause in json.loads(row["causes"]):
            exact = 0 < cause["sigma"] <= EXACT_SIZE_SIGMA * abs(cause["size"])
            out += [{"error": error, "exact": exact} for error in compute_size_errors([cause], truth)]
    return pd.DataFrame(out, columns=["error", "exact"]).astype({"error": float, "exact": bool})


def select_estimated_errors(rows: pd.DataFrame) -> Array:
    """(size − true size)/sigma of every cause that is there and has a size with the sigma of an estimate."""
    found = collect_size_errors(rows)
    return np.asarray(found["error"][~found["exact"]], dtype=float)


def compute_size_coverage(errors: Array) -> pd.DataFrame:
    """Shares of sizes within the sigmas of each level."""
    limits = {name: scipy.stats.norm.ppf(0.5 + level / 2) for name, level in CREDIBLE_LEVELS.items()}
    lines = [{"level": k, "expected": CREDIBLE_LEVELS[k], **count_hits(np.abs(errors) <= limit)} for k, limit in limits.items()]
    return pd.DataFrame(lines)


def build_size_coverage(rows: pd.DataFrame) -> pd.DataFrame:
    """The coverage of sizes that are estimated, of those read off the samples, and of all."""
    found = collect_size_errors(rows)
    parts = {"estimated": ~found["exact"], "read off the samples": found["exact"], "all": found["error"] == found["error"]}
    return pd.concat([compute_size_coverage(np.asarray(found["error"][own])).assign(sizes=name) for name, own in parts.items()])


def compute_set_coverage(rows: pd.DataFrame, limit: float) -> pd.DataFrame:
    """Share of conformal sets that hold the truth, and their mean length, of all recordings and of each kind."""
    sets = [conformal.build_conformal_set(read_posterior(row), limit) for row in list_records(rows)]
    holds = np.array(
        [conformal.name_of(label_truth(row)) in one for row, one in zip(list_records(rows), sets, strict=True)], bool
    )
    length = np.array([len(one) for one in sets], dtype=float)
    groups: list[tuple[str, Array]] = [("all", np.ones(len(rows), bool))]
    groups += [(str(kind), (rows["kind"] == kind).to_numpy()) for kind in sorted(set(rows["kind"]))]
    return pd.DataFrame(
        [build_rate_row(name, holds[part]) | {"mean_length": float(length[part].mean())} for name, part in groups]
    )


# ---- criteria ------------------------------------------------------------------------------------------------------------


def build_world_checks(rows: pd.DataFrame, limit: float) -> tuple[Check, ...]:
    """Check the criteria."""
    table = compute_outcome_rates(rows).set_index("what")
    stated = collect_cause_statements(rows)
    unlisted, listed, right = collect_unknown_scores(rows)
    levels = compute_size_coverage(select_estimated_errors(rows)).set_index("level")
    sets = compute_set_coverage(rows, limit).iloc[0]

    def of(name: str, bounds: Bounds, column: str = "share") -> Check:
        said = name if column == "share" else f"{name}, upper bound"
        return Check(said, float(table[column][name]), bounds, meaning=COVERAGE_NOTE)

    out = [
        of("no effect: a false alarm", bound_above(0.01)),
        of("no effect: a false alarm", bound_above(0.02), "high"),
        of(f"one effect of SNR {DETECTABLE:g} and more: right or in the group", bound_below(0.95)),
        of(f"two effects of SNR {DETECTABLE:g} and more: both right or in the groups", bound_below(0.85)),
        of("unlisted and detected: a confident wrong name", bound_above(0.05)),
        of("unlisted and detected: a confident wrong name", bound_above(0.07), "high"),
        of(f"unlisted of SNR {CLEAR:g} and more: unknown", bound_below(0.80)),
        Check("expected calibration error", compute_calibration_error(compute_reliability(stated)), bound_above(0.05)),
        Check("open-set AUC", compute_open_set_auc(unlisted, listed, right), bound_below(0.90)),
        Check("90 % conformal sets that hold the truth", float(sets["share"]), (0.87, 0.93)),
        Check("mean length of the conformal sets", float(sets["mean_length"]), bound_above(1.6)),
    ]
    for name, line in levels.iterrows():
        out.append(
            Check(
                f"sizes within {name}", float(line["share"]), _compute_share_bounds(int(line["cases"]), float(line["expected"]))
            )
        )
    return tuple(out)


def _compute_share_bounds(cases: int, share: float) -> Bounds:
    """Shares that are as likely as not to come from a true one, at 99 %."""
    low, high = scipy.stats.binom.interval(0.99, cases, share) if cases else (0.0, 0.0)
    return (float(low) / max(cases, 1), float(high) / max(cases, 1))


def summarise_scores(rows: pd.DataFrame) -> pd.DataFrame:
    """Summarise statements and rankings by one score a line."""
    stated = collect_cause_statements(rows)
    lines = {
        "Brier score of the stated probabilities": compute_brier_score(stated),
        "expected calibration error": compute_calibration_error(compute_reliability(stated)),
        "unknown: open-set AUC": compute_open_set_auc(*collect_unknown_scores(rows)),
    }
    return pd.DataFrame(list(lines.items()), columns=["score", "value"])
