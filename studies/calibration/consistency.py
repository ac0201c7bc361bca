"""Is the stated covariance consistent with the errors? Truths drawn from the prior, calibrated, and judged.

In the manner of simulation-based calibration (Talts et al. 2018, arXiv:1804.06788).

A case draws G and b from the study's dispersions, which are the prior: a normal about the a-priori value for each of the
twelve parameters. It calibrates with that prior, without it, and with the paper's covariance. If an estimator is consistent
then, over the cases, of its errors e and covariance P

- the whitened error y = L⁻¹ e, P = L Lᵀ, is standard normal: nees |y|² is χ² with 12 degrees of freedom,
  and e_j²/σ_j² with one,
- the k-sigma range covers the truth as often as it says,
- the rank of the truth within the posterior, u = Φ((x_true − x)/σ), is uniform; of the whole, u = χ²₁₂(|y|²).

`run_case` simulates, `check` judges. The cause of a failure is the mean of y (biased) or its spread about that mean
(over-confident, under-confident). The mean is tested by Hotelling's T², which a wrong sigma does not change, and the spread by
χ², which a bias does not change. All limits are Bonferroni's over one estimator's statistics, so that a consistent estimator
passes them all with at least the stated confidence.

The controls are estimators known to be wrong: the paper's covariance ("references only"), and the result with prior with its
sigmas scaled or half a sigma added to each parameter. The check is useless if one of them passes.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd
import scipy.stats
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gyrocal import NAMES, GyroParameters, calibrate
from gyrocal.arrays import Array
from simulator import scenario as scenarios
from studies.calibration import summaries
from studies.calibration.shared_truth import require_converged
from studies.montecarlo import statistics
from studies.montecarlo.dispersions import Dispersion, Normal, get_scenario_value
from studies.montecarlo.statistics import compute_binomial_band
from studies.montecarlo.study import Streams, Study, StudyConfig, dispersed, load_base_scenario, observed
from studies.report import panels
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.tables import Table, summarise_groups
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES, name_columns

# As large as the errors from the data alone, so that prior and data have similar weights.
PRIOR_SIGMA_G = 3e-4
PRIOR_SIGMA_DEG_H = 0.02

PATHS = tuple(f"gyro.true_G.{i}.{j}" for i in range(3) for j in range(3)) + tuple(f"gyro.true_bias_deg_s.{i}" for i in range(3))
TO_SI = np.array([1.0] * 9 + [np.deg2rad(1.0)] * 3)
ERRORS, SIGMAS = name_columns("error"), name_columns("sigma")
WHITE_COLUMNS = [f"white_{k + 1}" for k in range(12)]
WHOLE = "whole"
STATISTICS = 5  # of each parameter, and of the whole
CONSISTENT, OVER_CONFIDENT, UNDER_CONFIDENT = "consistent", "over-confident", "under-confident"
BIASED_ESTIMATOR = "biased"

# Expected verdict on each estimator.
EXPECTED_VERDICTS = {
    "with prior": CONSISTENT,
    "without prior": CONSISTENT,
    "references only": OVER_CONFIDENT,
    "sigma × 0.7": OVER_CONFIDENT,
    "sigma × 1.4": UNDER_CONFIDENT,
    "half a sigma added": BIASED_ESTIMATOR,
}
PERTURBED_CONTROLS = {"sigma × 0.7": (0.7, 0.0), "sigma × 1.4": (1.4, 0.0), "half a sigma added": (1.0, 0.5)}  # of "with prior"


def build_default_prior() -> dict[str, Dispersion]:
    """Build normals about the TRMM scenario's a-priori parameters."""
    gyro = scenarios.load("trmm").gyro
    means = [*np.ravel(gyro.apriori_G).tolist(), *gyro.apriori_bias_deg_s]
    sigmas = [PRIOR_SIGMA_G] * 9 + [PRIOR_SIGMA_DEG_H / 3600] * 3
    return {path: Normal(kind="normal", mean=mean, sigma=sigma) for path, mean, sigma in zip(PATHS, means, sigmas, strict=True)}


