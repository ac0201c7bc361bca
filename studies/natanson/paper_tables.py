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
from studies.natanson.paper_layout import paper_layout
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.tables import Table, by_group
from studies.report.units import ONE_DEG_S, ONE_DEG_S_NAMES

Array = NDArray[np.float64]

Variant = tuple[float, Resampling, Psi, CovarianceModel]
KEYS = ("step_s", "resampling", "psi", "covariance")
RESIDUAL_CELLS = [
    f"{phase}_{k}_{axis}" for phase in ("before", "first", "second") for k in range(1, 7) for axis in flight.ROTATIONS
]
ITERATION_CELLS = [f"{label}_{name}" for label in ("first", "second") for name in NAMES]
SIGMA_CELLS = [f"sigma_{name}" for name in NAMES]
CELLS = [*RESIDUAL_CELLS, *ITERATION_CELLS, *SIGMA_CELLS, "nees", "chi2"]


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


def case_values(config: PaperTablesConfig, case: int, streams: Streams) -> tuple[list[Variant], Array]:
    """One case as numbers, a row a variant of `CELLS`: angles in degrees, G dimensionless, b in deg/s."""
    prepared = _prepared(config, case)
    flown = prepared.flown
    rates, A = flown.realise(noise_of(streams), out=workspace("rates", flown.rates.shape))
    problems = {
        key: problem.with_case(rates, A, workspace(key, packed_shape(problem.measurements.arcs.pieces)))
        for key, problem in prepared.problems.items()
    }
    values = np.empty((len(prepared.variants), len(CELLS)))
    for row, (step, resampling, psi, model) in zip(values, prepared.variants, strict=True):
        result = problems[step, resampling, model].iterate(flown.initial, 2, psi)
        error = result.x[2] - flown.truth
        row[:54] = np.rad2deg(result.theta).ravel()
        row[54:66] = result.x[1] * ONE_DEG_S
        row[66:78] = result.x[2] * ONE_DEG_S
        row[78:90] = np.sqrt(np.diag(result.P)) * ONE_DEG_S
        row[90:] = statistics.nees(error[None], result.P[None])[0], result.chi2
    return prepared.variants, values


