"""Monte Carlo of the TRMM calibration in the form of N Tables 2–5.

A case draws gyro and reference noise for the scenario's six intervals and calibrates from the pre-launch parameters, two
iterations, for each step size made by skipping samples (as N did) and by averaging them, with ψ full and linear. Its row
holds the residuals and parameters after each iteration; the tables are distributions over the rows.

`STUDY` is what the engine runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal import NAMES, GyroParameters
from gyrocal.arrays import Array
from gyrocal.calibration.covariance import CovarianceModel
from gyrocal.calibration.increment_packing import compute_packed_shape
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import Psi
from gyrocal.calibration.sampling import Resampling, prepare_measurements
from studies.calibration import summaries
from studies.calibration.shared_truth import (
    NoiseFreeSimulation,
    build_once,
    get_true_parameters,
    get_workspace,
    make_noise_generators,
)
from studies.montecarlo import statistics
from studies.montecarlo.study import Streams, Study, StudyConfig, load_base_scenario, observed
from studies.natanson import flight
from studies.natanson.paper_forms import (
    ITERATION_PHASES,
    TABLE4_STATISTICS,
    convert_to_gyro_form,
    count_digit_changes,
    format_corrections,
    format_paper_table,
)
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.tables import Table, summarise_groups
from studies.report.units import ONE_DEG_S, ONE_DEG_S_NAMES

Variant = tuple[float, Resampling, Psi, CovarianceModel]
VARIANT_KEYS = ("step_s", "resampling", "psi", "covariance")
ITERATES = ("initial", "first", "second")
VARIANT = ["psi", "resampling", "step_s"]  # columns that name one with the full covariance
SIGMA_CELLS = [f"sigma_{name}" for name in NAMES]
PAPER_TABLE_TITLES = {
    "table2": "N Table 2: residuals",
    "table3": "N Table 3: calibration parameters",
    "table4": "N Table 4: mean and RMS",
    "table5": "N Table 5: corrections to b and G⁻¹",
}
STUDY_NAMES = {"table2": "residuals", "table3": "parameters", "table4": "means_and_rms", "table5": "corrections"}


class PaperTablesConfig(StudyConfig):
    """What the study runs."""

    steps_s: tuple[float, ...] = flight.FLIGHT_STEPS_S  # step sizes
    resamplings: tuple[Resampling, ...] = ("skip", "average")  # how steps longer than the sample are made
    control: bool = True  # whether to calibrate with the paper's covariance too, at the smallest step

    def variants(self, sample_s: float) -> list[Variant]:
        """List the variants of calibrating a case; the sample itself is neither skipped nor averaged."""
        psis: tuple[Psi, ...] = ("full", "linear")
        default = self.resamplings[0]
        pairs = [(step, kind) for kind in self.resamplings for step in self.steps_s if step > sample_s or kind == default]
        out: list[Variant] = [(step, kind, psi, "full") for step, kind in pairs for psi in psis]
        # The paper's own covariance is the control, which must fail where gyro noise matters.
        return [*out, (min(self.steps_s), default, "full", "references only")] if self.control else out


@dataclass(frozen=True)
class _PreparedProblems:
    """Common to the cases of a scenario."""

    flown: NoiseFreeSimulation
    variants: list[Variant]
    problems: dict[tuple[float, Resampling, CovarianceModel], Problem]


@build_once
def _prepare_problems(config: PaperTablesConfig, flown: NoiseFreeSimulation) -> _PreparedProblems:
    variants = config.variants(flown.scenario.gyro.sample_s)
    keys = dict.fromkeys((step, resampling, model) for step, resampling, _, model in variants)
    problems = {key: Problem.build(flown.plain, prepare_measurements(flown.plain, *key[:2]), model=key[2]) for key in keys}
    return _PreparedProblems(flown, variants, problems)


def label_residuals(arc: NDArray[np.intp]) -> list[str]:
    """Label each residual by its interval's number from 1, and by its place if the interval has several."""
    counts = np.bincount(arc)
    within = np.concatenate([np.arange(1, count + 1) for count in counts])
    return [f"{k + 1}" if counts[k] == 1 else f"{k + 1}.{j}" for k, j in zip(arc, within, strict=True)]