class ConsistencyConfig(StudyConfig):
    """What the study runs; its dispersions of the twelve true parameters are the prior."""

    cases: int = 400
    dispersions: dict[str, Dispersion] = Field(default_factory=build_default_prior)
    confidence: float = Field(default=0.99, gt=0.5, lt=1)  # probability that a consistent estimator passes all its checks
    bins: int = Field(default=20, ge=2, le=100)  # of the rank histograms

    @model_validator(mode="after")
    def _has_a_prior(self) -> "ConsistencyConfig":
        for path in PATHS:
            dispersion = self.dispersions.get(path)
            if not isinstance(dispersion, Normal) or dispersion.mode == "factor":
                raise ValueError(f"dispersions: {path} must be normal, absolute or an offset: it is the prior")
        if self.cases <= 2 * len(PATHS):
            raise ValueError(f"cases: more than {2 * len(PATHS)} are needed to judge {len(PATHS)} parameters together")
        if self.sampler != "random":
            raise ValueError('sampler: must be "random", since the limits are those of independent cases')
        return self


def compute_prior_moments(config: ConsistencyConfig) -> tuple[Array, Array]:
    """Compute mean (12,) and sigma (12,) of the prior; G dimensionless, b rad/s."""
    scenario = load_base_scenario(config)
    normals = [config.dispersions[path] for path in PATHS]
    means = [d.apply_draw(d.quantile(0.5), get_scenario_value(scenario, path)) for d, path in zip(normals, PATHS, strict=True)]
    return np.array(means) * TO_SI, np.array([d.sigma for d in normals if isinstance(d, Normal)]) * TO_SI


def run_case(config: ConsistencyConfig, case: int, streams: Streams) -> list[dict[str, object]]:
    """Calibrate a case: a row for each estimator with errors and sigmas, ppm and deg/h, and the whitened error."""
    scenario = dispersed(config, case)
    recording = observed(config, case, streams)
    mean, sigma = compute_prior_moments(config)
    truth = np.array([get_scenario_value(scenario, path) for path in PATHS]) * TO_SI
    start = GyroParameters.from_vector(mean)
    with_prior = require_converged(calibrate(recording, initial=start, apriori_covariance=np.diag(sigma**2)))
    results = {
        "with prior": with_prior,
        "without prior": require_converged(calibrate(recording, initial=start)),
        "references only": require_converged(calibrate(recording, initial=start, covariance_model="references only")),
    }
    rows = [build_estimate_row(name, result.parameters.vector - truth, result.covariance) for name, result in results.items()]
    for name, (scale, shift) in PERTURBED_CONTROLS.items():
        error = with_prior.parameters.vector - truth + shift * with_prior.sigma
        rows.append(build_estimate_row(name, error, scale**2 * with_prior.covariance))
    return rows


def build_estimate_row(estimator: str, error: Array, covariance: Array) -> dict[str, object]:
    """Build the row of an error (12,) and its stated covariance (12, 12); G dimensionless, b rad/s."""
    sigma = np.sqrt(np.diag(covariance))
    L = np.linalg.cholesky(covariance / np.outer(sigma, sigma))
    white = np.linalg.solve(L, error / sigma)
    values = np.concatenate([error * PPM_DEG_H, sigma * PPM_DEG_H, white]).tolist()
    row: dict[str, object] = {"estimator": estimator, "nees": float(white @ white)}
    return row | dict(zip([*ERRORS, *SIGMAS, *WHITE_COLUMNS], values, strict=True))


def normalise_errors(rows: pd.DataFrame) -> dict[str, Array]:
    """Normalise the errors of one estimator's rows to standard normal, (cases, d): each e/σ, and the whole, whitened."""
    normalised = rows[ERRORS].to_numpy() / rows[SIGMAS].to_numpy()
    return {**{name: normalised[:, [k]] for k, name in enumerate(NAMES)}, WHOLE: rows[WHITE_COLUMNS].to_numpy()}


def compute_ranks(y: Array) -> Array:
    """Compute the share of the posterior below the truth, (cases,), from errors (cases, d); by |y|² if d > 1."""
    if y.shape[1] == 1:
        return np.asarray(scipy.stats.norm.cdf(-y[:, 0]))
    return np.asarray(scipy.stats.chi2.cdf(np.sum(y**2, axis=1), y.shape[1]))


