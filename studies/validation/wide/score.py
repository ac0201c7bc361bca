"""What the answers of the wide check are worth, from its rows.

The rows are those of `studies.validation.wide.study`. An answer is a *detection* if it sees a gap. Statements, rankings and
sets are scored in the terms of their own fields:

- **Reliability**: each cause that is stated has a probability p and is there or not, o ∈ {0, 1}. The Brier score is the mean of
  (p − o)², the log score that of −log |1 − o − p|, and the expected calibration error the mean over bins of |mean p − mean o|,
  weighted by the statements in them (Naeini, Cooper and Hauskrecht, AAAI 2015).
- **Detection**: the p-value of the gap orders recordings with and without an effect; the area under its ROC is the chance that
  one with an effect has the smaller one.
- **Unknown**: the stated probability of it orders detections of unlisted and of listed effects. Open-set AUC (Wang et al.,
  NeurIPS 2022) is the chance that a listed effect is rightly named *and* has less of it than an unlisted one.
- **Risk against coverage** (El-Yaniv and Wiener, JMLR 11, 2010): of the answers with a cause, the share of wrong ones among
  the surest.
- **Sizes**: d = (size − true size)/sigma; the shares within the normal quantiles, and the distribution of Φ(d), which is
  uniform where sigma and shape are right. Steps of lattices, limits and the like are read off the samples and stated to a few
  digits of a double: their sigma is a bound, not that of an estimate, and they are counted apart.
- **Conformal sets** (`diagnosis.inference.conformal`): the share that holds the truth, and their length.

Closure is not scored: what the true model reaches on held-out data is not part of a row.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import scipy.stats
from numpy.typing import ArrayLike, NDArray

from diagnosis.inference import conformal
from simulator.effects import EFFECTS
from studies.montecarlo.statistics import binomial_interval
from studies.report.checks import Bounds, Check, at_least, at_most
from studies.validation.blind_check.score import label
from studies.validation.blind_check.score import size_errors as size_errors_of

Array = NDArray[np.float64]

DETECTABLE, CLEAR = 8.0, 12.0  # SNR from which most effects must be seen, and unlisted ones told as such
SNR_BINS = (5.0, 8.0, 12.0, 20.0, 35.0, np.inf)
STATED = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0 + 1e-9)
EXACT = 1e-5  # of a size; a smaller sigma is that of digits
LEVELS = {"68 %": 0.6827, "95 %": 0.95, "99.7 %": 0.9973}
UNIFORM = 0.01  # p-value of a test for the uniform distribution
WITHIN = "The share of the cases, with its 95 % binomial interval in the table of rates."
ALL_AXES = ("x", "y", "z")


Row = dict[str, Any]


def records(rows: pd.DataFrame) -> list[Row]:
    """The rows one by one."""
    return [{str(key): value for key, value in row.items()} for row in rows.to_dict("records")]


def truth_of(row: Row) -> tuple[str, ...]:
    """Labels of what is in a recording; an unlisted effect is ``unknown``."""
    if row["kind"] == "unlisted":
        return (conformal.UNKNOWN,)
    return tuple(row["effects"].split(" + ")) if row["effects"] else ()


def posterior_of(row: Row) -> list[tuple[list[str], float]]:
    """The posterior of an answer, an effect that is named about all axes and may act on all at once without an axis."""
    return [(_whole(one["effects"]), float(one["probability"])) for one in json.loads(row["posterior"])]


def _whole(labels: Sequence[str]) -> list[str]:
    out = list(labels)
    for name, effect in EFFECTS.items():
        each = [label(name, axis) for axis in ALL_AXES]
        if effect.axis_optional and set(each) <= set(out):
            out = [one for one in out if one not in each] + [name]
    return out


def truth_scores(rows: pd.DataFrame) -> list[float]:
    """Conformal score of the truth of each recording."""
    return [conformal.score(posterior_of(row), truth_of(row)) for row in records(rows)]


# ---- rates ---------------------------------------------------------------------------------------------------------------


def rates(rows: pd.DataFrame) -> pd.DataFrame:
    """Shares of the cases of each kind by what became of them, with their intervals."""
    kind = {name: rows[rows["kind"] == name] for name in ("none", "single", "pair", "unlisted")}
    seen = kind["unlisted"][kind["unlisted"]["outcome"] != "missed"]
    clear = kind["unlisted"][kind["unlisted"]["snr"] >= CLEAR]
    told = ("right", "group")
    lines = [
        ("no effect: a false alarm", kind["none"], ("alarm",)),
        ("one effect: right or in the group", kind["single"], told),
        (f"one effect of SNR {DETECTABLE:g} and more: right or in the group", _strong(kind["single"]), told),
        ("one effect: exactly right", kind["single"], ("right",)),
        ("one effect: a confident wrong name", kind["single"], ("wrong name",)),
        ("two effects: both right or in the groups", kind["pair"], told),
        (f"two effects of SNR {DETECTABLE:g} and more: both right or in the groups", _strong(kind["pair"]), told),
        ("unlisted and detected: a confident wrong name", seen, ("wrong name",)),
        ("unlisted and detected: unknown", seen, ("unknown",)),
        (f"unlisted of SNR {CLEAR:g} and more: unknown", clear, ("unknown",)),
        (f"unlisted of SNR {CLEAR:g} and more, detected: unknown", clear[clear["outcome"] != "missed"], ("unknown",)),
        (f"unlisted of SNR {CLEAR:g} and more in the attitude: unknown", _in_attitude(clear), ("unknown",)),
    ]
    return pd.DataFrame([_rate(name, part["outcome"].isin(outcomes)) for name, part, outcomes in lines])


def _in_attitude(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[rows["attitude_snr"] >= CLEAR]


def _strong(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[rows["snr"] >= DETECTABLE]


def _rate(name: str, hits: ArrayLike) -> dict[str, Any]:
    values = np.asarray(hits, dtype=bool)
    count, of = int(values.sum()), int(values.size)
    low, high = binomial_interval(count, of) if of else (np.nan, np.nan)
    return {"what": name, "cases": of, "count": count, "share": count / of if of else np.nan, "low": low, "high": high}


def by_group(rows: pd.DataFrame, column: str) -> pd.DataFrame:
    """Rates of right answers over the groups of a column, such as the kind of plan: no effect, one effect, unlisted."""
    wanted = {"none": ("right",), "single": ("right", "group"), "pair": ("right", "group"), "unlisted": ("unknown",)}
    out = []
    for (group, kind), part in rows.groupby([column, "kind"], sort=True):
        found = _rate(str(kind), part["outcome"].isin(wanted[str(kind)]))
        wrong = int((part["outcome"] == "wrong name").sum())
        out.append(
            {column: group, "kind": kind, **{k: found[k] for k in ("cases", "share", "low", "high")}, "wrong_names": wrong}
        )
    return pd.DataFrame(out)


# ---- statements ----------------------------------------------------------------------------------------------------------


def statements(rows: pd.DataFrame) -> pd.DataFrame:
    """Each cause that an answer states: its probability, and whether it is there."""
    out = []
    for row in records(rows):
        if row["verdict"] not in ("named", "group"):
            continue
        truth = set(truth_of(row))
        for cause in json.loads(row["causes"]):
            own = {label(cause["effect"], cause["axis"]), cause["effect"]}
            out.append({"probability": cause["probability"], "there": bool(own & truth)})
    return pd.DataFrame(out, columns=["probability", "there"])


def reliability(stated: pd.DataFrame) -> pd.DataFrame:
    """Mean probability stated and share that was there, in bins of what was stated."""
    out = []
    for low, high in pairwise(STATED):
        part = stated[(stated["probability"] >= low) & (stated["probability"] < high)]
        if len(part):
            found = _rate("", part["there"])
            out.append(
                {"from": low, "to": min(high, 1.0), "statements": len(part), "stated": float(part["probability"].mean()),
                 "there": found["share"], "low": found["low"], "high": found["high"]}
            )  # fmt: skip
    return pd.DataFrame(out, columns=["from", "to", "statements", "stated", "there", "low", "high"])


def calibration_error(table: pd.DataFrame) -> float:
    """Expected calibration error of a reliability table."""
    return float(np.average((table["stated"] - table["there"]).abs(), weights=table["statements"])) if len(table) else np.nan


def brier(stated: pd.DataFrame) -> float:
    """Mean squared error of the probabilities."""
    return float(((stated["probability"] - stated["there"]) ** 2).mean())


def log_score(stated: pd.DataFrame) -> float:
    """Mean of −log of the probability given to what was the case."""
    p = np.where(stated["there"], stated["probability"], 1 - stated["probability"])
    return float(-np.log(np.clip(p, 1e-12, None)).mean()) if len(stated) else np.nan


# ---- rankings ------------------------------------------------------------------------------------------------------------


def area(positive: ArrayLike, negative: ArrayLike) -> float:
    """Chance that a positive has the larger score than a negative, ties counted half: the area under the ROC."""
    a, b = np.asarray(positive, dtype=float), np.asarray(negative, dtype=float)
    if not a.size or not b.size:
        return np.nan
    ranks = scipy.stats.rankdata(np.concatenate([a, b]))
    return float((ranks[: a.size].sum() - a.size * (a.size + 1) / 2) / (a.size * b.size))


def roc(positive: ArrayLike, negative: ArrayLike) -> pd.DataFrame:
    """False and true positive rate at every score."""
    a, b = np.asarray(positive, dtype=float), np.asarray(negative, dtype=float)
    levels = np.unique(np.concatenate([a, b, [np.inf]]))[::-1] if a.size and b.size else np.empty(0)
    return pd.DataFrame(
        {"false_positive": [float((b >= x).mean()) for x in levels], "true_positive": [float((a >= x).mean()) for x in levels]}
    )


def detection_scores(rows: pd.DataFrame) -> Array:
    """−log10 of the p-value of the gap as a whole, in which a line that is a motion of the body has no part."""
    return np.asarray(-np.log10(np.maximum(rows["p_value"].to_numpy(float), 1e-300)))


def missed_by_snr(rows: pd.DataFrame, false_alarms: float = 0.01) -> pd.DataFrame:
    """Share of effects that are missed at a rate of false alarms, over the SNR."""
    score = detection_scores(rows)
    none = score[(rows["kind"] == "none").to_numpy()]
    if not none.size:
        return pd.DataFrame(columns=["from", "to", "what", "cases", "count", "share", "low", "high"])
    limit = float(np.quantile(none, 1 - false_alarms))
    out = []
    for low, high in pairwise(SNR_BINS):
        part = ((rows["snr"] >= low) & (rows["snr"] < high) & (rows["kind"] != "none")).to_numpy()
        if part.any():
            out.append({"from": low, "to": high, **_rate("missed", score[part] <= limit)})
    return pd.DataFrame(out)


def unknown_scores(rows: pd.DataFrame) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Stated probability of unknown of unlisted and of listed detections, and whether each of the latter is named rightly."""
    seen = rows[(rows["outcome"] != "missed") & (rows["kind"] != "none")]
    unlisted, listed = seen[seen["kind"] == "unlisted"], seen[seen["kind"] != "unlisted"]
    right = listed["outcome"].isin(["right", "group"]).to_numpy()
    return unlisted["unknown_probability"].to_numpy(float), listed["unknown_probability"].to_numpy(float), right


