"""The same data through different estimators: do they agree, how near the truth do they come, and what does each cost.

All minimise Σ θᵀ C⁻¹ θ with the same C for each interval, evaluated once at the a-priori parameters (`Problem` with "given"
covariances), so that answers may differ by their algorithm only:

- one iteration, full ψ: the recursive Davenport form, N section IV
- one iteration, linear ψ: its conventional form
- converged: the full ψ iterated, the last correction a matter of rounding
- least squares: `scipy.optimize.least_squares` over the full non-linear residual with derivatives by differences. It knows
  nothing of ψ and Θ and is the oracle for the rest.
- streaming: `RecursiveCalibrator`, sample by sample in Python, in some cases only. It weighs with the same C, as it evaluates
  C at the parameters it starts from.

The converged answer solves Σ Θᵀ C⁻¹ θ = 0. The exact gradient has J(θ)⁻¹ Θ = Θ − ½ [θ×] Θ + … in place of Θ; since θ × θ = 0
the two agree if C is a multiple of the unit matrix, as with equal reference sigmas on all axes. With unequal ones they part by
|θ| of a correction of size |θ|.

Columns that begin with "cost_" hold CPU times (`time.process_time`, ms). They are measurements: not the same in another run,
and no part of what must be bit-identical; only their ratios within a run mean something. A first evaluation in each process,
not counted, loads what is compiled.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pandas as pd
import scipy.optimize
from numpy.typing import NDArray
from pydantic import Field

from gyrocal import NAMES, GyroParameters, InputError, RecursiveCalibrator, attitude
from gyrocal.calibration.covariance import compute_residual_covariance
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.recording import Recording
from simulator.scenario import load, override
from studies.calibration.shared_truth import NoiseFreeSimulation, compute_rms, get_true_parameters
from studies.montecarlo.study import Streams, Study, StudyConfig, dispersed, observed
from studies.report import panels
from studies.report.checks import Check, bound_above
from studies.report.entry import Entry, Report
from studies.report.tables import Table, summarise_groups
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES, name_columns

Array = NDArray[np.float64]

ERRORS = name_columns("error")
FULL_PSI, LINEAR_PSI, CONVERGED = "one iteration, full ψ", "one iteration, linear ψ", "converged"
ORACLE, STREAMING = "least squares", "streaming"
AGREEMENT_G = 1e-9  # between the oracle and the converged answer
STREAMED_G = 1e-12  # between streaming and one iteration


class EstimatorsConfig(StudyConfig):
    """What the study runs.

    Attributes
    ----------
    iterations : of the converged estimator
    streaming_every : every such case also streams, at some 80 µs a sample
    """

    cases: int = 48
    iterations: int = Field(default=4, ge=2, le=20)
    streaming_every: int = Field(default=24, ge=1)


@dataclass(frozen=True)
class Estimate:
    """What an estimator found.

    Attributes
    ----------
    x : (12,) G dimensionless, b rad/s
    last_correction_G : largest element of G's last correction
    passes : over the gyro stream
    """

    x: Array
    last_correction_G: float
    passes: int


def compute_interval_covariances(problem: Problem, x: Array) -> Array:
    """C (intervals, 3, 3) of each interval's residual at parameters (12,), rad².

    Raises
    ------
    InputError
        An interval has several residuals, or two share a reference: then a C of each would not be their covariance.
    """
    prepared = problem.measurements
    groups = np.diff(problem.groups[1], prepend=0)
    if (groups > 1).any():
        raise InputError("estimators: the intervals must have references at their ends only, and not touch")
    R = propagate(prepared.arcs, x[:9].reshape(3, 3), x[9:]).R
    V = compute_residual_covariance(R, *problem.references, problem.walk)
    return np.array([V[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(R))])


def whiten_nonlinear_residuals(problem: Problem, x: Array) -> Array:
    """The full non-linear residuals L⁻¹ θ (3m,), C = L Lᵀ, at parameters (12,), without any sensitivity."""
    prepared = problem.measurements
    R = propagate(prepared.arcs, x[:9].reshape(3, 3), x[9:]).R
    theta = attitude.residual(problem.A[prepared.row], R @ problem.A[prepared.start])
    assert problem.given is not None
    L = np.linalg.cholesky(problem.given[prepared.arcs.arc])
    return np.linalg.solve(L, theta[..., None]).ravel()


def fit_davenport(problem: Problem, start: Array, iterations: int, psi: str) -> Estimate:
    """Davenport's form with a fixed number of iterations; the pass that evaluates the last residual is counted."""
    found = problem.iterate(start, iterations, "linear" if psi == "linear" else "full").x
    return Estimate(found[-1], float(np.abs(found[-1] - found[-2])[:9].max()), iterations + 1)