def count_ranks(y: Array, bins: int) -> NDArray[np.intp]:
    """Count the ranks in equal bins."""
    return np.bincount(np.minimum((compute_ranks(y) * bins).astype(int), bins - 1), minlength=bins)


def check(rows: pd.DataFrame, confidence: float = 0.99, bins: int = 20) -> pd.DataFrame:
    """Judge one estimator by its rows: value, limits and verdict of each parameter, and the whole, and statistic.

    The statistics are nees (mean over the cases per degree of freedom), mean (Hotelling's as F), spread (variance of y about
    its mean), coverage (value is the share of two sigma; limits are Wilson's about the share found) and rank (χ² of the
    histogram's uniformity). A consistent estimator passes everything with the stated confidence.
    """
    groups = normalise_errors(rows)
    statistic_confidence = 1 - (1 - confidence) / (STATISTICS * len(groups))
    parts = [_compute_statistics(y, statistic_confidence, bins).assign(parameter=name) for name, y in groups.items()]
    table = pd.concat(parts, ignore_index=True)
    return table[["parameter", "statistic", "value", "lower", "upper", "verdict"]]


def _compute_statistics(y: Array, confidence: float, bins: int) -> pd.DataFrame:
    """Compute all statistics of normalised errors (cases, d), each with limits of this confidence."""
    n, d = y.shape
    tail = (1 - confidence) / 2
    mean, square = y.mean(axis=0), np.sum(y**2, axis=1)
    hotelling = n * mean @ np.linalg.solve(np.atleast_2d(np.cov(y.T)), mean)
    nees = statistics.check_mean_nees(square, d, confidence)
    table: dict[str, list[float]] = {
        "nees": [nees.value / d, nees.lower / d, nees.upper / d],
        "mean": [(n - d) / (d * (n - 1)) * hotelling, 0.0, scipy.stats.f.isf(1 - confidence, d, n - d)],
        "spread": [y.var(axis=0, ddof=1).mean(), *scipy.stats.chi2.ppf([tail, 1 - tail], (n - 1) * d) / ((n - 1) * d)],
    }
    probability = summaries.SIGMA_LEVELS["95"]
    inside = int(np.sum(square <= scipy.stats.chi2.ppf(probability, d)))
    table["coverage"] = [probability, *statistics.compute_binomial_interval(inside, n, confidence)]
    counts = count_ranks(y, bins)
    table["rank"] = [np.sum((counts - n / bins) ** 2) / (n / bins), 0.0, scipy.stats.chi2.isf(1 - confidence, bins - 1)]
    out = pd.DataFrame.from_dict(table, orient="index", columns=["value", "lower", "upper"]).rename_axis("statistic")
    outside = (out["value"] < out["lower"]) | (out["value"] > out["upper"])
    spread_verdict = OVER_CONFIDENT if out["value"]["spread"] > 1 else UNDER_CONFIDENT
    cause = BIASED_ESTIMATOR if outside["mean"] and not outside["spread"] else spread_verdict
    causes = pd.Series({"mean": BIASED_ESTIMATOR, "spread": spread_verdict}).reindex(out.index, fill_value=cause)
    return out.assign(verdict=causes.where(outside, CONSISTENT)).reset_index()


def summarise_verdicts(checks: pd.DataFrame) -> str:
    """Summarise an estimator's verdicts: "consistent" if every statistic is, or the failures, the most frequent first."""
    failures = checks.loc[checks["verdict"] != CONSISTENT, "verdict"]
    return " and ".join(map(str, failures.value_counts().index)) if len(failures) else CONSISTENT


def judge(config: ConsistencyConfig, rows: pd.DataFrame) -> pd.DataFrame:
    """Apply `check` to each estimator, in one table."""
    parts = {name: check(rows[rows["estimator"] == name], config.confidence, config.bins) for name in EXPECTED_VERDICTS}
    return pd.concat([table.assign(estimator=name) for name, table in parts.items()], ignore_index=True)