def open_area(unlisted: Array, listed: Array, right: NDArray[np.bool_]) -> float:
    """Chance that a listed effect is named rightly and has less of unknown than an unlisted one, ties counted half."""
    if not unlisted.size or not listed.size:
        return np.nan
    below = (listed[:, None] < unlisted[None]) + 0.5 * (listed[:, None] == unlisted[None])
    return float((right[:, None] * below).mean())


def false_positive_rate(unlisted: Array, listed: Array, recall: float = 0.95) -> float:
    """Share of listed effects that would be called unknown with a threshold that calls so much of the unlisted ones unknown."""
    if not unlisted.size or not listed.size:
        return np.nan
    return float((listed >= np.quantile(unlisted, 1 - recall, method="lower")).mean())


def risk_coverage(rows: pd.DataFrame) -> pd.DataFrame:
    """Share of wrong answers among the surest, over the share of answers taken; of recordings with a gap."""
    seen = rows[(rows["kind"] != "none") & rows["verdict"].isin(["named", "group"])]
    order = seen.sort_values("probability", ascending=False)
    wrong = ~order["outcome"].isin(["right", "group"]).to_numpy()
    count = np.arange(1, len(order) + 1)
    present = max(int(((rows["kind"] != "none") & (rows["outcome"] != "missed")).sum()), 1)
    return pd.DataFrame({"coverage": count / present, "risk": np.cumsum(wrong) / count})


