"""Reference attitudes from a batch, a filter and a smoother: are their covariances honest, and the calibration fed with them?

Three parts, the third, which takes three quarters of the time, in every so many cases only.

**Attitudes.** 25 minutes with a slew of 90°, the Sun and nadir measured every 10 s. The same data through a batch (exact and
plain weights), a Kalman filter and its smoother; the attitude at three times, each by itself and together. Exact batch and
smoother must be one answer, and at the last time the filter too. The control is the plain batch's formal covariance, which
knows no gyro noise.

**Calibration.** Two flights of `studies.estimation.reference_cases`, "apart" and "chain", with batch references of plain and
of exact weights, and the timeline of `studies.estimation.filter_cases` with a filter's. Each is calibrated with what the
references share taken into account, as one covariance V of all residuals or as a C for each interval, and with references
taken for independent, the control. A smoother's references are those of the exact batch.

**Full filter.** The filter of all twelve parameters beside the separate scheme (filter for attitude and bias, calibrator beside
it), on one pass of that timeline: with sensors that are as modelled, and with a Sun sensor misaligned by a part of a
measurement's noise (0.05° a component) that nobody knows of. The separate scheme is then solved with and without such an error
stated for each reference; the full filter has nowhere to state it.

Of the scenario only the gyro's true parameters and angle random walk are used.
"""

from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import scipy.special
from matplotlib.figure import Figure
from pydantic import Field, field_validator

from studies.estimation.attitude_cases import FixedFlightConfig
from studies.estimation.filter_cases import SENSOR, true_parameters
from studies.estimation.judging import HONEST, judged, score, word
from studies.estimation.reference_rows import (
    BLOCKS,
    CARRIED,
    EXACT,
    FILTER,
    FORMAL,
    FULL,
    INDEPENDENT,
    PLAIN,
    RIGHT,
    SMOOTHER,
    STATED,
    TIMES,
    TOGETHER,
    UNSTATED,
    WHOLE,
    Rows,
    attitudes,
    calibrations,
    full_filter,
)
from studies.montecarlo.study import Streams, Study, dispersed
from studies.report.entry import Entry, Report
from studies.report.panels import STYLE, save
from studies.report.tables import Table

TELLING = 0.2  # of a measurement's noise: a misalignment that must show


