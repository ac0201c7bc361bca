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
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import scipy.optimize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import Field

from gyrocal import NAMES, GyroParameters, InputError, RecursiveCalibrator, attitude
from gyrocal.calibration.covariance import FULL, residual_covariance
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import measurements
from gyrocal.recording import Recording
from simulator.scenario import load, override
from simulator.simulate import motion, observe
from studies.montecarlo.study import Streams, Study, StudyConfig, case_motion, dispersed
from studies.report import panels
from studies.report.entry import Entry, Report
from studies.report.tables import Table

Array = NDArray[np.float64]

SHOWN = np.array([1e6] * 9 + [np.rad2deg(1.0) * 3600] * 3)  # ppm, deg/h
ERRORS = [f"error_{name}_{unit}" for name, unit in zip(NAMES, ["ppm"] * 9 + ["deg_h"] * 3, strict=True)]
FULL_PSI, LINEAR_PSI, CONVERGED = "one iteration, full ψ", "one iteration, linear ψ", "converged"
ORACLE, STREAMING = "least squares", "streaming"
ESTIMATORS = (FULL_PSI, LINEAR_PSI, CONVERGED, ORACLE, STREAMING)
AGREEMENT_G = 1e-9  # between the oracle and the converged answer


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


def interval_covariances(problem: Problem, x: Array) -> Array:
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
    where = (prepared.arcs.arc, prepared.start, prepared.row, prepared.elapsed_s)
    V = residual_covariance(R, *where, problem.sigma, problem.arw, FULL, np.zeros((0, 3, 3)))
    return np.array([V[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(R))])


def residuals(problem: Problem, x: Array) -> Array:
    """The full non-linear residuals L⁻¹ θ (3m,), C = L Lᵀ, at parameters (12,), without any sensitivity."""
    prepared = problem.measurements
    R = propagate(prepared.arcs, x[:9].reshape(3, 3), x[9:]).R
    theta = attitude.residual(problem.A[prepared.row], R @ problem.A[prepared.start])
    assert problem.given is not None
    L = np.linalg.cholesky(problem.given[prepared.arcs.arc])
    return np.linalg.solve(L, theta[..., None]).ravel()


def davenport(problem: Problem, start: Array, iterations: int, psi: str) -> Estimate:
    """Davenport's form with a fixed number of iterations; the pass that evaluates the last residual is counted."""
    found = problem.iterate(start, iterations, "linear" if psi == "linear" else "full").x
    return Estimate(found[-1], float(np.abs(found[-1] - found[-2])[:9].max()), iterations + 1)


def least_squares(problem: Problem, start: Array) -> Estimate:
    """The non-linear minimum by scipy."""
    # Its differences reach 6e-6 of a unit: 3e-6 in G, where truncation and rounding of the derivatives are both near 1e-10.
    scale = 50 * PLAUSIBLE_RANGE
    passes = [0]

    def evaluated(step: Array) -> Array:
        passes[0] += 1
        return residuals(problem, start + scale * step)

    found = scipy.optimize.least_squares(evaluated, np.zeros(12), jac="3-point", xtol=1e-13, ftol=1e-15, gtol=None)
    # It asks for a lower cost, which is flat to rounding while the parameters are still up to 1e-9 off: so one step more.
    step = found.x - np.linalg.lstsq(found.jac, found.fun)[0]
    return Estimate(start + scale * step, float("nan"), passes[0])


def streamed(problem: Problem, recording: Recording, start: Array) -> Estimate:
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


def recording(config: EstimatorsConfig, case: int, streams: Streams) -> Recording:
    """What a case estimates from."""
    scenario = dispersed(config, case)
    noise = (streams.generator("gyro_noise"), streams.generator("reference_noise"))
    return observe(scenario, case_motion(scenario), gyro_rng=noise[0], reference_rng=noise[1])


def given_weights(seen: Recording, start: Array) -> Problem:
    """The problem whose weights are fixed, at the parameters (12,) it starts from."""
    prepared = measurements(seen)
    return Problem.of(seen, prepared, given=interval_covariances(Problem.of(seen, prepared), start))


@lru_cache(maxsize=1)
def _warm() -> None:
    """Load what is compiled, once a process, with a recording of a few samples."""
    scenario = override(load("trmm"), {"gyro.sample_s": 60.0})
    seen = observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None)
    start = GyroParameters(seen.gyro.apriori_G, seen.gyro.apriori_bias).vector
    problem = given_weights(seen, start)
    for run in _runs(problem, seen, start, 1, True).values():
        run()


