"""Monte Carlo of the TRMM calibration in the form of N Tables 2–5.

A case draws gyro and reference noise for the scenario's six intervals and calibrates from the pre-launch parameters, two
iterations, for each step size made by skipping samples (as N did) and by averaging them, with ψ full and linear. Its row
holds the residuals and parameters after each iteration; the tables are distributions over the rows.

`STUDY` is what the engine runs.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal import NAMES, GyroParameters
from gyrocal.calibration.covariance import CovarianceModel
from gyrocal.calibration.packing import packed_shape
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import Psi
from gyrocal.calibration.sampling import Resampling, measurements
from studies.calibration.prepared import Flown, noise_of, shared, true_parameters
from studies.montecarlo import statistics
from studies.montecarlo.study import Streams, Study, StudyConfig, base_scenario, observed
from studies.montecarlo.workspace import workspace
from studies.natanson import flight
from studies.natanson.paper_forms import PHASES, TABLE4, changed_digits, gyro_form, paper_form
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.tables import Table, by_group
from studies.report.units import ONE_DEG_S, ONE_DEG_S_NAMES

Array = NDArray[np.float64]

Variant = tuple[float, Resampling, Psi, CovarianceModel]
KEYS = ("step_s", "resampling", "psi", "covariance")
ITERATES = ("initial", "first", "second")
VARIANT = ["psi", "resampling", "step_s"]  # columns that name one with the full covariance
SIGMA_CELLS = [f"sigma_{name}" for name in NAMES]
TITLES = {
    "table2": "N Table 2: residuals (deg)",
    "table3": "N Table 3: calibration parameters",
    "table4": "N Table 4: mean and RMS over the intervals (deg)",
    "table5": "N Table 5: corrections to b (deg/s) and G⁻¹, iterated in (G, b)",
    "accuracy": "Recovered minus injected",
    "consistency": "Consistency of the claimed covariance",
    "psi_difference": "Largest difference between full and linear ψ",
    "second_iteration": "Size of the second iteration's corrections",
    "printed_digits": "Printed digits the second iteration changes",
}
STUDY_NAMES = {"table2": "residuals", "table3": "parameters", "table4": "means_and_rms", "table5": "corrections"}


class PaperTablesConfig(StudyConfig):
    """What the study runs.

    Attributes
    ----------
    steps_s : step sizes
    resamplings : how steps longer than the sample are made
    control : whether to calibrate with the paper's covariance too, at the smallest step
    """

    steps_s: tuple[float, ...] = flight.STEPS
    resamplings: tuple[Resampling, ...] = ("skip", "average")
    control: bool = True

    def variants(self, sample_s: float) -> list[Variant]:
        """Every way a case is calibrated; the sample itself is neither skipped nor averaged."""
        ways: list[tuple[float, Resampling]] = [
            (step, how) for how in self.resamplings for step in self.steps_s if step > sample_s or how == self.resamplings[0]
        ]
        psis: tuple[Psi, ...] = ("full", "linear")
        out: list[Variant] = [(*way, psi, "full") for way in ways for psi in psis]
        # The paper's own covariance, as a control: it must be seen to fail where gyro noise matters.
        return [*out, (min(self.steps_s), self.resamplings[0], "full", "references only")] if self.control else out


@dataclass(frozen=True)
class _Prepared:
    """What cases with the same scenario share."""

    flown: Flown
    variants: list[Variant]
    problems: dict[tuple[float, Resampling, CovarianceModel], Problem]


@shared
def _prepared(config: PaperTablesConfig, flown: Flown) -> _Prepared:
    variants = config.variants(flown.scenario.gyro.sample_s)
    ways = dict.fromkeys((step, resampling, model) for step, resampling, _, model in variants)
    problems = {way: Problem.of(flown.plain, measurements(flown.plain, *way[:2]), model=way[2]) for way in ways}
    return _Prepared(flown, variants, problems)


def residual_labels(arc: NDArray[np.intp]) -> list[str]:
    """A label for each residual, from the interval of each: its number from 1, and with several references which of them."""
    counts = np.bincount(arc)
    within = np.concatenate([np.arange(1, count + 1) for count in counts])
    return [f"{k + 1}" if counts[k] == 1 else f"{k + 1}.{j}" for k, j in zip(arc, within, strict=True)]


def case(config: PaperTablesConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """One case: a row for each variant; angles in degrees, G dimensionless, b in deg/s."""
    prepared = _prepared(config, number)
    flown = prepared.flown
    rates, A = flown.realise(noise_of(streams), out=workspace("rates", flown.rates.shape))
    problems = {
        key: problem.with_case(rates, A, workspace(key, packed_shape(problem.measurements.arcs.pieces)))
        for key, problem in prepared.problems.items()
    }
    rows: list[dict[str, object]] = []
    for variant in prepared.variants:
        step, resampling, psi, model = variant
        problem = problems[step, resampling, model]
        result = problem.iterate(flown.initial, 2, psi).checked()
        labels = residual_labels(problem.measurements.arcs.arc)
        row: dict[str, object] = dict(zip(KEYS, variant, strict=True))
        for phase, theta in zip(PHASES.values(), np.rad2deg(result.theta), strict=True):
            row |= dict(
                zip([f"{phase}_{k}_{axis}" for k in labels for axis in flight.ROTATIONS], theta.ravel().tolist(), strict=True)
            )
        for label, x in zip(ITERATES, result.x * ONE_DEG_S, strict=True):
            row |= dict(zip([f"{label}_{name}" for name in NAMES], x.tolist(), strict=True))
        row |= dict(zip(SIGMA_CELLS, (np.sqrt(np.diag(result.P)) * ONE_DEG_S).tolist(), strict=True))
        error = result.x[2] - flown.truth
        rows.append(row | {"nees": float(statistics.nees(error[None], result.P[None])[0]), "chi2": result.chi2})
    return rows


def run_case(config: PaperTablesConfig, number: int) -> pd.DataFrame:
    """One case outside the engine, a row for each variant."""
    rows = case(config, number, Streams(config.entropy, number))
    return pd.DataFrame([{"case": number, **row} for row in rows])


STUDY = Study("studies.natanson.paper_tables:STUDY", PaperTablesConfig, case, observed)


def choose(
    rows: pd.DataFrame, step_s: float, resampling: Resampling = "skip", psi: Psi = "full", covariance: CovarianceModel = "full"
) -> pd.DataFrame:
    """Rows of one variant, in the order of the cases; at the smallest step there is only one way of resampling."""
    way = "" if step_s == rows["step_s"].min() else " and resampling == @resampling"
    return rows.query(f"step_s == @step_s and psi == @psi and covariance == @covariance{way}").sort_values("case")


Part = tuple[Array, Array | None, dict[str, object]]  # samples (n, m), the flight's (m,) or None, columns that name them
Build = Callable[[pd.DataFrame, float | None], Iterator[Part]]


def _distributions(rows: pd.DataFrame, flown: bool, build: Build) -> pd.DataFrame:
    """Distributions of the parts of every variant; `build` gets its rows, and its step where the flight has the same."""
    out = []
    comparable = flown and labels(rows) == [str(k) for k in range(1, 7)]
    known: dict[object, float] = {step: step for step in flight.STEPS}
    for (psi, resampling, step), chosen in rows[rows["covariance"] == "full"].groupby(VARIANT, sort=False):
        as_flown = comparable and resampling == "skip"
        for samples, published, columns in build(chosen.sort_values("case"), known.get(step) if as_flown else None):
            part = statistics.distribution(samples, published)
            keys = {"psi": psi, "resampling": resampling, "step_s": step} | columns
            out.append(pd.concat([pd.DataFrame(keys, index=part.index), part], axis=1))
    return pd.concat(out, ignore_index=True)


def labels(rows: pd.DataFrame) -> list[str]:
    """The labels of the residuals of rows, in their order."""
    ending = f"_{flight.ROTATIONS[0]}"
    columns = [str(name) for name in rows.columns if str(name).startswith("before_") and str(name).endswith(ending)]
    return [name.removeprefix("before_").removesuffix(ending) for name in columns]


def _residuals(rows: pd.DataFrame, phase: str) -> Array:
    """(n, m, 3) residuals."""
    names = [f"{PHASES[phase]}_{k}_{axis}" for k in labels(rows) for axis in flight.ROTATIONS]
    return rows[names].to_numpy().reshape(len(rows), -1, 3)


def _iterate(rows: pd.DataFrame, label: str) -> Array:
    """(n, 12) of an iterate, b in deg/s."""
    return rows[[f"{label}_{name}" for name in NAMES]].to_numpy()


def table2(rows: pd.DataFrame, flown: bool = True) -> pd.DataFrame:
    """N Table 2: residuals before and after calibration, and after a second iteration, deg; beside the flight's if it flew."""
    names = labels(rows)
    numbers = [int(name) for name in names] if all(name.isdigit() for name in names) else names
    cells: dict[str, object] = {"interval": np.repeat(numbers, 3), "axis": list(flight.ROTATIONS) * len(names)}

    def build(chosen: pd.DataFrame, step: float | None) -> Iterator[Part]:
        for phase in PHASES:
            known = step is not None and phase != "second iteration"
            published = flight.residuals(phase, step).ravel() if known else None
            yield _residuals(chosen, phase).reshape(len(chosen), -1), published, {"phase": phase, **cells}

    return _distributions(rows, flown, build)


