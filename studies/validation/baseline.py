"""The recovered parameters of a fixed small study, held under ``results/baseline`` for CI to compare with.

A gyro is calibrated in four ways, each with code of its own: the compiled iterations of a Monte Carlo, `calibrate()`, the
command ``gyrocal calibrate`` with its JSON, and `RecursiveCalibrator`, sample by sample. All four are held, the latter three
in both parametrisations.

Stored in ppm and deg/h, where the values are of the order one, and compared relatively: an absolute tolerance would let a
bias of 1e-7 rad/s change unseen. After one iteration nothing has healed what is wrong with a step: a step longer by 1e-6 of
itself moves most values by nearly as much of themselves.
"""

import json
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal import NAMES, GyroParameters, InputError, Recording, RecursiveCalibrator, attitude, calibrate, save
from gyrocal.calibration.gyro_space import Parametrisation, select_parameter_space
from gyrocal.calibration.sampling import prepare_measurements
from simulator.simulate import observe
from studies.calibration.shared_truth import NoiseFreeSimulation, get_true_parameters, make_noise_generators
from studies.cli.calibrate import command as calibrate_command
from studies.montecarlo import engine, statistics
from studies.montecarlo.files import write_csv
from studies.montecarlo.study import Streams, load_base_scenario
from studies.natanson import paper_tables
from studies.report.units import ONE_DEG_S, PPM_DEG_H, name_columns

Array = NDArray[np.float64]
Estimates = tuple[Array, Array, Array]  # (12,) after one iteration, and after two, and their covariance (12, 12); SI

CASES = 4
BASELINE_STEPS_S = (0.5, 2.0)
SLOW_SAMPLE_S = 15.0  # of the recording that is taken sample by sample
RTOL = 1e-7  # compilers and BLAS libraries differ in rounding, by 1e-9 and less
BASELINE_KEYS = ["way", "parametrisation", "case", "step_s", "resampling", "psi", "covariance"]
COMPILED = "compiled iterations"
BASELINE_PATH = Path("results") / "baseline" / "recovered.csv"  # in the working folder
IDENTITY = np.append(np.eye(3).ravel(), np.zeros(3))


def estimate_baseline_parameters() -> pd.DataFrame:
    """Recovered minus identity of G in ppm, b in deg/h, their sigmas and NEES, a row per way, case and variant."""
    return pd.concat([run_compiled_iterations(), *map(run_estimator, WAYS)], ignore_index=True)


def run_compiled_iterations() -> pd.DataFrame:
    """Rows of the Monte Carlo of the paper's tables."""
    config = paper_tables.PaperTablesConfig(cases=CASES, steps_s=BASELINE_STEPS_S)
    with TemporaryDirectory() as folder:
        outcome = engine.run(paper_tables.STUDY, config, Path(folder), backend="serial")
        outcome.check()
        rows = outcome.load()
    out = rows.assign(way=COMPILED, parametrisation="gain")[BASELINE_KEYS].copy()
    for label, origin in (("first", IDENTITY), ("second", IDENTITY), ("sigma", np.zeros(12))):
        values = rows[[f"{label}_{name}" for name in NAMES]].to_numpy() - origin
        out[name_columns(label)] = values * PPM_DEG_H / ONE_DEG_S
    return out.assign(nees=rows["nees"])


def run_estimator(way: str) -> pd.DataFrame:
    """Rows of one of the ways beside the compiled one, in both parametrisations."""
    config = paper_tables.PaperTablesConfig(overrides={"gyro.sample_s": SLOW_SAMPLE_S})
    scenario, (gyro_rng, reference_rng) = load_base_scenario(config), make_noise_generators(Streams(config.entropy, 0))
    recording = observe(scenario, NoiseFreeSimulation.simulate(scenario).motion, gyro_rng=gyro_rng, reference_rng=reference_rng)
    truth, rows = get_true_parameters(scenario).vector, []
    for parametrisation in ("gain", "gyro"):
        first, second, P = WAYS[way](recording, parametrisation)
        row: dict[str, object] = {"way": way, "parametrisation": parametrisation, "case": 0, "step_s": SLOW_SAMPLE_S}
        row |= {"resampling": "skip", "psi": "full", "covariance": "full"}
        for label, values in (("first", first - IDENTITY), ("second", second - IDENTITY), ("sigma", np.sqrt(np.diag(P)))):
            row |= dict(zip(name_columns(label), values * PPM_DEG_H, strict=True))
        rows.append(row | {"nees": float(statistics.compute_nees((second - truth)[None], P[None])[0])})
    return pd.DataFrame(rows)


def calibrate_by_function(recording: Recording, parametrisation: Parametrisation) -> Estimates:
    """`gyrocal.calibrate`."""
    one, two = (calibrate(recording, iterations=n, parametrisation=parametrisation) for n in (1, 2))
    return one.parameters.vector, two.parameters.vector, two.covariance


def calibrate_by_command(recording: Recording, parametrisation: Parametrisation) -> Estimates:
    """``gyrocal calibrate``, read from the JSON it writes."""
    documents = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        save(recording, folder / "recording")
        for n in (1, 2):
            options = ["--iterations", str(n), "--parametrisation", parametrisation, "--json", str(folder / "result.json")]
            with redirect_stdout(StringIO()):
                calibrate_command.main([str(folder / "recording"), *options], standalone_mode=False)
            documents.append(json.loads((folder / "result.json").read_text(encoding="utf-8")))
    first, second = (GyroParameters(np.array(d["G"]), np.deg2rad(d["bias_deg_s"])).vector for d in documents)
    return first, second, np.array(documents[1]["covariance"]) / np.outer(ONE_DEG_S, ONE_DEG_S)


def calibrate_by_recursion(recording: Recording, parametrisation: Parametrisation) -> Estimates:
    """`gyrocal.RecursiveCalibrator`, one pass after the other."""
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


def find_changed_values(old: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """Values that differ by more than RTOL, the largest relative change first."""
    if list(old.columns) != list(new.columns) or not old[BASELINE_KEYS].equals(new[BASELINE_KEYS]):
        return pd.DataFrame({"quantity": ["rows or columns"], "old": [str(old.shape)], "new": [str(new.shape)]})
    values = [column for column in new.columns if column not in BASELINE_KEYS]
    before, after = old[values].to_numpy(), new[values].to_numpy()
    change = np.abs(after - before) / np.abs(before)
    rows, columns = np.nonzero(~(change <= RTOL))
    table = pd.DataFrame(
        {
            **{key: new[key].to_numpy()[rows] for key in BASELINE_KEYS},
            "quantity": [values[k] for k in columns],
            "old": before[rows, columns],
            "new": after[rows, columns],
            "relative_change": change[rows, columns],
        }
    )
    return table.sort_values("relative_change", ascending=False, ignore_index=True)


def read_baseline(path: Path) -> pd.DataFrame:
    """Read a stored baseline."""
    try:
        table = pd.read_csv(path)
    except (ValueError, UnicodeDecodeError) as fault:  # pandas' parser errors are ValueErrors
        raise InputError(f"{path}: not a baseline: {' '.join(str(fault).split())}") from None
    if not set(BASELINE_KEYS) <= set(table.columns):
        raise InputError(f"{path}: not a baseline: columns {', '.join(BASELINE_KEYS)} are needed")
    return table


def write_baseline(table: pd.DataFrame, path: Path) -> None:
    """Store a baseline with all digits that the comparison uses."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_csv(path, table, digits=12)