def _runs(problem: Problem, seen: Recording, start: Array, iterations: int, streams: bool) -> dict[str, Callable[[], Estimate]]:
    """Every estimator, ready to run."""
    runs: dict[str, Callable[[], Estimate]] = {
        FULL_PSI: partial(davenport, problem, start, 1, "full"),
        LINEAR_PSI: partial(davenport, problem, start, 1, "linear"),
        CONVERGED: partial(davenport, problem, start, iterations, "full"),
        ORACLE: partial(least_squares, problem, start),
    }
    return runs | ({STREAMING: partial(streamed, problem, seen, start)} if streams else {})


def case(config: EstimatorsConfig, case: int, streams: Streams) -> list[dict[str, object]]:
    """A row for each estimator: errors against the truth, difference to the oracle, and the cost."""
    _warm()
    scenario = dispersed(config, case)
    seen = recording(config, case, streams)
    truth = GyroParameters(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s)).vector
    start = GyroParameters(seen.gyro.apriori_G, seen.gyro.apriori_bias).vector
    problem = given_weights(seen, start)
    # Packs the stream as well, which all but streaming share.
    sigma = np.sqrt(np.diag(problem.iterate(start, 1).P))
    found, cost = {}, {}
    for name, run in _runs(problem, seen, start, config.iterations, case % config.streaming_every == 0).items():
        begun = time.process_time()
        found[name] = run()
        cost[name] = 1e3 * (time.process_time() - begun)
    rows: list[dict[str, object]] = []
    for name, estimate in found.items():
        error, apart = estimate.x - truth, np.abs(estimate.x - found[ORACLE].x)
        row: dict[str, object] = {
            "estimator": name,
            "objective": float(np.sum(residuals(problem, estimate.x) ** 2)),
            "from_oracle_G": float(apart[:9].max()),
            "from_oracle_deg_h": float(apart[9:].max() * SHOWN[-1]),
            "from_full_psi_G": float(np.abs(estimate.x - found[FULL_PSI].x)[:9].max()),
            "last_correction_G": None if np.isnan(estimate.last_correction_G) else estimate.last_correction_G,
            "error_rms_G": float(np.sqrt(np.mean(error[:9] ** 2))),
            "error_rms_deg_h": float(np.sqrt(np.mean(error[9:] ** 2)) * SHOWN[-1]),
            "error_in_sigmas": float(np.sqrt(np.mean((error / sigma) ** 2))),
            "passes": estimate.passes,
        }
        row |= dict(zip(ERRORS, (error * SHOWN).tolist(), strict=True))
        rows.append(row | {"cost_cpu_ms": cost[name]})
    return rows


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """A row an estimator: agreement with the oracle, accuracy against the truth, and cost by that of one iteration."""
    rms = [f"{name}_rms" for name in ERRORS]
    out = []
    for name in ESTIMATORS:
        chosen = rows[rows["estimator"] == name]
        if chosen.empty:
            continue
        both = chosen.merge(rows[rows["estimator"] == FULL_PSI], on="case", suffixes=("", "_one"))
        errors = np.sqrt(np.mean(chosen[ERRORS].to_numpy() ** 2, axis=0))
        line = {"estimator": name, "cases": len(chosen), "from_oracle_G_max": chosen["from_oracle_G"].max()}
        line |= {"from_oracle_deg_h_max": chosen["from_oracle_deg_h"].max()}
        line |= {"error_rms_ppm": 1e6 * np.sqrt(np.mean(chosen["error_rms_G"] ** 2))}
        line |= {"error_rms_deg_h": np.sqrt(np.mean(chosen["error_rms_deg_h"] ** 2))}
        line |= {"error_in_sigmas": np.sqrt(np.mean(chosen["error_in_sigmas"] ** 2)), "passes": chosen["passes"].mean()}
        line |= {"cost_cpu_ms": chosen["cost_cpu_ms"].median()}
        line |= {"cost_ratio": (both["cost_cpu_ms"] / both["cost_cpu_ms_one"]).median()}
        out.append(line | dict(zip(rms, errors.tolist(), strict=True)))
    return pd.DataFrame(out)