def table3(rows: pd.DataFrame, flown: bool = True) -> pd.DataFrame:
    """N Table 3: bias, scale factor and misalignments per gyro before and after the first iteration, and after a second."""

    def build(chosen: pd.DataFrame, step: float | None) -> Iterator[Part]:
        cells, start = gyro_form(_iterate(chosen, "initial"))
        quantities, gyros = zip(*cells, strict=True)
        for phase in ("calibrated", "second iteration"):
            published = None
            if step is not None and phase == "calibrated":
                published = gyro_form(flight.parameters("calibrated", step).vector[None] * ONE_DEG_S)[1][0]
            columns = {"phase": phase, "quantity": quantities, "gyro": gyros, "prelaunch": start.mean(axis=0)}
            yield gyro_form(_iterate(chosen, PHASES[phase]))[1], published, columns

    return _distributions(rows, flown, build)


def table4(rows: pd.DataFrame, flown: bool = True) -> pd.DataFrame:
    """N Table 4: mean and the paper's "RMS", sqrt(Σx²)/n, over the residuals, with the true RMS beside it, deg."""

    def published(phase: str, step: float | None, statistic: str) -> Array | None:
        if step is None or phase == "second iteration":
            return None
        if statistic == "rms":  # the paper has no true RMS; it follows from N Table 2
            return flight.rms(flight.residuals(phase, step))
        return flight.statistics(phase, step, statistic.removeprefix("paper_"))

    def build(chosen: pd.DataFrame, step: float | None) -> Iterator[Part]:
        for phase in PHASES:
            for name, compute in TABLE4.items():
                columns: dict[str, object] = {"phase": phase, "statistic": name, "axis": list(flight.ROTATIONS)}
                yield compute(_residuals(chosen, phase)), published(phase, step, name), columns

    return _distributions(rows, flown, build)