def fit_least_squares(problem: Problem, start: Array) -> Estimate:
    """The non-linear minimum by scipy."""
    # Its differences reach 6e-6 of a unit: 3e-6 in G, where truncation and rounding of the derivatives are both near 1e-10.
    scale = 50 * PLAUSIBLE_RANGE
    passes = [0]

    def evaluate_residuals(step: Array) -> Array:
        passes[0] += 1
        return whiten_nonlinear_residuals(problem, start + scale * step)

    found = scipy.optimize.least_squares(evaluate_residuals, np.zeros(12), jac="3-point", xtol=1e-13, ftol=1e-15, gtol=None)
    # It asks for a lower cost, which is flat to rounding while the parameters are still up to 1e-9 off: so one step more.
    step = found.x - np.linalg.lstsq(found.jac, found.fun)[0]
    return Estimate(start + scale * step, float("nan"), passes[0])


def run_recursive_calibrator(problem: Problem, recording: Recording, start: Array) -> Estimate:
    """One iteration of the recursive calibrator, one gyro sample at a time."""
    calibrator = RecursiveCalibrator(GyroParameters.from_vector(start), arw=recording.gyro.arw)
    prepared, sigma = problem.measurements, recording.attitudes.sigma
    arcs = prepared.arcs
    for j in range(len(prepared.row)):
        calibrator.start(problem.A[prepared.start[j]], sigma[prepared.start[j]])
        for k in range(arcs.first[j], arcs.last[j]):
            calibrator.sample(arcs.rates[arcs.sample[k]], float(arcs.dt[k]))
        calibrator.finish(problem.A[prepared.row[j]], sigma[prepared.row[j]])
    x = calibrator.solve()[0].vector
    return Estimate(x, float(np.abs(x - start)[:9].max()), 1)


def fix_weights(seen: Recording, start: Array) -> Problem:
    """The problem whose weights are fixed, at the parameters (12,) it starts from."""
    prepared = prepare_measurements(seen)
    return Problem.build(seen, prepared, given=compute_interval_covariances(Problem.build(seen, prepared), start))


@lru_cache(maxsize=1)
def _load_compiled_code() -> None:
    """Load what is compiled, once a process, with a recording of a few samples."""
    flown = NoiseFreeSimulation.simulate(override(load("trmm"), {"gyro.sample_s": 60.0}))
    seen, start = flown.plain, flown.initial
    problem = fix_weights(seen, start)
    for run in _prepare_runs(problem, seen, start, 1, True).values():
        run()


def _prepare_runs(
    problem: Problem, seen: Recording, start: Array, iterations: int, streams: bool
) -> dict[str, Callable[[], Estimate]]:
    """Every estimator, ready to run."""
    runs: dict[str, Callable[[], Estimate]] = {
        FULL_PSI: partial(fit_davenport, problem, start, 1, "full"),
        LINEAR_PSI: partial(fit_davenport, problem, start, 1, "linear"),
        CONVERGED: partial(fit_davenport, problem, start, iterations, "full"),
        ORACLE: partial(fit_least_squares, problem, start),
    }
    return runs | ({STREAMING: partial(run_recursive_calibrator, problem, seen, start)} if streams else {})


def run_case(config: EstimatorsConfig, case: int, streams: Streams) -> list[dict[str, object]]:
    """A row for each estimator: errors against the truth, difference to the oracle, and the cost."""
    _load_compiled_code()
    seen = observed(config, case, streams)
    truth = get_true_parameters(dispersed(config, case)).vector
    start = GyroParameters(seen.gyro.apriori_G, seen.gyro.apriori_bias).vector
    problem = fix_weights(seen, start)
    # Packs the stream as well, which all but streaming share.
    sigma = np.sqrt(np.diag(problem.iterate(start, 1).P))
    found, cost = {}, {}
    for name, run in _prepare_runs(problem, seen, start, config.iterations, case % config.streaming_every == 0).items():
        begun = time.process_time()
        found[name] = run()
        cost[name] = 1e3 * (time.process_time() - begun)
    rows: list[dict[str, object]] = []
    for name, estimate in found.items():
        error, apart = estimate.x - truth, np.abs(estimate.x - found[ORACLE].x)
        row: dict[str, object] = {
            "estimator": name,
            "objective": float(np.sum(whiten_nonlinear_residuals(problem, estimate.x) ** 2)),
            "from_oracle_G": float(apart[:9].max()),
            "from_oracle_deg_h": float(apart[9:].max() * PPM_DEG_H[-1]),
            "from_full_psi_G": float(np.abs(estimate.x - found[FULL_PSI].x)[:9].max()),
            "last_correction_G": None if np.isnan(estimate.last_correction_G) else estimate.last_correction_G,
            "error_rms_G": compute_rms(error[:9]),
            "error_rms_deg_h": compute_rms(error[9:]) * PPM_DEG_H[-1],
            "error_in_sigmas": compute_rms(error / sigma),
            "passes": estimate.passes,
        }
        row |= dict(zip(ERRORS, (error * PPM_DEG_H).tolist(), strict=True))
        rows.append(row | {"cost_cpu_ms": cost[name]})
    return rows