def report(config: EstimatorsConfig, rows: pd.DataFrame) -> Report:
    """Agreement, accuracy and cost."""
    table = summary(rows)
    by = table.set_index("estimator")
    converged, one, linear, oracle = (by.loc[name].astype(float) for name in (CONVERGED, FULL_PSI, LINEAR_PSI, ORACLE))
    agreed = converged["from_oracle_G_max"]
    last = rows.loc[rows["estimator"] == CONVERGED, "last_correction_G"].max()
    psi = rows.loc[rows["estimator"] == LINEAR_PSI, "from_full_psi_G"].max()
    findings = [
        f"Converged calibrator and least-squares oracle differ by at most {agreed:.1e} in G and "
        f"{converged['from_oracle_deg_h_max']:.1e} deg/h in b over {converged['cases']:.0f} cases: "
        f"{'within' if agreed <= AGREEMENT_G else 'NOT within'} {AGREEMENT_G:.0e} in G. "
        f"(The last of {config.iterations} corrections was at most {last:.1e} in G.)",
        f"One iteration from the a-priori parameters is within {1e6 * one['from_oracle_G_max']:.2f} ppm of the minimum with "
        f"full ψ and {1e6 * linear['from_oracle_G_max']:.2f} ppm with linear ψ; the two differ by at most {1e6 * psi:.2f} ppm.",
        f"Against the truth the RMS error of G is {one['error_rms_ppm']:.2f} ppm after one iteration, "
        f"{linear['error_rms_ppm']:.2f} with linear ψ, {converged['error_rms_ppm']:.2f} converged "
        f"and {oracle['error_rms_ppm']:.2f} for the oracle "
        f"({converged['error_in_sigmas']:.2f} formal sigmas).",
        f"CPU time, as the median ratio to one iteration with full ψ ({one['cost_cpu_ms']:.2f} ms in this run): "
        + ", ".join(f"{name} ×{row['cost_ratio']:.3g}" for name, row in by.iterrows() if name != FULL_PSI)
        + ". Costs (columns cost_…) are measured, and not the same in another run.",
    ]
    if STREAMING in by.index:
        chosen = rows[rows["estimator"] == STREAMING]
        findings.append(
            f"Streaming sample by sample gives the one-iteration answer to {chosen['from_full_psi_G'].max():.1e} in G "
            f"({len(chosen)} cases)."
        )
    short = [name for name in table if not str(name).endswith("_rms")]
    rms = [f"{error}_rms" for error in ERRORS]
    per_parameter = pd.DataFrame(
        {"parameter": NAMES, "unit": ["ppm"] * 9 + ["deg/h"] * 3}
        | {str(name): by.loc[name, rms].to_numpy(float) for name in by.index if name != STREAMING}
    )
    return Report(
        {
            "estimators": Table("Agreement, accuracy and cost", table[short]),
            "parameters": Table("RMS error against the truth, by parameter", per_parameter),
        },
        {"agreement": partial(_figure, rows)},
        findings=tuple(findings),
    )


def _figure(rows: pd.DataFrame, path: Path) -> Path:
    """Distance from the oracle of every case, beside the error that noise makes; no costs, so its bytes do not change."""
    names = [name for name in (LINEAR_PSI, FULL_PSI, STREAMING, CONVERGED) if name in set(rows["estimator"])]
    error = rows.loc[rows["estimator"] == ORACLE, "error_rms_G"]
    with mpl.rc_context(panels.STYLE):
        figure = Figure(figsize=(7.0, 2.4), layout="constrained")
        axes = figure.add_subplot()
        for y, name in enumerate(reversed(names)):
            values = rows.loc[rows["estimator"] == name, "from_oracle_G"].clip(lower=1e-16)
            axes.plot(values, np.full(len(values), y), "|", color="#00798c", markersize=14)
        axes.axvspan(error.min(), error.max(), color="#d1495b", alpha=0.2, linewidth=0)
        axes.text(
            float(error.min()), len(names) - 0.45, "RMS error of G by noise ", color="#d1495b", fontsize=8, ha="right", va="top"
        )
        axes.axvline(AGREEMENT_G, color="0.4", linestyle=":", linewidth=1.2)
        axes.set_xscale("log")
        axes.set_ylim(-0.5, len(names) - 0.4)
        axes.set_yticks(range(len(names)), reversed(names))
        axes.set_xlabel("largest difference in G to the oracle; a stroke a case, dotted: limit")
        return panels.save(figure, path)


STUDY = Study("studies.calibration.estimators:STUDY", EstimatorsConfig, case, recording)
ENTRY = Entry(STUDY, "Davenport's forms against non-linear least squares: same answer, at what cost", report)