# ---- sizes and sets ------------------------------------------------------------------------------------------------------


def sizes(rows: pd.DataFrame) -> pd.DataFrame:
    """(size − true size)/sigma of every cause that is there, and whether the size is read off the samples."""
    out = []
    for row in records(rows):
        truth = json.loads(row["truth"])
        for cause in json.loads(row["causes"]):
            exact = 0 < cause["sigma"] <= EXACT * abs(cause["size"])
            out += [{"error": error, "exact": exact} for error in size_errors_of([cause], truth)]
    return pd.DataFrame(out, columns=["error", "exact"]).astype({"error": float, "exact": bool})


def estimated(rows: pd.DataFrame) -> Array:
    """(size − true size)/sigma of every cause that is there and has a size with the sigma of an estimate."""
    found = sizes(rows)
    return np.asarray(found["error"][~found["exact"]], dtype=float)


def size_coverage(errors: Array) -> pd.DataFrame:
    """Shares of sizes within the sigmas of each level."""
    out = []
    for name, level in LEVELS.items():
        found = _rate(name, np.abs(errors) <= scipy.stats.norm.ppf(0.5 + level / 2))
        out.append({"level": name, "expected": level, **{k: found[k] for k in ("cases", "count", "share", "low", "high")}})
    return pd.DataFrame(out)