def run_case(config: PaperTablesConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """Calibrate one case: a row for each variant; angles in degrees, G dimensionless, b in deg/s."""
    prepared = _prepare_problems(config, number)
    flown = prepared.flown
    rates, A = flown.realise(make_noise_generators(streams), out=get_workspace("rates", flown.rates.shape))
    problems = {
        key: problem.replace_case(rates, A, get_workspace(key, compute_packed_shape(problem.measurements.arcs.pieces)))
        for key, problem in prepared.problems.items()
    }
    rows: list[dict[str, object]] = []
    for variant in prepared.variants:
        step, resampling, psi, model = variant
        problem = problems[step, resampling, model]
        result = problem.iterate(flown.initial, 2, psi).check_convergence()
        labels = label_residuals(problem.measurements.arcs.arc)
        row: dict[str, object] = dict(zip(VARIANT_KEYS, variant, strict=True))
        for phase, theta in zip(ITERATION_PHASES.values(), np.rad2deg(result.theta), strict=True):
            row |= dict(
                zip([f"{phase}_{k}_{axis}" for k in labels for axis in flight.ROTATIONS], theta.ravel().tolist(), strict=True)
            )
        for label, x in zip(ITERATES, result.x * ONE_DEG_S, strict=True):
            row |= dict(zip([f"{label}_{name}" for name in NAMES], x.tolist(), strict=True))
        row |= dict(zip(SIGMA_CELLS, (np.sqrt(np.diag(result.P)) * ONE_DEG_S).tolist(), strict=True))
        error = result.x[2] - flown.truth
        rows.append(row | {"nees": float(statistics.compute_nees(error[None], result.P[None])[0]), "chi2": result.chi2})
    return rows


def tabulate_case(config: PaperTablesConfig, number: int) -> pd.DataFrame:
    """Tabulate one case outside the engine, a row for each variant."""
    rows = run_case(config, number, Streams(config.entropy, number))
    return pd.DataFrame([{"case": number, **row} for row in rows])


STUDY = Study("studies.natanson.paper_tables:STUDY", PaperTablesConfig, run_case, observed)


def select_variant(
    rows: pd.DataFrame, step_s: float, resampling: Resampling = "skip", psi: Psi = "full", covariance: CovarianceModel = "full"
) -> pd.DataFrame:
    """Select the rows of one variant, ordered by case; the smallest step has only one resampling."""
    condition = "" if step_s == rows["step_s"].min() else " and resampling == @resampling"
    return rows.query(f"step_s == @step_s and psi == @psi and covariance == @covariance{condition}").sort_values("case")


Part = tuple[Array, Array | None, dict[str, object]]  # samples (n, m), the flight's (m,) or None, columns that name them


def build_flight_table(rows: pd.DataFrame, name: str, flown: bool = True) -> pd.DataFrame:
    """Build N Table 2, 3, 4 or 5 for every variant: simulated distributions, and the flight's values if it flew."""
    out = []
    comparable = flown and find_residual_labels(rows) == [str(k) for k in range(1, 7)]
    flown_steps: dict[object, float] = {step: step for step in flight.FLIGHT_STEPS_S}
    for (psi, resampling, step), variant_rows in rows[rows["covariance"] == "full"].groupby(VARIANT, sort=False):
        published_step = flown_steps.get(step) if comparable and resampling == "skip" else None
        for samples, published, columns in TABLE_PARTS[name](variant_rows.sort_values("case"), published_step):
            part = summaries.summarise_distribution(samples, published)
            keys = {"psi": psi, "resampling": resampling, "step_s": step} | columns
            out.append(pd.concat([pd.DataFrame(keys, index=part.index), part], axis=1))
    return pd.concat(out, ignore_index=True)


def find_residual_labels(rows: pd.DataFrame) -> list[str]:
    """Find the labels of the residuals in rows, in their order."""
    ending = f"_{flight.ROTATIONS[0]}"
    columns = [str(name) for name in rows.columns if str(name).startswith("before_") and str(name).endswith(ending)]
    return [name.removeprefix("before_").removesuffix(ending) for name in columns]


def _select_residuals(rows: pd.DataFrame, phase: str) -> Array:
    """Select the residuals (n, m, 3) of a phase."""
    names = [f"{ITERATION_PHASES[phase]}_{k}_{axis}" for k in find_residual_labels(rows) for axis in flight.ROTATIONS]
    return rows[names].to_numpy().reshape(len(rows), -1, 3)


def _select_iterate(rows: pd.DataFrame, label: str) -> Array:
    """Select an iterate (n, 12), b in deg/s."""
    return rows[[f"{label}_{name}" for name in NAMES]].to_numpy()


def _list_residuals(rows: pd.DataFrame, step: float | None) -> Iterator[Part]:
    """List N Table 2: residuals before and after calibration, and after a second iteration, deg."""
    names = find_residual_labels(rows)
    numbers = [int(name) for name in names] if all(name.isdigit() for name in names) else names
    cells: dict[str, object] = {"interval": np.repeat(numbers, 3), "axis": list(flight.ROTATIONS) * len(names)}
    for phase in ITERATION_PHASES:
        is_published = step is not None and phase != "second iteration"
        published = flight.read_published_residuals(phase, step).ravel() if is_published else None
        yield _select_residuals(rows, phase).reshape(len(rows), -1), published, {"phase": phase, **cells}


def _list_parameters(rows: pd.DataFrame, step: float | None) -> Iterator[Part]:
    """List N Table 3: bias, scale factor and misalignments per gyro before and after each iteration."""
    cells, start = convert_to_gyro_form(_select_iterate(rows, "initial"))
    quantities, gyros = zip(*cells, strict=True)
    for phase in ("calibrated", "second iteration"):
        published = None
        if step is not None and phase == "calibrated":
            vector = flight.read_published_parameters("calibrated", step).vector * ONE_DEG_S
            (published,) = convert_to_gyro_form(vector[None])[1]
        columns = {"phase": phase, "quantity": quantities, "gyro": gyros, "prelaunch": start.mean(axis=0)}
        yield convert_to_gyro_form(_select_iterate(rows, ITERATION_PHASES[phase]))[1], published, columns


def _list_statistics(rows: pd.DataFrame, step: float | None) -> Iterator[Part]:
    """List N Table 4: mean and the paper's "RMS", sqrt(Σx²)/n, over the residuals, and the true RMS, deg."""
    for phase in ITERATION_PHASES:
        for name, compute in TABLE4_STATISTICS.items():
            published = None
            if step is not None and phase != "second iteration":
                published = (
                    flight.compute_rms(flight.read_published_residuals(phase, step))  # N has no true RMS
                    if name == "rms"
                    else flight.read_published_statistics(phase, step, name.removeprefix("paper_"))
                )
            columns: dict[str, object] = {"phase": phase, "statistic": name, "axis": list(flight.ROTATIONS)}
            yield compute(_select_residuals(rows, phase)), published, columns


def _list_corrections(rows: pd.DataFrame, step: float | None) -> Iterator[Part]:
    """List N Table 5: corrections to b and to G⁻¹, as the paper prints them, of both iterations in (G, b).

    The flight's first-iteration bias corrections are those of Δt = 1 s, its G corrections those of G⁻¹ at 0.5 s; each is
    compared at its own step. The flight's second iteration was in gyro space; `studies.natanson.flight_recalibration` computes
    it from the flight's residuals. Here (G, b) is iterated, whose second iteration has the same size and other cells.
    """
    cells: dict[str, object] = {"row": np.repeat(list("xyz"), 3), "gyro": list("xyz") * 3}
    G_flight, bias_flight = flight.read_published_corrections(1)
    iterates = [_select_iterate(rows, label) for label in ITERATES]
    inverse = [np.linalg.inv(x[:, :9].reshape(-1, 3, 3)) for x in iterates]
    for k in (1, 2):
        bias, change = iterates[k][:, 9:] - iterates[k - 1][:, 9:], (inverse[k] - inverse[k - 1]).reshape(-1, 9)
        flown_bias = bias_flight if k == 1 and step == flight.FLIGHT_STEPS_S[1] else None
        flown_G = G_flight.ravel() if k == 1 and step == flight.FLIGHT_STEPS_S[0] else None
        yield bias, flown_bias, {"iteration": k, "quantity": "bias_deg_s", "row": "", "gyro": list("xyz")}
        yield change, flown_G, {"iteration": k, "quantity": "G_inverse", **cells}


# Distributions of one variant's rows; the step is given if the flight has it too.
TABLE_PARTS = {
    "table2": _list_residuals,
    "table3": _list_parameters,
    "table4": _list_statistics,
    "table5": _list_corrections,
}


def compute_errors_and_sigmas(rows: pd.DataFrame, truth: GyroParameters) -> tuple[Array, Array]:
    """Compute recovered (second iteration) minus injected, and formal sigma, (n, 12), of one variant; b in deg/s."""
    return _select_iterate(rows, "second") - truth.vector * ONE_DEG_S, rows[SIGMA_CELLS].to_numpy()


def build_accuracy_table(rows: pd.DataFrame, truth: GyroParameters) -> pd.DataFrame:
    """Build bias, spread, formal sigma and coverage with binomial intervals for every variant."""
    parts = []
    for variant, variant_rows in rows[rows["covariance"] == "full"].groupby(VARIANT, sort=False):
        errors = compute_errors_and_sigmas(variant_rows.sort_values("case"), truth)
        part = summaries.tabulate_accuracy(*errors, NAMES, ONE_DEG_S_NAMES)
        parts.append(pd.concat([pd.DataFrame(dict(zip(VARIANT, variant, strict=True)), index=part.index), part], axis=1))
    return pd.concat(parts, ignore_index=True)


def compare_psi_models(rows: pd.DataFrame) -> pd.DataFrame:
    """Compute the largest difference over cases between full and linear ψ, a row per step and iteration."""
    out = []
    for step, resampling in rows[["step_s", "resampling"]].drop_duplicates().itertuples(index=False):
        full, linear = (select_variant(rows, step, resampling, psi) for psi in ("full", "linear"))
        for label in ("first", "second"):
            difference = np.abs(_select_iterate(full, label) - _select_iterate(linear, label)).max(axis=0)
            keys = {"step_s": step, "resampling": resampling, "iteration": label}
            out.append({**keys, "G": difference[:9].max(), "bias_deg_s": difference[9:].max()})
    return pd.DataFrame(out)


def measure_second_iteration(rows: pd.DataFrame) -> pd.DataFrame:
    """Measure the second iteration's corrections over the cases, a row per variant.

    Largest and median size of the corrections; for N's criterion, the share of cases in which no printed digit of N Tables 2
    and 4 changes, the mean count of those that do, and the largest change of a residual.
    """

    def measure_variant(variant_rows: pd.DataFrame) -> dict[str, float]:
        change = np.abs(_select_iterate(variant_rows, "second") - _select_iterate(variant_rows, "first"))
        sizes = {"G": change[:, :9].max(axis=1), "bias_deg_s": change[:, 9:].max(axis=1)}
        out: dict[str, float] = {}
        for name, x in sizes.items():
            out |= {f"{name}_max": float(np.max(x)), f"{name}_median": float(np.median(x))}
        first, second = (_select_residuals(variant_rows, phase) for phase in ("calibrated", "second iteration"))
        for name, changed in zip(("table2", "table4"), count_digit_changes(first, second), strict=True):
            out |= {f"{name}_unchanged_share": float(np.mean(changed == 0)), f"{name}_changed_mean": float(np.mean(changed))}
        largest = 1e3 * np.abs(second - first).max(axis=(1, 2))
        return out | {"largest_median_mdeg": float(np.median(largest)), "largest_max_mdeg": largest.max()}

    return summarise_groups(rows[rows["covariance"] == "full"], VARIANT, measure_variant)


def build_paper_tables(rows: pd.DataFrame, config: PaperTablesConfig) -> dict[str, pd.DataFrame]:
    """Build N Tables 2 to 5, both ψ and the second iteration, and the accuracy of the estimates.

    The latter only where the truth is the same in every case.
    """
    scenario = load_base_scenario(config)
    flown = flight.matches_flight(scenario)
    out = {name: build_flight_table(rows, name, flown) for name in TABLE_PARTS}
    out |= {"psi_difference": compare_psi_models(rows), "second_iteration": measure_second_iteration(rows)}
    if not any(path.startswith("gyro.true") for path in config.dispersions):
        out["accuracy"] = build_accuracy_table(rows, get_true_parameters(scenario))
    return out


PAPER = "The paper's covariance knows no gyro noise: it is the control, which must be found out."


def _build_consistency_checks(rows: pd.DataFrame, step_s: float) -> list[Check]:
    """Check that the covariances are consistent at a step, with both ψ, and that the paper's is not."""
    checks = []
    for name, group in rows[rows["step_s"] == step_s].groupby(["covariance", "psi", "resampling"], sort=False):
        nees, is_control = statistics.check_mean_nees(group["nees"], len(NAMES)), name[0] != "full"
        text, bounds = f"mean NEES, {', '.join(map(str, name))}, {step_s:g} s", (nees.lower, nees.upper)
        checks.append(Check(text, nees.value, bounds, "", PAPER if is_control else "", is_control))
    return checks


def report(config: PaperTablesConfig, rows: pd.DataFrame) -> Report:
    """Report N's tables, in N's form if samples are skipped; the checks test the consistency of the estimates."""
    flown = flight.matches_flight(load_base_scenario(config))
    flight_tables = {name: build_flight_table(rows, name, flown) for name in TABLE_PARTS}
    formatted = {}
    if "skip" in config.resamplings:
        formatted = {name: format_paper_table(flight_tables[name], name) for name in ("table2", "table3", "table4")}
        formatted["table5"] = format_corrections(flight_tables["table5"])
    titles = PAPER_TABLE_TITLES.items()
    tables = {STUDY_NAMES[name]: Table(title, flight_tables[name], shown=formatted.get(name)) for name, title in titles}
    return Report(tables, checks=tuple(_build_consistency_checks(rows, min(config.steps_s))))


ENTRY = Entry(STUDY, "N Tables 2-5 over seeds, step sizes, both ψ and two iterations", report)
