"""Score the answers from the rows of cases: rates, proper scores of stated causes, sizes, shares; and compare two runs.

A cause that is stated with a probability p is right or not, o ∈ {0, 1}. z = (Σo − Σp)/√Σp(1 − p) of all stated causes is
standard normal if the probabilities are right; the log score is the mean of −ln of the probability of the true outcome, with
its standard error. Rates have Wilson's 95 % intervals.

McNemar's exact test compares two runs case by case: under equal quality each run has half of the cases that only one run
answers well.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array
from gyrocal.errors import InputError
from studies.montecarlo.statistics import compute_binomial_interval
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.panels import GREY, RED, TEAL, Draw, Line, build_sheet, make_curves
from studies.report.tables import Table
from studies.withheld.cases import STUDY, WithheldConfig
from studies.withheld.drawing import MIX

STRONG = 8.0  # signal-to-noise ratio from which an effect must be found
SURE, LIKELY = 0.9, 0.5  # probabilities of a statement
CERTAIN = 1e-3  # nearest to 0 or 1 that a probability counts as in the log score
GOOD = {  # outcomes that count as answered well
    "none": ("right",),
    "single": ("right",),
    "pair": ("right",),
    "withheld": ("right", "localised", "unknown"),
    "unlisted": ("right", "localised", "unknown"),
    "mixed": ("right",),
}
SNR_EDGES = (5.0, 8.0, 12.0, 20.0, 35.0, 100.0)


def is_answered_well(rows: pd.DataFrame) -> pd.Series:
    """Decide for each case whether it is answered well."""
    is_well = [outcome in GOOD[kind] for kind, outcome in zip(rows["kind"], rows["outcome"], strict=True)]
    return pd.Series(is_well, index=rows.index, dtype=bool)


def count_hits(what: str, hits: ArrayLike) -> dict[str, Any]:
    """Count hits, with their share and its 95 % binomial interval."""
    values = np.asarray(hits, dtype=bool)
    count, total = int(values.sum()), int(values.size)
    low, high = compute_binomial_interval(count, total)
    return {"what": what, "cases": total, "hits": count, "share": count / total if total else np.nan, "low": low, "high": high}


def collect_statements(rows: pd.DataFrame) -> pd.DataFrame:
    """Collect the stated causes: case, kind, whether each has a name, its probability p, and whether it is right."""
    statements = [
        {"case": case, "kind": kind, "named": statement["named"], "p": float(statement["p"]), "right": bool(statement["right"])}
        for case, kind, text in zip(rows["case"], rows["kind"], rows["statements"], strict=True)
        for statement in json.loads(text)
    ]
    table = pd.DataFrame(statements, columns=["case", "kind", "named", "p", "right"])
    return table.astype({"named": bool, "p": float, "right": bool})


def compute_rates(rows: pd.DataFrame) -> pd.DataFrame:
    """Compute the rates by kind, with their intervals."""
    kinds = {kind: rows[rows["kind"] == kind] for kind in MIX}
    stated = collect_statements(rows)
    sure, unnamed = stated[stated["named"] & (stated["p"] >= SURE)], stated[~stated["named"]]
    wrong = set(sure["case"][~sure["right"]])
    out = [count_hits("no effect: a false alarm", kinds["none"]["outcome"] == "alarm")]
    for kind, name in (("single", "one listed effect"), ("pair", "two listed effects")):
        strong = kinds[kind][kinds[kind]["snr"] >= STRONG]
        out.append(count_hits(f"{name} of SNR {STRONG:g} and more: right", strong["outcome"] == "right"))
        if kind == "single":
            in_set = [any(statement["in_set"] for statement in json.loads(text)) for text in strong["statements"]]
            out.append(count_hits(f"{name} of SNR {STRONG:g} and more: in the set of a cause", in_set))
    for kind in ("withheld", "unlisted"):
        strong = kinds[kind][kinds[kind]["snr"] >= STRONG]
        is_well = strong["outcome"].isin(GOOD[kind])
        out.append(count_hits(f"{kind}, SNR {STRONG:g} and more: localised or unknown", is_well))
        out.append(count_hits(f"{kind}: a wrong name at {SURE:g} and more", kinds[kind]["case"].isin(wrong)))
    out.append(count_hits(f"names stated at {SURE:g} and more that are right", sure["right"]))
    out.append(count_hits("random errors without a name: an effect acts on their side and axis", unnamed["right"]))
    out.append(count_hits("90 % set of explanations holds the truth", rows["truth_score"] <= DEFAULT.conformal))
    mixed = stated[stated["kind"] == "mixed"]
    out.append(count_hits("mixed: stated causes that are right", mixed["right"]))
    out.append(count_hits(f"mixed: listed effects of SNR {STRONG:g} and more found", list_strong_hits(kinds["mixed"])))
    measured = rows[rows["true_closed"].notna() & rows["closed_low"].notna()]
    covers = (measured["closed_low"] <= measured["true_closed"]) & (measured["true_closed"] <= measured["closed_high"])
    out.append(count_hits("90 % interval of the share closed holds the true share", covers))
    errors = collect_size_errors(rows)
    out += [count_hits(f"sizes within {level} sigma", np.abs(errors) <= level) for level in (1, 2)]
    return pd.DataFrame(out)


def list_strong_hits(rows: pd.DataFrame) -> list[bool]:
    """Decide for each strong listed effect of some cases whether a cause identifies it."""
    is_found = []
    for truth, statements in zip(rows["truth"], rows["statements"], strict=True):
        hits = {hit for cause in json.loads(statements) for hit in cause["hits"]}
        for number, effect in enumerate(json.loads(truth)):
            if effect["listed"] and effect["snr"] >= STRONG:
                is_found.append(number in hits)
    return is_found


def collect_size_errors(rows: pd.DataFrame) -> Array:
    """Collect (size − true size)/sigma of all causes that are simulated."""
    return np.array([error for text in rows["size_sigmas"] for error in json.loads(text)], dtype=float)


def score_statements(stated: pd.DataFrame) -> pd.DataFrame:
    """Score the causes stated at 0.9 and more, at 0.5 and more, and all."""
    levels = {f"at {SURE:g} and more": SURE, f"at {LIKELY:g} and more": LIKELY, "all": 0.0}
    parts = {name: stated[stated["p"] >= least] for name, least in levels.items()} | {"with a name": stated[stated["named"]]}
    return pd.DataFrame([_score_part(name, part) for name, part in parts.items()])


def _score_part(name: str, stated: pd.DataFrame) -> dict[str, Any]:
    p, right = stated["p"].to_numpy(), stated["right"].to_numpy(dtype=float)
    spread = float(np.sqrt(np.sum(p * (1 - p))))
    bounded = np.clip(p, CERTAIN, 1 - CERTAIN)
    log_scores = -np.log(np.where(right > 0, bounded, 1 - bounded))
    return {
        "stated": name,
        "causes": len(p),
        "right": int(right.sum()),
        "expected": float(p.sum()),
        "z": (right.sum() - p.sum()) / spread if spread > 0 else np.nan,
        "log_score": float(log_scores.mean()) if len(p) else np.nan,
        "log_score_se": float(log_scores.std(ddof=1) / np.sqrt(len(p))) if len(p) > 1 else np.nan,
    }


# ---- two runs --------------------------------------------------------------------------------------------------------------


def compare_runs(before: pd.DataFrame, after: pd.DataFrame) -> pd.DataFrame:
    """Compare two runs case by case, in all and by kind; an `InputError` if their cases are not the same."""
    keys = ["case", "kind", "effects"]
    before, after = (run.assign(well=is_answered_well(run)) for run in (before, after))
    both = before.merge(after, on="case", suffixes=("_before", "_after"), validate="one_to_one")
    if both.empty or any((both[f"{key}_before"] != both[f"{key}_after"]).any() for key in keys[1:]):
        raise InputError("compare: the two runs are not of the same cases; run both with the same --entropy")
    parts = {"all": both} | {kind: both[both["kind_after"] == kind] for kind in MIX}
    return pd.DataFrame([_compare_part(name, part) for name, part in parts.items() if len(part)])


def _compare_part(name: str, both: pd.DataFrame) -> dict[str, Any]:
    from scipy.stats import binomtest  # scipy.stats costs every worker 45 MiB, and no case needs it

    before, after = both["well_before"], both["well_after"]
    gained, lost = int((after & ~before).sum()), int((before & ~after).sum())
    comparison = {"kind": name, "cases": len(both), "well_before": int(before.sum()), "well_after": int(after.sum())}
    comparison |= {"gained": gained, "lost": lost, "p": binomtest(gained, gained + lost).pvalue if gained + lost else 1.0}
    comparison["seconds_ratio"] = both["diagnose_s_after"].sum() / max(both["diagnose_s_before"].sum(), 1e-9)
    comparison["mb_ratio"] = both["peak_mb_after"].median() / both["peak_mb_before"].median()
    return comparison


def read_run(path: Path) -> pd.DataFrame:
    """Read the rows of a run without an error; raises an `InputError` if the file is no table of this study."""
    try:
        rows = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise InputError(f"compare: {path} cannot be read as the table of a run ({error}); give its table.parquet") from None
    if "statements" not in rows:
        raise InputError(f"compare: {path} is not the table of a run of the study withheld")
    return rows[rows["error"] == ""].reset_index(drop=True)


# ---- report ----------------------------------------------------------------------------------------------------------------


def report(config: WithheldConfig, rows: pd.DataFrame) -> Report:
    """Build the report: tables, two figures, and the comparison with another run."""
    stated, failed = collect_statements(rows), config.cases - len(rows)
    tables = {
        "statements": Table("Stated causes", score_statements(stated)),
        "rates": Table("Rates, with 95 % binomial intervals", compute_rates(rows)),
    }
    if config.compare:
        before = read_run(Path(config.compare))
        tables["compare"] = Table("Against the run before, case by case", compare_runs(before, rows))
    scores, errors = score_statements(stated).set_index("stated")["z"], collect_size_errors(rows)
    rms = float(np.sqrt(np.mean(errors**2))) if errors.size else np.nan
    checks = (
        Check("cases whose diagnosis failed", float(failed), None),
        Check("z of all stated probabilities", float(scores["all"]), (-2.0, 2.0)),
        Check("RMS of (size − true size)/sigma", rms, None),
    )
    return Report(tables, {"found": draw_found(rows), "stated": draw_statements(stated)}, checks)


def draw_found(rows: pd.DataFrame) -> Draw:
    """Draw the share of single effects that are found, and of effects outside the library that are refused, over the SNR."""
    kinds = {"single": TEAL, "withheld": GREY, "unlisted": RED}
    lines = []
    for kind, colour in kinds.items():
        of_kind = rows[rows["kind"] == kind]
        groups = of_kind.groupby(np.digitize(of_kind["snr"], SNR_EDGES))
        shares = pd.DataFrame([count_hits("", is_answered_well(part)) | {"snr": part["snr"].median()} for _, part in groups])
        if len(shares):
            lines.append(Line(shares["snr"], shares["share"], kind, colour, "o-", shares["low"], shares["high"], bars=True))
    panel = make_curves(lines, x="SNR", y="answered well, 95 %", log="x", legend="lower right")
    return build_sheet(panel, size=(5.0, 3.4))


def draw_statements(stated: pd.DataFrame) -> Draw:
    """Draw right less expected statements, cumulated from the least sure one on, within two standard deviations."""
    sorted_ = stated.sort_values("p", kind="stable")
    p, right = sorted_["p"].to_numpy(), sorted_["right"].to_numpy(dtype=float)
    band, number = 2 * np.sqrt(np.cumsum(p * (1 - p))), np.arange(1, len(p) + 1)
    expected = Line(number, np.zeros(len(p)), "expected, 2 sigma", GREY, "-", -band, band)
    cumulated = Line(number, np.cumsum(right - p), "right − Σp", TEAL, "-")
    panel = make_curves([expected, cumulated], x="statements, the least sure first", y="right − expected", legend="lower left")
    return build_sheet(panel, size=(5.0, 3.4))


ENTRY = Entry(STUDY, "is the diagnosis right, also of effects that it cannot name", report)