def _build_verdict_table(checks: pd.DataFrame) -> pd.DataFrame:
    """Build a row an estimator: expected and actual verdict, and the statistics of all parameters together."""

    def summarise_estimator(table: pd.DataFrame) -> dict[str, object]:
        joint = table[table["parameter"] == WHOLE].set_index("statistic")
        nees = joint.loc["nees"]
        return {
            "expected": EXPECTED_VERDICTS[table["estimator"].iloc[0]],
            "verdict": summarise_verdicts(table),
            "statistics": len(table),
            "outside": int((table["verdict"] != CONSISTENT).sum()),
            "nees_per_dof": nees["value"],
            "nees_per_dof_low": nees["lower"],
            "nees_per_dof_high": nees["upper"],
            "spread": joint.loc["spread", "value"],
            "mean_F": joint.loc["mean", "value"],
        }

    return summarise_groups(checks, ["estimator"], summarise_estimator)


def _build_parameter_table(rows: pd.DataFrame, checks: pd.DataFrame) -> pd.DataFrame:
    """Build a row a parameter of one estimator."""
    errors, sigmas = rows[ERRORS].to_numpy(), rows[SIGMAS].to_numpy()
    table = summaries.tabulate_accuracy(errors, sigmas, NAMES, PPM_DEG_H_NAMES)
    columns = ["parameter", "unit", "formal_sigma", "spread_over_formal", "bias_in_standard_errors"]
    columns += [f"coverage_95{end}" for end in ("", "_low", "_high")]
    values = checks.pivot_table(index="parameter", columns="statistic", values="value").loc[list(NAMES)]
    return table[columns].assign(nees=values["nees"].to_numpy(), rank_chi2=values["rank"].to_numpy())


VERDICT_NOTE = (
    "The verdict on an estimator is consistent if all its statistics are within their limits; controls must be found out."
)


def report(config: ConsistencyConfig, rows: pd.DataFrame) -> Report:
    """Build the report: verdicts on the estimators that should be consistent and on the inconsistent controls."""
    judgements = judge(config, rows)
    verdicts = _build_verdict_table(judgements)
    lines = verdicts.to_dict("records")
    checks = [Check(line["estimator"], line["verdict"], line["expected"], "", VERDICT_NOTE) for line in lines]
    for line in verdicts[verdicts["expected"] == CONSISTENT].to_dict("records"):
        bounds = (line["nees_per_dof_low"], line["nees_per_dof_high"])
        checks.append(Check(f"mean NEES, {line['estimator']}", line["nees_per_dof"], bounds, "NEES/dof"))
        checks.append(Check(f"statistics outside their limits, {line['estimator']}", line["outside"], (0, 0)))
    with_prior = rows[rows["estimator"] == "with prior"]
    by_parameter = _build_parameter_table(with_prior, judgements[judgements["estimator"] == "with prior"])
    note = f"All statistics of an estimator together have a confidence of {config.confidence:.0%}."
    tables = {
        "verdicts": Table(f"Verdicts, {rows['case'].nunique()} cases", verdicts, note),
        "parameters": Table("With prior, by parameter (coverage with 95 % Wilson intervals)", by_parameter),
    }
    estimators = {name: normalise_errors(rows[rows["estimator"] == name])["G_xx"] for name in EXPECTED_VERDICTS}
    return Report(tables, {"ranks_by_estimator": _draw_rank_figure(config, estimators)}, tuple(checks))


def _draw_rank_figure(config: ConsistencyConfig, ranked: Mapping[str, Array]) -> panels.Draw:
    """Draw histograms of the true G_xx's rank, with a joint band of all bins of all panels."""
    n = len(next(iter(ranked.values())))
    band = compute_binomial_band(n, 1 / config.bins, 1 - (1 - config.confidence) / len(ranked), config.bins)
    counts = {name: count_ranks(y, config.bins) for name, y in ranked.items()}
    histograms = [panels.make_histogram(count, n / config.bins, band, title=name) for name, count in counts.items()]
    title = f"rank of the true G_xx within the posterior, by estimator; {n} cases, band {band[0]} to {band[1]} a bin"
    return panels.build_sheet(*histograms, size=(7.6, 0.5 + 1.45 * (len(ranked) // 3)), columns=3, title=title)


STUDY = Study("studies.calibration.consistency:STUDY", ConsistencyConfig, run_case, observed)
ENTRY = Entry(STUDY, "is the stated covariance consistent, and would it be noticed if it were not", report)
