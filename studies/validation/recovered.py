"""The parameters that a fixed small simulation is calibrated to, for the project's own baseline (`studies.baseline`).

A gyro is calibrated in four ways, each with code of its own: the compiled iterations of a Monte Carlo, `calibrate()`, the
command ``gyrocal calibrate`` with its JSON, and `RecursiveCalibrator`, sample by sample. All four are cases, the latter three
in both parametrisations.

Values are in ppm and deg/h, of the order one, and minus identity, since they are compared relatively. After one iteration no
error of a step has been corrected: a step longer by a factor of 1 + 1e-6 changes most values by nearly the same factor.
"""

import json
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np
import pandas as pd

from gyrocal import NAMES, GyroParameters, Recording, RecursiveCalibrator, attitude, calibrate, save
from gyrocal.arrays import Array
from gyrocal.calibration.gyro_space import Parametrisation, select_parameter_space
from gyrocal.calibration.sampling import prepare_measurements
from simulator.simulate import observe
from studies.baseline import calibrate_to_json
from studies.calibration.shared_truth import NoiseFreeSimulation, get_true_parameters, make_noise_generators
from studies.montecarlo import statistics
from studies.montecarlo.study import GridConfig, Streams, Study, load_base_scenario
from studies.natanson import paper_tables
from studies.report.entry import Entry, report_columns
from studies.report.units import ONE_DEG_S, PPM_DEG_H, name_columns

Estimates = tuple[Array, Array, Array]  # (12,) after one iteration, and after two, and their covariance (12, 12); SI

CASES = 4
BASELINE_STEPS_S = (0.5, 2.0)
SLOW_SAMPLE_S = 15.0  # of the recording that is taken sample by sample
KEYS = ["way", "parametrisation", "simulation", "step_s", "resampling", "psi", "covariance"]
COMPILED = "compiled iterations"
IDENTITY = np.append(np.eye(3).ravel(), np.zeros(3))


def run_compiled_iterations() -> pd.DataFrame:
    """Run the Monte Carlo of the paper's tables, and return its rows."""
    config = paper_tables.PaperTablesConfig(cases=CASES, steps_s=BASELINE_STEPS_S)
    rows = pd.concat([paper_tables.tabulate_case(config, number) for number in range(CASES)], ignore_index=True)
    out = rows.rename(columns={"case": "simulation"}).assign(way=COMPILED, parametrisation="gain")[KEYS].copy()
    for label, origin in (("first", IDENTITY), ("second", IDENTITY), ("sigma", np.zeros(12))):
        values = rows[[f"{label}_{name}" for name in NAMES]].to_numpy() - origin
        out[name_columns(label)] = values * PPM_DEG_H / ONE_DEG_S
    return out.assign(nees=rows["nees"])


def run_estimator(way: str) -> pd.DataFrame:
    """Run one of the ways beside the compiled one, in both parametrisations, and return its rows."""
    config = paper_tables.PaperTablesConfig(overrides={"gyro.sample_s": SLOW_SAMPLE_S})
    scenario, (gyro_rng, reference_rng) = load_base_scenario(config), make_noise_generators(Streams(config.entropy, 0))
    recording = observe(scenario, NoiseFreeSimulation.simulate(scenario).motion, gyro_rng=gyro_rng, reference_rng=reference_rng)
    truth, rows = get_true_parameters(scenario).vector, []
    for parametrisation in ("gain", "gyro"):
        first, second, P = WAYS[way](recording, parametrisation)
        row: dict[str, object] = {"way": way, "parametrisation": parametrisation, "simulation": 0, "step_s": SLOW_SAMPLE_S}
        row |= {"resampling": "skip", "psi": "full", "covariance": "full"}
        for label, values in (("first", first - IDENTITY), ("second", second - IDENTITY), ("sigma", np.sqrt(np.diag(P)))):
            row |= dict(zip(name_columns(label), values * PPM_DEG_H, strict=True))
        rows.append(row | {"nees": float(statistics.compute_nees((second - truth)[None], P[None])[0])})
    return pd.DataFrame(rows)


def calibrate_by_function(recording: Recording, parametrisation: Parametrisation) -> Estimates:
    """Calibrate by `gyrocal.calibrate`."""
    first, second = (calibrate(recording, iterations=n, parametrisation=parametrisation) for n in (1, 2))
    return first.parameters.vector, second.parameters.vector, second.covariance


def calibrate_by_command(recording: Recording, parametrisation: Parametrisation) -> Estimates:
    """Calibrate by ``gyrocal calibrate``, and read the JSON it writes."""
    documents = []
    with TemporaryDirectory() as folder:
        save(recording, Path(folder) / "recording")
        for n in (1, 2):
            out = Path(folder) / "result.json"
            calibrate_to_json(Path(folder) / "recording", {"iterations": n, "parametrisation": parametrisation}, out)
            documents.append(json.loads(out.read_text(encoding="utf-8")))
    first, second = (GyroParameters(np.array(d["G"]), np.deg2rad(d["bias_deg_s"])).vector for d in documents)
    return first, second, np.array(documents[1]["covariance"]) / np.outer(ONE_DEG_S, ONE_DEG_S)


def calibrate_by_recursion(recording: Recording, parametrisation: Parametrisation) -> Estimates:
    """Calibrate by `gyrocal.RecursiveCalibrator`, one pass after the other."""
    A, sigma = attitude.matrix_from_quaternion(recording.attitudes.quaternions), recording.attitudes.sigma
    prepared = prepare_measurements(recording)
    parameters = GyroParameters(recording.gyro.apriori_G, recording.gyro.apriori_bias)
    passes = []
    for _ in range(2):
        calibrator = RecursiveCalibrator(parameters, arw=recording.gyro.arw, parametrisation=parametrisation)
        ends = zip(prepared.start, prepared.row, prepared.arcs.first, prepared.arcs.last, strict=True)
        for start, row, first, last in ends:
            calibrator.start(A[start], sigma[start])
            for raw, dt in zip(prepared.arcs.raw[first:last], prepared.arcs.dt[first:last], strict=True):
                calibrator.sample(raw, dt)
            calibrator.finish(A[row], sigma[row])
        parameters, P = calibrator.solve()
        passes.append(parameters)
    J = select_parameter_space(parametrisation).jacobian(parameters)
    return passes[0].vector, passes[1].vector, np.asarray(J @ P @ J.T)


WAYS: dict[str, Callable[[Recording, Parametrisation], Estimates]] = {
    "calibrate()": calibrate_by_function,
    "gyrocal calibrate": calibrate_by_command,
    "RecursiveCalibrator": calibrate_by_recursion,
}


class RecoveredConfig(GridConfig):
    """The ways, a case each."""

    axes: ClassVar[tuple[str, ...]] = ("ways",)
    ways: tuple[str, ...] = (COMPILED, *WAYS)


def run_way(config: RecoveredConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """Calibrate one way: recovered minus identity of G in ppm, b in deg/h, their sigmas and NEES, for each variant."""
    (way,) = config.points()[number]
    table = run_compiled_iterations() if way == COMPILED else run_estimator(way)
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


STUDY = Study("studies.validation.recovered:STUDY", RecoveredConfig, run_way)
ENTRY = Entry(STUDY, "parameters that four ways of calibration recover, for the project's own baseline", report_columns)
