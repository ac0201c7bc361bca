"""Does the alignment calibration find what was injected, by both of R's algorithms, and how sure may one be of it?

A case is one orbit +x forward with the Sun 25° off the orbit plane (`studies.estimation.attitude_cases.AlignmentOrbit`): whole
counts of two sun sensors and the angles of an Earth sensor whose horizon is simulated apart from the one calibrated with.
DSS-2 is misaligned by R (3), the Earth sensor has the penetration biases of `gyrocal.sensors.earth.TRMM_BIASES`; DSS-1 is the
reference.

- all together, with R's plain weights and with exact ones (angle random walk as it correlates the residuals),
- in two steps, once, as R writes algorithm 2: attitude first, then alignment,
- in two steps, repeated until nothing changes.

One round of two steps is biased: the attitude has already been moved to please misaligned sensors. How much of the truth it
keeps depends on the weights, and so on the Earth sensor's sigma; the study varies it, the noise with it. The covariance P it
states is about its own mean T m; about the truth m its NEES should be that of an honest estimate and mᵀ(I − T)ᵀ P⁻¹ (I − T) m.

The control has the head angles of R instead of a misalignment, which no rotation of the sensor can stand for.

Each calibration says what no measurement tells if no sensor is held: a rotation of all sensors together.

Of the scenario only the gyro's angle random walk is used.
"""

from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import Field, field_validator

from gyrocal.sensors.alignment import AlignmentResult, in_two_steps, together
from gyrocal.sensors.earth import TRMM_BIASES, EarthSensor
from simulator.sensors import sun as true_sun
from studies.estimation.attitude_cases import (
    ANGLES,
    M_TRUE,
    AlignmentOrbit,
    FixedFlightConfig,
    alignment_error,
    alignment_orbit,
)
from studies.estimation.judging import HONEST, judged, nees_distribution, score, word
from studies.montecarlo.statistics import LEVELS, accuracy_table, nees
from studies.montecarlo.study import Streams, Study, dispersed
from studies.report.entry import Entry, Report
from studies.report.panels import STYLE, save
from studies.report.tables import Table

Array = NDArray[np.float64]

PARAMETERS = ("DSS-2 m_x", "DSS-2 m_y", "DSS-2 m_z", "ESA bias_1", "ESA bias_2", "ESA bias_3", "ESA bias_4")
UNITS = ("mdeg",) * 7
INJECTED = np.concatenate([ANGLES, TRMM_BIASES])
MDEG = 1e3 * np.rad2deg(1.0)
ERRORS, SIGMAS, MEANS = ([f"{what}_{k}_mdeg" for k in range(1, 8)] for what in ("error", "sigma", "expected"))
RETAINED = [f"retained_{k}" for k in range(1, 8)]

TOGETHER, EXACT, REPEATED, ONCE = "together", "together, exact weights", "two steps, repeated", "two steps, once"
HEADS = "together, exact weights: R's head angles"
EXPECTED = {TOGETHER: True, EXACT: True, REPEATED: True, HEADS: False}  # honest about the truth; of ONCE see `_expected`
COMMON = tuple(f"a rotation of all sensors together about body {axis}" for axis in "xyz")