STUDY = Study("studies.calibration.estimators:STUDY", EstimatorsConfig, run_case, observed)


def summarise_estimators(rows: pd.DataFrame) -> pd.DataFrame:
    """A row an estimator: agreement with the oracle, accuracy against the truth, and cost by that of one iteration."""
    one = rows[rows["estimator"] == FULL_PSI].set_index("case")["cost_cpu_ms"]

    def line(part: pd.DataFrame) -> dict[str, object]:
        return {
            "cases": len(part),
            "from_oracle_G_max": part["from_oracle_G"].max(),
            "from_oracle_deg_h_max": part["from_oracle_deg_h"].max(),
            "error_rms_ppm": 1e6 * compute_rms(part["error_rms_G"]),
            "error_rms_deg_h": compute_rms(part["error_rms_deg_h"]),
            "error_in_sigmas": compute_rms(part["error_in_sigmas"]),
            "passes": part["passes"].mean(),
            "cost_cpu_ms": part["cost_cpu_ms"].median(),
            "cost_ratio": (part.set_index("case")["cost_cpu_ms"] / one).median(),
        }

    return summarise_groups(rows, ["estimator"], line)


def tabulate_parameter_errors(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a parameter: the RMS error of each estimator that ran in every case."""
    errors = rows[rows["estimator"] != STREAMING].groupby("estimator", sort=False)[ERRORS].agg(compute_rms)
    return pd.DataFrame(
        {"parameter": NAMES, "unit": PPM_DEG_H_NAMES, **{name: errors.loc[name].to_numpy() for name in errors.index}}
    )


AGREED = "Converged calibrator and oracle solve the same equations where the reference sigmas are the same on all axes."
STREAMING_NOTE = "Streaming sample by sample is one iteration with full ψ, to rounding."
COST = "Costs are CPU times, and their median ratio to one iteration with full ψ; they are not the same in another run."


def _build_checks(rows: pd.DataFrame) -> list[Check]:
    def largest(name: str, column: str) -> float:
        return float(rows.loc[rows["estimator"] == name, column].max())

    out = [
        Check(
            "converged from the oracle in G, largest", largest(CONVERGED, "from_oracle_G"), bound_above(AGREEMENT_G), "", AGREED
        ),
        Check("converged from the oracle in b, largest", largest(CONVERGED, "from_oracle_deg_h"), None, "deg/h"),
        Check("last correction of the converged in G, largest", largest(CONVERGED, "last_correction_G")),
        Check("linear from full ψ, one iteration, in G, largest", 1e6 * largest(LINEAR_PSI, "from_full_psi_G"), None, "ppm"),
    ]
    if (rows["estimator"] == STREAMING).any():
        apart = largest(STREAMING, "from_full_psi_G")
        out.append(Check("streaming from one iteration in G, largest", apart, bound_above(STREAMED_G), "", STREAMING_NOTE))
    return out


def report(config: EstimatorsConfig, rows: pd.DataFrame) -> Report:
    """Agreement, accuracy and cost."""
    tables = {
        "estimators": Table("Agreement, accuracy and cost", summarise_estimators(rows), COST),
        "parameters": Table("RMS error against the truth, by parameter", tabulate_parameter_errors(rows)),
    }
    return Report(tables, {"agreement": _draw_figure(rows)}, tuple(_build_checks(rows)))


def _draw_figure(rows: pd.DataFrame) -> panels.Draw:
    """Distance from the oracle of every case, beside the error that noise makes; no costs, so its bytes do not change."""
    of = {str(name): part["from_oracle_G"].clip(lower=1e-16) for name, part in rows.groupby("estimator", sort=False)}
    noise = rows.loc[rows["estimator"] == ORACLE, "error_rms_G"]
    distances = {name: of[name] for name in (LINEAR_PSI, FULL_PSI, STREAMING, CONVERGED) if name in of}
    axes: dict[str, Any] = {"log": "x", "at": [AGREEMENT_G], "x": "largest difference in G to the oracle; a stroke a case"}
    title = "dotted: limit of the agreement; red: RMS error of G by noise"
    return panels.build_sheet(panels.make_strokes(distances, (noise.min(), noise.max()), title=title, **axes), size=(7.0, 2.4))


ENTRY = Entry(STUDY, "Davenport's forms against non-linear least squares: same answer, at what cost", report)
