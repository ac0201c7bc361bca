"""Monte Carlo of the TRMM calibration in the form of N Tables 2–5.

A case draws gyro and reference noise for the scenario's six intervals and calibrates from the pre-launch parameters, two
iterations, for each step size made by skipping samples (as N did) and by averaging them, with ψ full and linear. Its row
holds the residuals and parameters after each iteration; the tables are distributions over the rows.

`STUDY` is what the engine runs.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal import NAMES, GyroParameters
from gyrocal.calibration.covariance import CovarianceModel
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import Psi, packed_shape
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
SIGMA_CELLS = [f"sigma_{name}" for name in NAMES]


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


def variants(rows: pd.DataFrame) -> pd.DataFrame:
    """The variants with the full covariance, a row each."""
    full = rows[rows["covariance"] == "full"]
    return full[["psi", "resampling", "step_s"]].drop_duplicates().reset_index(drop=True)


def _over_variants(
    rows: pd.DataFrame, build: Callable[[pd.DataFrame, float, bool], list[pd.DataFrame]], flown: bool = True
) -> pd.DataFrame:
    """Stack build(rows of the variant, step, whether the flight's column is of the same kind) over the variants."""
    parts = []
    comparable = flown and labels(rows) == [str(k) for k in range(1, 7)]
    for variant in variants(rows).to_dict("records"):
        step, resampling = variant["step_s"], variant["resampling"]
        as_flown = comparable and resampling == "skip" and step in flight.STEPS
        built = build(choose(rows, step, resampling, variant["psi"]), step, as_flown)
        keys = {"psi": variant["psi"], "resampling": resampling, "step_s": step}
        parts += [_beside(part, **keys) for part in built]
    return pd.concat(parts, ignore_index=True)


def _beside(table: pd.DataFrame, **columns: object) -> pd.DataFrame:
    """A table with columns before its own."""
    return pd.concat([pd.DataFrame(columns, index=table.index), table], axis=1)


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

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        parts = []
        for phase in PHASES:
            known = flown and phase != "second iteration"
            published = flight.residuals(phase, step).ravel() if known else None
            part = statistics.distribution(_residuals(chosen, phase).reshape(len(chosen), -1), published)
            parts.append(_beside(part, phase=phase, **cells))
        return parts

    return _over_variants(rows, build, flown)


def table3(rows: pd.DataFrame, flown: bool = True) -> pd.DataFrame:
    """N Table 3: bias, scale factor and misalignments per gyro before and after the first iteration, and after a second."""

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        cells, start = gyro_form(_iterate(chosen, "initial"))
        quantities, gyros = zip(*cells, strict=True)
        published = gyro_form(flight.parameters("calibrated", step).vector[None] * ONE_DEG_S)[1][0] if flown else None
        parts = []
        for phase in ("calibrated", "second iteration"):
            known = published if phase == "calibrated" else None
            part = statistics.distribution(gyro_form(_iterate(chosen, PHASES[phase]))[1], known)
            parts.append(_beside(part, phase=phase, quantity=quantities, gyro=gyros, prelaunch=start.mean(axis=0)))
        return parts

    return _over_variants(rows, build, flown)


def table4(rows: pd.DataFrame, flown: bool = True) -> pd.DataFrame:
    """N Table 4: mean and the paper's "RMS", sqrt(Σx²)/n, over the residuals, with the true RMS beside it, deg."""

    def published(phase: str, step: float, statistic: str) -> Array:
        if statistic == "rms":  # the paper has no true RMS; it follows from N Table 2
            return flight.rms(flight.residuals(phase, step))
        return flight.statistics(phase, step, statistic.removeprefix("paper_"))

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        parts = []
        for phase in PHASES:
            cube, known = _residuals(chosen, phase), flown and phase != "second iteration"
            for name, compute in TABLE4.items():
                part = statistics.distribution(compute(cube), published(phase, step, name) if known else None)
                parts.append(_beside(part, phase=phase, statistic=name, axis=list(flight.ROTATIONS)))
        return parts

    return _over_variants(rows, build, flown)


def table5(rows: pd.DataFrame, flown: bool = True) -> pd.DataFrame:
    """N Table 5: corrections to b and, as the paper's numbers are, to G⁻¹, by the first and the second iteration in (G, b).

    The flight's first-iteration bias corrections are those of Δt = 1 s and its G corrections those of 0.5 s and of G⁻¹; each is
    set beside its own. Its second iteration is one of gyro space and stands in `studies.natanson.own_residuals`, which finds
    it from the flight's residuals; here (G, b) is iterated, whose second iteration has the same size and other cells.
    """
    cells: dict[str, object] = {"row": np.repeat(list("xyz"), 3), "gyro": list("xyz") * 3}

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        iterates = [_iterate(chosen, label) for label in ITERATES]
        inverse = [np.linalg.inv(x[:, :9].reshape(-1, 3, 3)) for x in iterates]
        G_flight, bias_flight = flight.corrections(1)
        parts = []
        for iteration in (1, 2):
            known = flown and iteration == 1
            bias = iterates[iteration][:, 9:] - iterates[iteration - 1][:, 9:]
            part = statistics.distribution(bias, bias_flight if known and step == flight.STEPS[1] else None)
            parts.append(_beside(part, iteration=iteration, quantity="bias_deg_s", row="", gyro=list("xyz")))
            change = (inverse[iteration] - inverse[iteration - 1]).reshape(-1, 9)
            part = statistics.distribution(change, G_flight.ravel() if known and step == flight.STEPS[0] else None)
            parts.append(_beside(part, iteration=iteration, quantity="G_inverse", **cells))
        return parts

    return _over_variants(rows, build, flown)


def printed_digits(rows: pd.DataFrame) -> pd.DataFrame:
    """N's criterion that one iteration does: printed digits of N Tables 2 and 4 that the second changes, a row per variant.

    Of each case: whether none changes, how many do on average, and the largest change of a residual (median over the cases).
    """

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        first, second = (_residuals(chosen, phase) for phase in ("calibrated", "second iteration"))
        out: dict[str, float] = {}
        for name, changed in zip(("table2", "table4"), changed_digits(first, second), strict=True):
            out |= {f"{name}_unchanged_share": float(np.mean(changed == 0)), f"{name}_changed_mean": float(np.mean(changed))}
        largest = 1e3 * np.abs(second - first).max(axis=(1, 2))
        return [pd.DataFrame([out | {"largest_median_mdeg": np.median(largest), "largest_max_mdeg": largest.max()}])]

    return _over_variants(rows, build)


def errors_and_sigmas(rows: pd.DataFrame, truth: GyroParameters) -> tuple[Array, Array]:
    """Recovered (second iteration) minus injected, and formal sigma, (n, 12), of rows of one variant; b in deg/s."""
    return _iterate(rows, "second") - truth.vector * ONE_DEG_S, rows[SIGMA_CELLS].to_numpy()


def accuracy(rows: pd.DataFrame, truth: GyroParameters) -> pd.DataFrame:
    """Recovered minus injected for every variant: bias, spread, formal sigma, coverage with binomial intervals."""

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        return [statistics.accuracy_table(*errors_and_sigmas(chosen, truth), NAMES, ONE_DEG_S_NAMES)]

    return _over_variants(rows, build)


def consistency(rows: pd.DataFrame, truth: GyroParameters) -> pd.DataFrame:
    """Mean NEES with its 99 % bounds and pooled coverage, a row per variant and covariance model."""

    def line(chosen: pd.DataFrame) -> dict[str, float]:
        found = statistics.nees_check(chosen["nees"], len(NAMES))
        row = {"nees": found.value, "nees_lower": found.lower, "nees_upper": found.upper, "nees_inside": found.inside}
        for level in statistics.LEVELS:
            inside, total = statistics.coverage(*errors_and_sigmas(chosen, truth), level)
            row[f"coverage_{level}"] = inside / total
        return row

    return by_group(rows, ["psi", "resampling", "step_s", "covariance"], line)


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

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        change = np.abs(_iterate(chosen, "second") - _iterate(chosen, "first"))
        sizes = {"G": change[:, :9].max(axis=1), "bias_deg_s": change[:, 9:].max(axis=1)}
        return [
            pd.DataFrame([{f"{name}_{how}": getattr(np, how)(x) for name, x in sizes.items() for how in ("max", "median")}])
        ]

    return _over_variants(rows, build)


PAPER = "The paper's covariance knows no gyro noise: it is the control, which must be found out."


def _checks(rows: pd.DataFrame, step_s: float) -> list[Check]:
    """Whether the covariances are consistent at a step, of both ψ, and the paper's is not."""
    out = []
    for name, chosen in rows[rows["step_s"] == step_s].groupby(["covariance", "psi", "resampling"], sort=False):
        found = statistics.nees_check(chosen["nees"], len(NAMES))
        control = name[0] != "full"
        bounds = (found.lower, found.upper)
        meaning = PAPER if control else ""
        out.append(Check(f"mean NEES, {', '.join(map(str, name))}, {step_s:g} s", found.value, bounds, "", meaning, control))
    return out


def report(config: PaperTablesConfig, rows: pd.DataFrame) -> Report:
    """The paper's tables, with the consistency of the estimates; accuracy only where the truth is the same in every case."""

    flown, skipped = flight.flew(base_scenario(config)), "skip" in config.resamplings

    def in_ns_form(title: str, table: pd.DataFrame, name: str) -> Table:
        return Table(title, table, shown=paper_form(table, name) if skipped else None)

    tables = {
        "residuals": in_ns_form("N Table 2: residuals (deg)", table2(rows, flown), "table2"),
        "parameters": in_ns_form("N Table 3: parameters after the first iteration", table3(rows, flown), "table3"),
        "means_and_rms": in_ns_form("N Table 4: mean and RMS over the intervals (deg)", table4(rows, flown), "table4"),
        "corrections": in_ns_form("N Table 5: corrections to b and G⁻¹, in (G, b)", table5(rows, flown), "table5"),
        "second_iteration": Table("Second iteration's corrections", second_iteration(rows)),
        "printed_digits": Table("Printed digits of N Tables 2 and 4 the second iteration changes", printed_digits(rows)),
        "psi_difference": Table("Largest difference of full and linear ψ", psi_difference(rows)),
    }
    if not any(path.startswith("gyro.true") for path in config.dispersions):
        truth = true_parameters(base_scenario(config))
        tables["accuracy"] = Table("Recovered minus injected", accuracy(rows, truth))
        tables["consistency"] = Table("Consistency of the claimed covariance", consistency(rows, truth))
    return Report(tables, checks=tuple(_checks(rows, min(config.steps_s))))


ENTRY = Entry(STUDY, "N Tables 2-5 over seeds, step sizes, both ψ and two iterations", report)