class AlignmentConfig(FixedFlightConfig):
    """What the study runs; its orbit and sensors are fixed.

    Attributes
    ----------
    esa_factors : by how much the Earth sensor is better than TRMM's, for one round of two steps
    tolerance : largest last change of repeated steps, sigma
    """

    used: ClassVar[tuple[str, ...]] = ("gyro.arw_deg_per_sqrt_s",)
    cases: int = 200
    esa_factors: tuple[float, ...] = (1.0, 10.0, 50.0)
    tolerance: float = Field(default=1e-3, gt=0, lt=1)

    @field_validator("esa_factors")
    @classmethod
    def _positive(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not value or min(value) <= 0 or len(set(value)) < len(value):
            raise ValueError("must be one or more different numbers above zero")
        return value


@lru_cache(maxsize=2)
def _orbit(arw: float) -> AlignmentOrbit:
    return alignment_orbit(arw)


def case(config: AlignmentConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """A row for each algorithm, and for each Earth sensor with one round of two steps; errors are true minus estimate."""
    arw = float(np.deg2rad(dispersed(config, number).gyro.arw_deg_per_sqrt_s))
    orbit = _orbit(arw)
    start = orbit.A[0]
    gyro = orbit.motion.gyro(streams.generator("gyro_noise"))
    series = orbit.series(streams.generator("sensor_noise"))
    one = together(series, gyro, start, "DSS-1")
    repeated = in_two_steps(series, gyro, start, "DSS-1", rounds=None, tolerance=config.tolerance)
    rows = [
        _row(TOGETHER, one),
        _row(EXACT, together(series, gyro, start, "DSS-1", weighting="exact")),
        _row(REPEATED, repeated) | {"apart_sigma": float(np.abs((_error(repeated) - _error(one)) / one.sigma).max())},
    ]
    for factor in config.esa_factors:
        better = orbit.series(streams.generator("sensor_noise"), esa_factor=factor)
        rows.append(_row(ONCE, in_two_steps(better, gyro, start, "DSS-1"), esa_factor=factor))
    heads = (true_sun.HEAD_DSS1, true_sun.HEAD_DSS2)
    spoilt = orbit.series(streams.generator("sensor_noise"), M=np.eye(3), heads=heads)
    rows.append(_row(HEADS, together(spoilt, gyro, start, "DSS-1", weighting="exact"), M=np.eye(3)))
    return rows


def _error(found: AlignmentResult, M: Array = M_TRUE) -> Array:
    return alignment_error(found.misalignment["DSS-2"], found.penetration_biases["ESA"], M)


def _row(algorithm: str, found: AlignmentResult, M: Array = M_TRUE, esa_factor: float = 1.0) -> dict[str, object]:
    error = _error(found, M)
    # In first order: what one round leaves of the parameters, none for all others.
    expected = INJECTED - found.retained @ INJECTED
    row: dict[str, object] = {
        "algorithm": algorithm,
        "esa_factor": esa_factor,
        "nees": float(nees(error[None], found.covariance[None])[0]),
        "nees_own_mean": float(nees((error - expected)[None], found.covariance[None])[0]),
        "nees_predicted": 7 + float(nees(expected[None], found.covariance[None])[0]),
        "loss_before": found.loss_before,
        "loss_after": found.loss_after,
        "loss_dof": found.dof,
        "rounds": found.rounds,
        "unobservable": "; ".join(found.unobservable),
    }
    columns = (
        (ERRORS, error * MDEG),
        (SIGMAS, found.sigma * MDEG),
        (MEANS, expected * MDEG),
        (RETAINED, np.diag(found.retained)),
    )
    for names, values in columns:
        row |= dict(zip(names, values.tolist(), strict=True))
    return row


STUDY = Study("studies.estimation.alignment:STUDY", AlignmentConfig, case)


def verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """A row an algorithm: NEES of the seven parameters about the truth with bounds, and the loss where it should be χ²."""
    out = []
    for (algorithm, factor), part in rows.groupby(["algorithm", "esa_factor"], sort=False):
        errors = part[ERRORS].to_numpy()
        standard_errors = errors.std(axis=0, ddof=1) / np.sqrt(len(part)) if len(part) > 1 else np.full(7, np.nan)
        row: dict[str, object] = {"algorithm": algorithm, "esa_factor": factor}
        row |= judged(part["nees"], 7)
        row["expected"] = _expected(str(algorithm), row, part["nees_predicted"].mean() / 7)
        row["largest_mean_in_standard_errors"] = float(np.abs(errors.mean(axis=0) / standard_errors).max())
        dof = int(part["loss_dof"].iloc[0])
        row["loss_per_dof"] = part["loss_after"].mean() / dof
        row["loss_verdict"] = judged(part["loss_after"], dof)["verdict"] if "exact" in str(algorithm) else "not χ²"
        row["rounds"] = float(part["rounds"].median())
        out.append(row)
    return pd.DataFrame(out)


def _expected(algorithm: str, row: dict[str, object], predicted: float) -> str:
    """The verdict there should be; of one round of two steps that of its predicted NEES, if that is clear of the bound."""
    if algorithm != ONCE:
        return word(EXPECTED[algorithm])
    low, high = float(str(row["low"])), float(str(row["high"]))
    bias, room = predicted - 1, high - 1
    return word(False if predicted > high + (high - low) else True if bias < 0.05 * room else None)


def one_round(rows: pd.DataFrame) -> pd.DataFrame:
    """A row an Earth sensor: what one round of two steps keeps of the truth, and its error in DSS-2's x, that is in yaw."""
    out = []
    for factor, part in rows[rows["algorithm"] == ONCE].groupby("esa_factor"):
        about = judged(part["nees_own_mean"], 7)
        yaw = part[ERRORS[0]]
        out.append(
            {
                "esa_factor": factor,
                "esa_sigma_mdeg": EarthSensor(np.zeros(4)).sigma / float(str(factor)) * MDEG,
                "kept_yaw": part[RETAINED[0]].mean(),
                "kept_least_of_the_others": part[RETAINED[1:]].mean().min(),
                "yaw_error_predicted_mdeg": part[MEANS[0]].mean(),
                "yaw_error_mdeg": yaw.mean(),
                "standard_error_mdeg": yaw.std(ddof=1) / np.sqrt(len(part)),  # NaN of one case
                "sigma_mdeg": part[SIGMAS[0]].mean(),
                "nees_per_dof_about_the_truth": part["nees"].mean() / 7,
                "nees_per_dof_predicted": part["nees_predicted"].mean() / 7,
                "nees_per_dof_about_own_mean": about["nees_per_dof"],
                "verdict_about_own_mean": about["verdict"],
            }
        )
    return pd.DataFrame(out)


def _findings(rows: pd.DataFrame) -> list[str]:
    table, rounds = verdicts(rows), one_round(rows)
    honest = table[table["algorithm"].isin([TOGETHER, EXACT, REPEATED])]
    low, high = honest[["low", "high"]].iloc[0]
    each = ", ".join(f"{row['algorithm']}: {row['nees_per_dof']:.3f} ({row['verdict']})" for _, row in honest.iterrows())
    out = [
        f"The injected misalignment and penetration biases are found to their sigma? NEES per degree of freedom over "
        f"{rows['case'].nunique()} seeds, bounds {low:.3f} to {high:.3f}: {each}."
    ]
    repeated = rows[rows["algorithm"] == REPEATED]
    out.append(
        f"Two steps repeated ({repeated['rounds'].median():.0f} rounds in the median) and all together are one answer: "
        f"{repeated['apart_sigma'].max():.1e} sigma apart at most, in any parameter of any seed."
    )
    kept = "; ".join(
        f"{row['kept_yaw']:.1%} with an ESA sigma of {row['esa_sigma_mdeg']:.2g} mdeg (error {row['yaw_error_mdeg']:.1f} "
        f"± {row['standard_error_mdeg']:.1f} mdeg, predicted {row['yaw_error_predicted_mdeg']:.1f}; NEES per degree of freedom "
        f"{row['nees_per_dof_about_the_truth']:.3g}, predicted {row['nees_per_dof_predicted']:.3g})"
        for row in rounds.to_dict("records")
    )
    out.append(f"One round of two steps keeps of DSS-2's yaw misalignment {kept}.")
    out.append(_common(rows))
    heads = rows[rows["algorithm"] == HEADS]
    apparent = heads[ERRORS[:3]].mean()
    verdict = table.loc[table["algorithm"] == HEADS, "loss_verdict"].iloc[0]
    out.append(
        f"R's head angles come out as a misalignment of {np.linalg.norm(apparent):.0f} mdeg that is not there, and leave a "
        f"loss of {heads['loss_after'].mean() / heads['loss_dof'].iloc[0]:.2f} per degree of freedom, which "
        f"{'shows it' if verdict != HONEST else 'so few seeds do not show'}."
    )
    return [*out, score(table)]


def _common(rows: pd.DataFrame) -> str:
    """How often the common rotation was reported free: about all axes, or about two where a better Earth sensor sees yaw."""
    usual = rows["esa_factor"] == 1
    whole = rows.loc[usual, "unobservable"] == "; ".join(COMMON)
    text = (
        f"Reported as free if no sensor is held: a rotation of all sensors together, about x, y and z, in {whole.sum()} of "
        f"{len(whole)} calibrations"
    )
    about = rows.loc[~usual, "unobservable"].str.count("a rotation of all sensors together about").groupby(rows["esa_factor"])
    better = [f"about {axes:g} axes with it {factor:g} times better" for factor, axes in about.median().items()]
    return text + (f" with TRMM's Earth sensor; {', '.join(better)}." if better else ".")


def report(config: AlignmentConfig, rows: pd.DataFrame) -> Report:
    """Verdicts on the algorithms, each parameter, and one round of two steps over the Earth sensor's sigma."""
    one = rows[rows["algorithm"] == TOGETHER]
    algorithms = "Algorithms (NEES of seven parameters per degree of freedom about the truth, 99.9 % bounds)"
    rounds, parameters = (
        "One round of two steps over the Earth sensor's sigma",
        "All together, by parameter (true minus estimate)",
    )
    data = {algorithms: verdicts(rows), rounds: one_round(rows)}
    names = {algorithms: "algorithms", rounds: "one_round", parameters: "parameters"}
    if len(one) > 1:  # a spread of one case is none
        data[parameters] = accuracy_table(one[ERRORS].to_numpy(), one[SIGMAS].to_numpy(), PARAMETERS, UNITS)
    dropped = {
        algorithms: ["cases", "dof", "largest_mean_in_standard_errors"],
        rounds: ["esa_factor", "kept_least_of_the_others"],
    }
    shown = {title: data[title].drop(columns=columns) for title, columns in dropped.items()}
    if parameters in data:
        kept = ["parameter", "unit", "bias", "standard_error", "spread", "formal_sigma", *(f"coverage_{k}" for k in LEVELS)]
        shown[parameters] = data[parameters][kept]
    tables = {names[title]: Table(title, table, shown=shown[title]) for title, table in data.items()}
    return Report(tables, {"alignment": partial(figure, rows)}, findings=tuple(_findings(rows)))


ENTRY = Entry(STUDY, "is the sensors' alignment found, by both algorithms, and what do two steps lose", report)


def figure(rows: pd.DataFrame, path: Path) -> Path:
    """NEES of the honest algorithms beside χ², and the yaw that one round of two steps leaves."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(8.6, 3.2), layout="constrained")
        left, right = drawing.subplots(1, 2)
        for name, colour, style in ((TOGETHER, "#30343f", "-"), (EXACT, "#00798c", "-"), (REPEATED, "#d1495b", ":")):
            nees_distribution(left, rows.loc[rows["algorithm"] == name, "nees"], 7, colour, name, style)
        left.set_xlabel("NEES about the truth, seven parameters")
        left.legend(fontsize=7, loc="lower right")
        table = one_round(rows)
        sigma = table["esa_sigma_mdeg"]
        right.errorbar(
            sigma,
            table["yaw_error_mdeg"],
            yerr=table["sigma_mdeg"],
            fmt="o",
            color="#d1495b",
            markersize=4,
            capsize=4,
            label="found: mean, stated sigma",
        )
        right.plot(sigma, table["yaw_error_predicted_mdeg"], "_", color="#00798c", markersize=16, label="(1 − T) × injected")
        for x, y, part in zip(sigma, table["yaw_error_mdeg"], table["kept_yaw"], strict=True):
            beside: dict[str, Any] = {"xytext": (9, -9), "textcoords": "offset points", "fontsize": 7, "ha": "left"}
            right.annotate(f"{part:.1%} kept", (x, y), **beside)
        right.axhline(0, color="0.4", linewidth=0.8)
        right.margins(x=0.25)
        right.set_xscale("log")
        right.set_xticks(sigma, [f"{value:.3g}" for value in sigma])
        right.minorticks_off()
        right.set_xlabel("sigma of the Earth sensor (mdeg)")
        right.set_ylabel("yaw error of DSS-2 after one round (mdeg)")
        right.legend(fontsize=7)
        return save(drawing, path)