def table5(rows: pd.DataFrame, flown: bool = True) -> pd.DataFrame:
    """N Table 5: corrections to b and, as the paper's numbers are, to G⁻¹, by the first and the second iteration in (G, b).

    The flight's first-iteration bias corrections are those of Δt = 1 s and its G corrections those of 0.5 s and of G⁻¹; each is
    set beside its own. Its second iteration is one of gyro space and stands in `studies.natanson.own_residuals`, which finds
    it from the flight's residuals; here (G, b) is iterated, whose second iteration has the same size and other cells.
    """
    cells: dict[str, object] = {"row": np.repeat(list("xyz"), 3), "gyro": list("xyz") * 3}
    G_flight, bias_flight = flight.corrections(1)

    def build(chosen: pd.DataFrame, step: float | None) -> Iterator[Part]:
        iterates = [_iterate(chosen, label) for label in ITERATES]
        inverse = [np.linalg.inv(x[:, :9].reshape(-1, 3, 3)) for x in iterates]
        for k in (1, 2):
            bias, change = iterates[k][:, 9:] - iterates[k - 1][:, 9:], (inverse[k] - inverse[k - 1]).reshape(-1, 9)
            flown_bias = bias_flight if k == 1 and step == flight.STEPS[1] else None
            flown_G = G_flight.ravel() if k == 1 and step == flight.STEPS[0] else None
            yield bias, flown_bias, {"iteration": k, "quantity": "bias_deg_s", "row": "", "gyro": list("xyz")}
            yield change, flown_G, {"iteration": k, "quantity": "G_inverse", **cells}

    return _distributions(rows, flown, build)


def printed_digits(rows: pd.DataFrame) -> pd.DataFrame:
    """N's criterion that one iteration does: printed digits of N Tables 2 and 4 that the second changes, a row per variant.

    Of each case: whether none changes, how many do on average, and the largest change of a residual (median over the cases).
    """

    def line(chosen: pd.DataFrame) -> dict[str, float]:
        first, second = (_residuals(chosen, phase) for phase in ("calibrated", "second iteration"))
        out: dict[str, float] = {}
        for name, changed in zip(("table2", "table4"), changed_digits(first, second), strict=True):
            out |= {f"{name}_unchanged_share": float(np.mean(changed == 0)), f"{name}_changed_mean": float(np.mean(changed))}
        largest = 1e3 * np.abs(second - first).max(axis=(1, 2))
        return out | {"largest_median_mdeg": float(np.median(largest)), "largest_max_mdeg": largest.max()}

    return by_group(rows[rows["covariance"] == "full"], VARIANT, line)


def errors_and_sigmas(rows: pd.DataFrame, truth: GyroParameters) -> tuple[Array, Array]:
    """Recovered (second iteration) minus injected, and formal sigma, (n, 12), of rows of one variant; b in deg/s."""
    return _iterate(rows, "second") - truth.vector * ONE_DEG_S, rows[SIGMA_CELLS].to_numpy()