def case(config: PaperTablesConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """One case: a row for each variant."""
    variants, values = case_values(config, number, streams)
    return [
        dict(zip(KEYS, variant, strict=True)) | dict(zip(CELLS, row, strict=True))
        for variant, row in zip(variants, values.tolist(), strict=True)
    ]


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


def _over_variants(rows: pd.DataFrame, build: Callable[[pd.DataFrame, float, bool], list[pd.DataFrame]]) -> pd.DataFrame:
    """Stack build(rows of the variant, step, whether the flight's column is of the same kind) over the variants."""
    parts = []
    for variant in variants(rows).to_dict("records"):
        step, resampling = variant["step_s"], variant["resampling"]
        built = build(choose(rows, step, resampling, variant["psi"]), step, resampling == "skip" and step in flight.STEPS)
        keys = {"psi": variant["psi"], "resampling": resampling, "step_s": step}
        parts += [_beside(part, **keys) for part in built]
    return pd.concat(parts, ignore_index=True)


def _beside(table: pd.DataFrame, **columns: object) -> pd.DataFrame:
    """A table with columns before its own."""
    return pd.concat([pd.DataFrame(columns, index=table.index), table], axis=1)


PHASES = {"prelaunch": "before", "calibrated": "first", "second iteration": "second"}


def _residuals(rows: pd.DataFrame, phase: str) -> Array:
    """(n, 18) residuals of six intervals about three axes."""
    return rows[[f"{PHASES[phase]}_{k}_{axis}" for k in range(1, 7) for axis in flight.ROTATIONS]].to_numpy()


def table2(rows: pd.DataFrame) -> pd.DataFrame:
    """N Table 2: residuals before and after calibration, and after a second iteration, deg."""
    cells: dict[str, object] = {"interval": np.repeat(np.arange(1, 7), 3), "axis": list(flight.ROTATIONS) * 6}

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        parts = []
        for phase in PHASES:
            known = flown and phase != "second iteration"
            published = flight.residuals(phase, step).ravel() if known else None
            part = statistics.distribution(_residuals(chosen, phase), published)
            parts.append(_beside(part, phase=phase, **cells))
        return parts

    return _over_variants(rows, build)


def _gyro_form(vectors: Array) -> tuple[list[tuple[str, str]], Array]:
    """Cells of N Table 3 and their values from (n, 12) of G and b in deg/s."""
    G, bias = vectors[:, :9].reshape(-1, 3, 3), vectors[:, 9:]
    cells, columns = [], []
    for i, gyro in enumerate("xyz"):
        cells += [("bias_deg_s", gyro), ("scale_factor", gyro)]
        columns += [bias[:, i], G[:, i, i]]
        for j, axis in enumerate("xyz"):
            if i != j:
                cells.append((f"misalignment_{axis}_deg", gyro))
                columns.append(np.rad2deg(G[:, i, j]))
    return cells, np.stack(columns, axis=1)


def table3(rows: pd.DataFrame) -> pd.DataFrame:
    """N Table 3: bias, scale factor and misalignments per gyro after the first iteration."""

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        cells, samples = _gyro_form(chosen[[f"first_{name}" for name in NAMES]].to_numpy())
        published = _gyro_form(flight.parameters("calibrated", step).vector[None] * ONE_DEG_S)[1][0] if flown else None
        quantities, gyros = zip(*cells, strict=True)
        return [_beside(statistics.distribution(samples, published), quantity=quantities, gyro=gyros)]

    return _over_variants(rows, build)


TABLE4 = {
    "mean": lambda x: x.mean(axis=1),
    "paper_rms": lambda x: flight.paper_rms(x.transpose(1, 0, 2)),
    "rms": lambda x: flight.rms(x.transpose(1, 0, 2)),
}


def table4(rows: pd.DataFrame) -> pd.DataFrame:
    """N Table 4: mean and the paper's "RMS", sqrt(Σx²)/6, over the intervals, with the true RMS beside it, deg."""

    def published(phase: str, step: float, statistic: str) -> Array:
        if statistic == "rms":  # the paper has no true RMS; it follows from N Table 2
            return flight.rms(flight.residuals(phase, step))
        return flight.statistics(phase, step, statistic.removeprefix("paper_"))

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        parts = []
        for phase in ("prelaunch", "calibrated"):
            cube = _residuals(chosen, phase).reshape(-1, 6, 3)
            for name, compute in TABLE4.items():
                part = statistics.distribution(compute(cube), published(phase, step, name) if flown else None)
                parts.append(_beside(part, phase=phase, statistic=name, axis=list(flight.ROTATIONS)))
        return parts

    return _over_variants(rows, build)


def table5(rows: pd.DataFrame) -> pd.DataFrame:
    """N Table 5: corrections to b and, as the paper's numbers are, to G⁻¹, by the first and the second iteration.

    The flight's first-iteration bias corrections are those of Δt = 1 s and its G corrections those of 0.5 s and of G⁻¹; each is
    set beside its own. Of the second iteration it is not known whether they are of G⁻¹ or of G: they stand beside both, at
    0.5 s. Cell by cell they agree with neither; only their size is that of the simulated ones.
    """
    start = flight.parameters("prelaunch").vector * ONE_DEG_S
    cells: dict[str, object] = {"row": np.repeat(list("xyz"), 3), "gyro": list("xyz") * 3}

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        iterates = [np.tile(start, (len(chosen), 1))]
        iterates += [chosen[[f"{label}_{name}" for name in NAMES]].to_numpy() for label in ("first", "second")]
        inverse = [np.linalg.inv(x[:, :9].reshape(-1, 3, 3)) for x in iterates]
        parts = []
        for iteration in (1, 2):
            G_flight, bias_flight = flight.corrections(iteration)
            bias = iterates[iteration][:, 9:] - iterates[iteration - 1][:, 9:]
            bias_step = flight.STEPS[1] if iteration == 1 else flight.STEPS[0]
            part = statistics.distribution(bias, bias_flight if flown and step == bias_step else None)
            parts.append(_beside(part, iteration=iteration, quantity="bias_deg_s", row="", gyro=list("xyz")))
            changes = {"G_inverse": (inverse[iteration] - inverse[iteration - 1]).reshape(-1, 9)}
            if iteration == 2:
                changes["G"] = (iterates[2] - iterates[1])[:, :9]
            for quantity, change in changes.items():
                part = statistics.distribution(change, G_flight.ravel() if flown and step == flight.STEPS[0] else None)
                parts.append(_beside(part, iteration=iteration, quantity=quantity, **cells))
        return parts

    return _over_variants(rows, build)


def errors_and_sigmas(rows: pd.DataFrame, truth: GyroParameters) -> tuple[Array, Array]:
    """Recovered (second iteration) minus injected, and formal sigma, (n, 12), of rows of one variant; b in deg/s."""
    errors = rows[[f"second_{name}" for name in NAMES]].to_numpy() - truth.vector * ONE_DEG_S
    return errors, rows[SIGMA_CELLS].to_numpy()


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
            names = [f"{label}_{name}" for name in NAMES]
            difference = np.abs(full[names].to_numpy() - linear[names].to_numpy()).max(axis=0)
            keys = {"step_s": step, "resampling": resampling, "iteration": label}
            out.append({**keys, "G": difference[:9].max(), "bias_deg_s": difference[9:].max()})
    return pd.DataFrame(out)


def second_iteration(rows: pd.DataFrame) -> pd.DataFrame:
    """Largest and median size of the second iteration's corrections over the cases, a row per variant."""

    def build(chosen: pd.DataFrame, step: float, flown: bool) -> list[pd.DataFrame]:
        first, second = (chosen[[f"{label}_{name}" for name in NAMES]].to_numpy() for label in ("first", "second"))
        change = np.abs(second - first)
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

    def laid_out(title: str, table: pd.DataFrame, name: str) -> Table:
        return Table(title, table, shown=paper_layout(table, name) if "skip" in config.resamplings else None)

    tables = {
        "residuals": laid_out("N Table 2: residuals (deg)", table2(rows), "table2"),
        "parameters": laid_out("N Table 3: parameters after the first iteration", table3(rows), "table3"),
        "means_and_rms": laid_out("N Table 4: mean and RMS over the intervals (deg)", table4(rows), "table4"),
        "corrections": laid_out("N Table 5: corrections to b and G⁻¹", table5(rows), "table5"),
        "second_iteration": Table("Second iteration's corrections", second_iteration(rows)),
        "psi_difference": Table("Largest difference of full and linear ψ", psi_difference(rows)),
    }
    if not any(path.startswith("gyro.true") for path in config.dispersions):
        truth = true_parameters(base_scenario(config))
        tables["accuracy"] = Table("Recovered minus injected", accuracy(rows, truth))
        tables["consistency"] = Table("Consistency of the claimed covariance", consistency(rows, truth))
    return Report(tables, checks=tuple(_checks(rows, min(config.steps_s))))


ENTRY = Entry(STUDY, "N Tables 2-5 over seeds, step sizes, both ψ and two iterations", report)