def size_table(rows: pd.DataFrame) -> pd.DataFrame:
    """The coverage of sizes that are estimated, of those read off the samples, and of all."""
    found = sizes(rows)
    parts = {"estimated": ~found["exact"], "read off the samples": found["exact"], "all": found["error"] == found["error"]}
    return pd.concat([size_coverage(np.asarray(found["error"][own])).assign(sizes=name) for name, own in parts.items()])


def set_coverage(rows: pd.DataFrame, limit: float) -> pd.DataFrame:
    """Share of conformal sets that hold the truth, and their mean length, of all recordings and of each kind."""
    sets = [conformal.conformal_set(posterior_of(row), limit) for row in records(rows)]
    holds = np.array([conformal.name_of(truth_of(row)) in one for row, one in zip(records(rows), sets, strict=True)], bool)
    length = np.array([len(one) for one in sets], dtype=float)
    groups: list[tuple[str, Array]] = [("all", np.ones(len(rows), bool))]
    groups += [(str(kind), (rows["kind"] == kind).to_numpy()) for kind in sorted(set(rows["kind"]))]
    return pd.DataFrame([_rate(name, holds[part]) | {"mean_length": float(length[part].mean())} for name, part in groups])


# ---- criteria ------------------------------------------------------------------------------------------------------------


def checks(rows: pd.DataFrame, limit: float) -> tuple[Check, ...]:
    """The criteria of the wide check."""
    table = rates(rows).set_index("what")
    stated = statements(rows)
    unlisted, listed, right = unknown_scores(rows)
    levels = size_coverage(estimated(rows)).set_index("level")
    sets = set_coverage(rows, limit).iloc[0]

    def of(name: str, bounds: Bounds, column: str = "share") -> Check:
        said = name if column == "share" else f"{name}, upper bound"
        return Check(said, float(table[column][name]), bounds, meaning=WITHIN)

    out = [
        of("no effect: a false alarm", at_most(0.01)),
        of("no effect: a false alarm", at_most(0.02), "high"),
        of(f"one effect of SNR {DETECTABLE:g} and more: right or in the group", at_least(0.95)),
        of(f"two effects of SNR {DETECTABLE:g} and more: both right or in the groups", at_least(0.85)),
        of("unlisted and detected: a confident wrong name", at_most(0.05)),
        of("unlisted and detected: a confident wrong name", at_most(0.07), "high"),
        of(f"unlisted of SNR {CLEAR:g} and more: unknown", at_least(0.80)),
        Check("expected calibration error", calibration_error(reliability(stated)), at_most(0.05)),
        Check("open-set AUC", open_area(unlisted, listed, right), at_least(0.90)),
        Check("90 % conformal sets that hold the truth", float(sets["share"]), (0.87, 0.93)),
        Check("mean length of the conformal sets", float(sets["mean_length"]), at_most(1.6)),
    ]
    for name, line in levels.iterrows():
        out.append(Check(f"sizes within {name}", float(line["share"]), _bounds(int(line["cases"]), float(line["expected"]))))
    return tuple(out)


def _bounds(cases: int, share: float) -> Bounds:
    """Shares that are as likely as not to come from a true one, at 99 %."""
    low, high = scipy.stats.binom.interval(0.99, cases, share) if cases else (0.0, 0.0)
    return (float(low) / max(cases, 1), float(high) / max(cases, 1))


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Scores of statements and rankings, one a line."""
    stated = statements(rows)
    score, none = detection_scores(rows), (rows["kind"] == "none").to_numpy()
    unlisted, listed, right = unknown_scores(rows)
    errors = estimated(rows)
    risk = risk_coverage(rows)
    lines: Iterable[tuple[str, Callable[[], float]]] = (
        ("Brier score of the stated probabilities", lambda: brier(stated)),
        ("log score of the stated probabilities", lambda: log_score(stated)),
        ("expected calibration error", lambda: calibration_error(reliability(stated))),
        ("detection: area under the ROC", lambda: area(score[~none], score[none])),
        ("unknown: area under the ROC", lambda: area(unlisted, listed)),
        ("unknown: open-set AUC", lambda: open_area(unlisted, listed, right)),
        ("unknown: false positive rate at 95 % recall", lambda: false_positive_rate(unlisted, listed)),
        ("risk averaged over the coverage", lambda: float(risk["risk"].mean())),
        (
            "sizes: p-value that Φ(d) is uniform",
            lambda: float(scipy.stats.kstest(errors, "norm").pvalue) if errors.size > 2 else np.nan,
        ),
    )
    return pd.DataFrame([(name, value()) for name, value in lines], columns=["score", "value"])
