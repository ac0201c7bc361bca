"""Reference attitudes from a batch, a filter and a smoother: are they and the calibration fed with them consistent?

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

import numpy as np
import pandas as pd
import scipy.special
from pydantic import Field, field_validator

from studies.calibration.prepared import true_parameters
from studies.estimation import reference_rows as flown
from studies.estimation.filter_cases import SENSOR, rms_of
from studies.estimation.flights import FixedFlightConfig
from studies.estimation.reference_rows import BLOCKS, CARRIED, INDEPENDENT, WHOLE, Rows
from studies.montecarlo.statistics import nees_line
from studies.montecarlo.study import Streams, Study, dispersed
from studies.report import panels
from studies.report.checks import Check, at_most, enough_cases, expected_word, of_lines
from studies.report.entry import Entry, Report
from studies.report.tables import Table, by_group

TELLING = 0.2  # of a measurement's noise: a misalignment that must show
# Filter and smoother start from a covariance a hundred times as wide as the data leave it, which counts 1e-4; at five of its
# 1e-3 rad the start is 50 sigma off.
ONE_ANSWER = 5e-3  # sigma


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
    rows = [*flown.attitudes(streams, truth, arw), *flown.calibrations(streams, truth, arw)]
    if number % config.full_filter_every:
        return rows
    return [*rows, *flown.full_filter(streams, truth, arw, config.misalignments_deg)]


STUDY = Study("studies.estimation.references:STUDY", ReferencesConfig, case)

# Which lines must be consistent and which must not be; those about which nothing is claimed are absent.
EXPECTED: dict[tuple[str, ...], bool] = {
    **{("attitudes", name): True for name in (flown.EXACT, flown.PLAIN, flown.FILTER, flown.SMOOTHER)},
    ("attitudes", flown.FORMAL): False,
    ("apart", WHOLE): True,
    ("apart", BLOCKS): True,
    ("apart", INDEPENDENT): False,
    ("chain", WHOLE): True,
    ("chain", BLOCKS): False,
    ("chain", INDEPENDENT): False,
    ("timeline", CARRIED): True,
    ("timeline", INDEPENDENT): False,
    (flown.RIGHT, flown.FULL): True,
    (flown.RIGHT, flown.UNSTATED): True,
}
EXPECTED_BIAS: dict[tuple[str, ...], bool] = {  # of the bias alone, in the calibration
    **dict.fromkeys((("apart", WHOLE), ("apart", BLOCKS), ("chain", WHOLE), ("timeline", CARRIED)), True),
    ("apart", INDEPENDENT): False,  # long arcs say most of the bias, and both their ends share one error of it
}


def attitude_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each estimator and time: NEES with bounds, coverage, error and stated sigma."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        estimator, at = part[["estimator", "at"]].iloc[0]
        row = nees_line(part["nees"], int(part["dof"].iloc[0]))
        for level in (1, 2):
            row[f"within_{level}_sigma"] = np.nan if at == flown.TOGETHER else part[f"within_{level}"].sum() / (3 * len(part))
        return {
            **row,
            **rms_of(part, "error_mdeg", "sigma_mdeg"),
            "expected": expected_word(EXPECTED.get(("attitudes", estimator))),
        }

    own = rows[rows["part"] == "attitudes"].rename(columns={"setup": "at"})
    return by_group(own, ["estimator", "at"], line)


def calibration_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each flight, source of references and treatment: NEES of twelve parameters and of the bias alone.

    Coverage is the share of cases in which the truth is within the ellipsoid that should hold 95 %.
    """

    def line(part: pd.DataFrame) -> dict[str, object]:
        key = tuple(part[["flight", "treatment"]].iloc[0])
        bias = nees_line(part["nees_bias"], 3)
        row = nees_line(part["nees"], 12)
        row |= {f"bias_{name}": bias[name] for name in ("nees_per_dof", "low", "high", "verdict")}
        for name, values, dof in (("coverage_95", part["nees"], 12), ("bias_coverage_95", part["nees_bias"], 3)):
            row[name] = float((values <= scipy.special.chdtri(dof, 0.05)).mean())
        expected = {"expected": expected_word(EXPECTED.get(key)), "bias_expected": expected_word(EXPECTED_BIAS.get(key))}
        return {**row, **rms_of(part, "G_error_ppm", "G_sigma_ppm"), **expected}

    own = rows[rows["part"] == "calibration"].rename(columns={"setup": "flight", "estimator": "references"})
    return by_group(own, ["flight", "references", "treatment"], line)