def accuracy(rows: pd.DataFrame, truth: GyroParameters) -> pd.DataFrame:
    """Recovered minus injected for every variant: bias, spread, formal sigma, coverage with binomial intervals."""
    parts = []
    for variant, chosen in rows[rows["covariance"] == "full"].groupby(VARIANT, sort=False):
        errors = errors_and_sigmas(chosen.sort_values("case"), truth)
        part = statistics.accuracy_table(*errors, NAMES, ONE_DEG_S_NAMES)
        parts.append(pd.concat([pd.DataFrame(dict(zip(VARIANT, variant, strict=True)), index=part.index), part], axis=1))
    return pd.concat(parts, ignore_index=True)


def consistency(rows: pd.DataFrame, truth: GyroParameters) -> pd.DataFrame:
    """Mean NEES with its 99 % bounds and pooled coverage, a row per variant and covariance model."""

    def line(chosen: pd.DataFrame) -> dict[str, float]:
        found = statistics.nees_check(chosen["nees"], len(NAMES))
        row = {"nees": found.value, "nees_lower": found.lower, "nees_upper": found.upper, "nees_inside": found.inside}
        for level in statistics.LEVELS:
            inside, total = statistics.coverage(*errors_and_sigmas(chosen, truth), level)
            row[f"coverage_{level}"] = inside / total
        return row

    return by_group(rows, [*VARIANT, "covariance"], line)


def psi_difference(rows: pd.DataFrame) -> pd.DataFrame:
    """Largest difference over the cases between full and linear ψ, a row per step and iteration."""
    out = []
    for step, resampling in rows[["step_s", "resampling"]].drop_duplicates().itertuples(index=False):
        full, linear = (choose(rows, step, resampling, psi) for psi in ("full", "linear"))
        for label in ("first", "second"):
            difference = np.abs(_iterate(full, label) - _iterate(linear, label)).max(axis=0)
            keys = {"step_s": step, "resampling": resampling, "iteration": label}
            out.append({**keys, "G": difference[:9].max(), "bias_deg_s": difference[9:].max()})
    return pd.DataFrame(out)


def second_iteration(rows: pd.DataFrame) -> pd.DataFrame:
    """Largest and median size of the second iteration's corrections over the cases, a row per variant."""

    def line(chosen: pd.DataFrame) -> dict[str, float]:
        change = np.abs(_iterate(chosen, "second") - _iterate(chosen, "first"))
        sizes = {"G": change[:, :9].max(axis=1), "bias_deg_s": change[:, 9:].max(axis=1)}
        return {f"{name}_{how}": float(getattr(np, how)(x)) for name, x in sizes.items() for how in ("max", "median")}

    return by_group(rows[rows["covariance"] == "full"], VARIANT, line)


def tables(rows: pd.DataFrame, config: PaperTablesConfig) -> dict[str, Table]:
    """The paper's tables, in N's form where samples are skipped, and how right and consistent the estimates are.

    The latter only where the truth is the same in every case.
    """
    flown, found = flight.flew(base_scenario(config)), {}
    for name, build in {"table2": table2, "table3": table3, "table4": table4, "table5": table5}.items():
        data = build(rows, flown)
        found[name] = Table(TITLES[name], data, shown=paper_form(data, name) if "skip" in config.resamplings else None)
    data_of = {"psi_difference": psi_difference(rows), "second_iteration": second_iteration(rows)}
    data_of["printed_digits"] = printed_digits(rows)
    if not any(path.startswith("gyro.true") for path in config.dispersions):
        truth = true_parameters(base_scenario(config))
        data_of = {"accuracy": accuracy(rows, truth), "consistency": consistency(rows, truth)} | data_of
    return found | {name: Table(TITLES[name], data) for name, data in data_of.items()}


PAPER = "The paper's covariance knows no gyro noise: it is the control, which must be found out."


def _checks(rows: pd.DataFrame, step_s: float) -> list[Check]:
    """Whether the covariances are consistent at a step, of both ψ, and the paper's is not."""
    out = []
    for name, chosen in rows[rows["step_s"] == step_s].groupby(["covariance", "psi", "resampling"], sort=False):
        found, control = statistics.nees_check(chosen["nees"], len(NAMES)), name[0] != "full"
        what, bounds = f"mean NEES, {', '.join(map(str, name))}, {step_s:g} s", (found.lower, found.upper)
        out.append(Check(what, found.value, bounds, "", PAPER if control else "", control))
    return out


def report(config: PaperTablesConfig, rows: pd.DataFrame) -> Report:
    """The tables by the study's names for them."""
    found = {STUDY_NAMES.get(name, name): table for name, table in tables(rows, config).items()}
    return Report(found, checks=tuple(_checks(rows, min(config.steps_s))))


ENTRY = Entry(STUDY, "N Tables 2-5 over seeds, step sizes, both ψ and two iterations", report)