class ReferencesConfig(FixedFlightConfig):
    """What the study runs; flights and sensors are fixed.

    Attributes
    ----------
    full_filter_every : the full filter runs in each case that this divides
    misalignments_deg : 1-sigma about each axis of what nobody knows of the Sun sensor, one after the other
    """

    cases: int = 200
    full_filter_every: int = Field(default=4, ge=1)
    misalignments_deg: tuple[float, ...] = (0.01, 0.04)

    @field_validator("misalignments_deg")
    @classmethod
    def _small(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not value or not 0 < min(value) <= max(value) < 1 or list(value) != sorted(set(value)):
            raise ValueError("must be one or more numbers between 0 and 1, ascending")
        return value


def case(config: ReferencesConfig, number: int, streams: Streams) -> Rows:
    """Rows of all parts."""
    scenario = dispersed(config, number)
    truth, arw = true_parameters(scenario), float(np.deg2rad(scenario.gyro.arw_deg_per_sqrt_s))
    rows = [*attitudes(streams, truth, arw), *calibrations(streams, truth, arw)]
    return rows if number % config.full_filter_every else [*rows, *full_filter(streams, truth, arw, config.misalignments_deg)]


STUDY = Study("studies.estimation.references:STUDY", ReferencesConfig, case)

# Which lines must be honest and which must not; those about which nothing is claimed are absent.
EXPECTED: dict[tuple[str, str, str], bool] = {
    **{("attitudes", name, ""): True for name in (EXACT, PLAIN, FILTER, SMOOTHER)},
    ("attitudes", FORMAL, ""): False,
    ("calibration", "apart", WHOLE): True,
    ("calibration", "apart", BLOCKS): True,
    ("calibration", "apart", INDEPENDENT): False,
    ("calibration", "chain", WHOLE): True,
    ("calibration", "chain", BLOCKS): False,
    ("calibration", "chain", INDEPENDENT): False,
    ("calibration", "timeline", CARRIED): True,
    ("calibration", "timeline", INDEPENDENT): False,
    ("full filter", RIGHT, FULL): True,
    ("full filter", RIGHT, UNSTATED): True,
}
EXPECTED_BIAS: dict[tuple[str, str], bool] = {  # of the bias alone, in the calibration
    **dict.fromkeys((("apart", WHOLE), ("apart", BLOCKS), ("chain", WHOLE), ("timeline", CARRIED)), True),
    ("apart", INDEPENDENT): False,  # long stretches say most of the bias, and both their ends share one error of it
}


def attitude_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each estimator and time: NEES with bounds, coverage, error and stated sigma."""
    out = []
    for (estimator, setup), part in rows[rows["part"] == "attitudes"].groupby(["estimator", "setup"], sort=False):
        row: dict[str, object] = {"estimator": estimator, "at": setup, **judged(part["nees"], int(part["dof"].iloc[0]))}
        for level in (1, 2):
            row[f"within_{level}_sigma"] = part[f"within_{level}"].sum() / (3 * len(part)) if setup != TOGETHER else np.nan
        for name in ("error_mdeg", "sigma_mdeg"):
            row[name] = float(np.sqrt(np.mean(part[name] ** 2)))
        row["expected"] = word(EXPECTED.get(("attitudes", str(estimator), "")))
        out.append(row)
    return pd.DataFrame(out)


def calibration_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each flight, source of references and treatment: NEES of twelve parameters and of the bias alone.

    Coverage is the share of cases in which the truth is within the ellipsoid that should hold 95 %.
    """
    out = []
    keys = ["setup", "estimator", "treatment"]
    for (setup, source, treatment), part in rows[rows["part"] == "calibration"].groupby(keys, sort=False):
        row: dict[str, object] = {"flight": setup, "references": source, "treatment": treatment, **judged(part["nees"], 12)}
        bias = judged(part["nees_bias"], 3)
        row |= {"bias_nees_per_dof": bias["nees_per_dof"], "bias_low": bias["low"], "bias_high": bias["high"]}
        row["bias_verdict"] = bias["verdict"]
        row["bias_expected"] = word(EXPECTED_BIAS.get((str(setup), str(treatment))))
        for name, values, dof in (("coverage_95", part["nees"], 12), ("bias_coverage_95", part["nees_bias"], 3)):
            row[name] = float((values <= scipy.special.chdtri(dof, 0.05)).mean())
        row |= _root_mean(part, ("G_error_ppm", "G_sigma_ppm"))
        row["expected"] = word(EXPECTED.get(("calibration", str(setup), str(treatment))))
        out.append(row)
    return pd.DataFrame(out)


def full_filter_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each sensor model and scheme: NEES, error and sigma of G, and the full filter's own checks."""
    out = []
    for (model, scheme), part in rows[rows["part"] == "full filter"].groupby(["setup", "estimator"], sort=False):
        row: dict[str, object] = {"sensors": model, "scheme": scheme, **judged(part["nees"], 12)}
        row |= _root_mean(part, ("G_error_ppm", "G_sigma_ppm"))
        row |= {name: part[name].mean() for name in ("innovations_per_dof", "changes_per_dof")}
        telling = np.deg2rad(part["misaligned_deg"].iloc[0]) >= TELLING * SENSOR * (1 - 1e-9) and scheme != STATED
        row["expected"] = word(False if telling else EXPECTED.get(("full filter", str(model), str(scheme))))
        out.append(row)
    return pd.DataFrame(out)


def _root_mean(part: pd.DataFrame, names: tuple[str, ...]) -> dict[str, object]:
    return {name: float(np.sqrt(np.mean(part[name] ** 2))) for name in names}


def _findings(rows: pd.DataFrame) -> list[str]:
    tables = attitude_table(rows), calibration_table(rows), full_filter_table(rows)
    return [
        *_attitude_findings(rows, tables[0]),
        *_calibration_findings(tables[1]),
        *_full_filter_findings(tables[2]),
        score(*tables, _bias_alone(tables[1])),
    ]


def _bias_alone(table: pd.DataFrame) -> pd.DataFrame:
    lines = table[["flight", "references", "treatment", "bias_verdict", "bias_expected"]]
    return lines.rename(columns={"bias_verdict": "verdict", "bias_expected": "expected"}).assign(of="bias alone")


def _attitude_findings(rows: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    apart_sigma = rows.groupby(["estimator", "setup"])["apart_sigma"].max()
    last, amid = f"{TIMES[-1]:g} s", table[table["at"] == f"{TIMES[1]:g} s"].set_index("estimator")
    honest = table[~table["estimator"].isin([FORMAL])]
    worst = honest.iloc[int((honest["nees_per_dof"] - 1).abs().to_numpy().argmax())]
    errors = amid["error_mdeg"].astype(float)
    good = ", ".join(f"{name} {errors[name]:.2f}" for name in (EXACT, SMOOTHER, PLAIN, FILTER))
    formal = amid.loc[FORMAL]
    return [
        f"Batch and filter agree: the exact batch's attitudes and the smoother's are {apart_sigma[SMOOTHER].max():.1g} sigma "
        f"apart at most, those of the filter at the last time {apart_sigma[FILTER, last]:.1g}; the plain batch's "
        f"{apart_sigma[PLAIN].max():.2g}.",
        f"They cover: {(honest['verdict'] == HONEST).sum()} of {len(honest)} lines of batches, filter and smoother are "
        f"{HONEST}, the furthest with NEES per degree of freedom {worst['nees_per_dof']:.3f} ({worst['low']:.3f} to "
        f"{worst['high']:.3f}). The plain batch's formal covariance is {formal['verdict']}: {formal['nees_per_dof']:.3g}, as "
        f"it states {formal['sigma_mdeg']:.2f} mdeg where the error is {formal['error_mdeg']:.2f}.",
        f"Amid the data, at {TIMES[1]:g} s, attitude errors in mdeg a component are: {good}; the filter knows the past only.",
    ]


def _calibration_findings(table: pd.DataFrame) -> list[str]:
    out = []
    for (flight, source), part in table.groupby(["flight", "references"], sort=False):
        each = "; ".join(
            f"{row['treatment']} {row['nees_per_dof']:.3f} ({row['verdict']}), of the bias {row['bias_nees_per_dof']:.3f} "
            f"({row['bias_verdict']}), G to {row['G_error_ppm']:.0f} ppm"
            for _, row in part.iterrows()
        )
        low, high = part[["low", "high"]].iloc[0]
        out.append(
            f"Calibration, {flight}, references by {source}: NEES per degree of freedom (bounds {low:.3f} to {high:.3f}, of "
            f"the bias {part['bias_low'].iloc[0]:.3f} to {part['bias_high'].iloc[0]:.3f}) {each}."
        )
    return out


def _full_filter_findings(table: pd.DataFrame) -> list[str]:
    out = []
    for sensors, part in table.groupby("sensors", sort=False):
        by = part.set_index("scheme")
        each = "; ".join(
            f"{scheme} {row['G_error_ppm']:.0f} ppm where {row['G_sigma_ppm']:.0f} are stated (NEES per degree of freedom "
            f"{row['nees_per_dof']:.3g}, {row['verdict']})"
            for scheme, row in by.iterrows()
        )
        full = by.loc[FULL]
        out.append(
            f"Sensors {sensors}: G is wrong by: {each}. The full filter's innovations are {full['innovations_per_dof']:.3f}, "
            f"its changes {full['changes_per_dof']:.3g} times what is due."
        )
    ratio = table.pivot_table(index="sensors", columns="scheme", values="G_error_ppm", sort=False)
    ratios = "; ".join(f"{sensors} {value:.2f}" for sensors, value in (ratio[FULL] / ratio[UNSTATED]).items())
    full = table[table["scheme"] == FULL]
    sure = "; ".join(f"{row['sensors']} {row['G_error_ppm'] / row['G_sigma_ppm']:.2f}" for _, row in full.iterrows())
    out.append(
        "RXTE's trouble is a filter too sure of itself, not one less accurate. The full filter's error of G by that of the "
        f"separate scheme, with sensors {ratios}; its error by what it states, {sure}."
    )
    return out


def report(config: ReferencesConfig, rows: pd.DataFrame) -> Report:
    """Verdicts on references, on the calibrations fed with them, and on the full filter."""
    attitudes = "Attitudes (NEES per degree of freedom, 99.9 % bounds; error and sigma are the RMS over cases and components)"
    calibrations = "Calibration from these references (NEES of twelve parameters, and of the bias, per degree of freedom)"
    full = "Full filter beside the separate scheme"
    table = calibration_table(rows)
    short = table.drop(columns=["dof", "bias_low", "bias_high", "bias_expected"])
    tables = {
        "attitudes": Table(attitudes, attitude_table(rows)),
        "calibrations": Table(calibrations, table, shown=short),
        "full_filter": Table(full, full_filter_table(rows)),
    }
    return Report(tables, {"references": partial(figure, rows)}, findings=tuple(_findings(rows)))


ENTRY = Entry(STUDY, "batch, filter, smoother: honest references, and the calibration fed with them", report)


def figure(rows: pd.DataFrame, path: Path) -> Path:
    """Mean NEES per degree of freedom of the calibrations and of the full filter, with the bounds of an honest covariance."""
    groups = [
        (f"{flight}, references by {source}", part["treatment"], part)
        for (flight, source), part in calibration_table(rows).groupby(["flight", "references"], sort=False)
    ]
    groups += [
        (f"sensors {name}", part["scheme"], part) for name, part in full_filter_table(rows).groupby("sensors", sort=False)
    ]
    largest = max(part["nees_per_dof"].max() for _, _, part in groups)
    with mpl.rc_context(STYLE | {"axes.grid.axis": "x"}):
        lines = sum(1 + len(part) for _, _, part in groups)
        drawing = Figure(figsize=(7.6, 0.7 + 0.21 * lines), layout="constrained")
        axes = drawing.add_subplot()
        axes.axvline(1, color="#00798c", linewidth=0.8)
        places: list[tuple[int, str, bool]] = []
        for title, names, part in groups:
            places.append((len(places), title, True))
            heights = len(places) - 0.5, len(places) + len(part) - 0.5
            axes.fill_betweenx(heights, *part[["low", "high"]].iloc[0], color="#00798c", alpha=0.2, linewidth=0)
            for name, value, verdict in zip(names, part["nees_per_dof"], part["verdict"], strict=True):
                y = len(places)
                places.append((y, str(name), False))
                axes.plot(value, y, "o", color="#30343f" if verdict == HONEST else "#d1495b", markersize=5)
                beside: dict[str, Any] = {"xytext": (6, 0), "textcoords": "offset points", "fontsize": 7, "va": "center"}
                axes.annotate(f"{value:.3g}", (value, y), **beside)
        axes.set_yticks([y for y, _, _ in places], [name for _, name, _ in places], fontsize=7)
        for label, (_, _, heads) in zip(axes.get_yticklabels(), places, strict=True):
            label.set_fontweight("bold" if heads else "normal")
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(len(places) - 0.5, -0.5)
        axes.set_xscale("log")
        ticks = [tick for tick in (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500) if tick < 1.5 * largest]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set_xlim(right=1.4 * largest)
        axes.set_xlabel("NEES per degree of freedom, twelve parameters; band: honest; red: outside")
        return save(drawing, path)