def full_filter_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each sensor model and scheme: NEES, error and sigma of G, and the full filter's own checks."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        key = tuple(part[["sensors", "scheme"]].iloc[0])
        row = {**nees_line(part["nees"], 12), **rms_of(part, "G_error_ppm", "G_sigma_ppm")}
        row |= {name: part[name].mean() for name in ("innovations_per_dof", "changes_per_dof")}
        large = np.deg2rad(part["misaligned_deg"].iloc[0]) >= TELLING * SENSOR * (1 - 1e-9)
        return row | {"expected": expected_word(False if large and key[1] != flown.STATED else EXPECTED.get(key))}

    own = rows[rows["part"] == "full filter"].rename(columns={"setup": "sensors", "estimator": "scheme"})
    return by_group(own, ["sensors", "scheme"], line)


SAME = "The exact batch and the smoother are one answer, and so is the filter at the last time, when it knows the same."
SURE = "What a sensor's unknown misalignment shows is a filter too sure of itself, more than one less accurate."


def _checks(rows: pd.DataFrame) -> list[Check]:
    attitudes, calibrations, full = attitude_table(rows), calibration_table(rows), full_filter_table(rows)
    apart = rows.groupby(["estimator", "setup"])["apart_sigma"].max()
    last, limit = f"{flown.TIMES[-1]:g} s", at_most(ONE_ANSWER)
    out = [
        Check("smoother from the exact batch, largest", apart[flown.SMOOTHER].max(), limit, "sigma", SAME),
        Check(f"filter from the exact batch at {last}, largest", apart[flown.FILTER, last], limit, "sigma"),
    ]
    out += of_lines(attitudes, ["estimator", "at"])
    out += of_lines(calibrations, ["flight", "references", "treatment"])
    out += of_lines(calibrations, ["flight", "references", "treatment"], "bias_", "of the bias alone")
    out += of_lines(full, ["sensors", "scheme"])
    error = full.pivot_table(index="sensors", columns="scheme", values="G_error_ppm", sort=False)
    for row in full[full["scheme"] == flown.FULL].to_dict("records"):
        sensors, ratio = row["sensors"], row["G_error_ppm"] / row["G_sigma_ppm"]
        separate = row["G_error_ppm"] / error.loc[sensors, flown.UNSTATED]
        out.append(Check(f"full filter's error of G by the separate scheme's, sensors {sensors}", separate, meaning=SURE))
        out.append(Check(f"full filter's error of G by what it states, sensors {sensors}", ratio))
    return [*out, enough_cases(attitudes, calibrations, full)]


def report(config: ReferencesConfig, rows: pd.DataFrame) -> Report:
    """Verdicts on references, on the calibrations fed with them, and on the full filter."""
    calibrations = calibration_table(rows)
    short = calibrations.drop(columns=["dof", "bias_low", "bias_high", "bias_expected"])
    lines = "NEES per degree of freedom, with 99.9 % bounds; errors and sigmas are the RMS over cases and components."
    tables = {
        "attitudes": Table("Attitudes", attitude_table(rows), lines),
        "calibrations": Table("Calibration from these references, and of the bias alone", calibrations, lines, shown=short),
        "full_filter": Table("Full filter beside the separate scheme", full_filter_table(rows), lines),
    }
    return Report(tables, {"references": _figure(rows)}, tuple(_checks(rows)))


ENTRY = Entry(STUDY, "batch, filter, smoother: consistent references, and the calibration fed with them", report)


def _figure(rows: pd.DataFrame) -> panels.Draw:
    """Mean NEES per degree of freedom of the calibrations and of the full filter, with bounds of consistent ones."""
    groups = {
        f"{flight}, references by {source}": part.drop(columns=["flight", "references"])
        for (flight, source), part in calibration_table(rows).groupby(["flight", "references"], sort=False)
    }
    for sensors, part in full_filter_table(rows).groupby("sensors", sort=False):
        groups[f"sensors {sensors}"] = part.drop(columns="sensors")
    lines = sum(1 + len(part) for part in groups.values())
    return panels.sheet(panels.nees_means(groups), size=(7.6, 0.7 + 0.21 * lines))
