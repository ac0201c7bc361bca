"""What the 97 s tell and what not, and the prediction: the study's only case, and its report."""

from __future__ import annotations

import pandas as pd

from studies.montecarlo.study import Row, Streams, Study, StudyConfig
from studies.report.checks import Check, bound_above, bound_below, check_extremes
from studies.report.entry import Entry, Report
from studies.report.tables import Table
from studies.validation.sentinel2a.findings import (
    MODELS,
    build_check_rows,
    build_drift_rows,
    build_forecast_rows,
    build_noise_rows,
    build_parameter_rows,
    build_residual_rows,
)
from studies.validation.sentinel2a.flight_data import SENTINEL_ATTRIBUTION, import_flight_data

HELD_OUT_ARCSEC = 2.5
PREDICTION_RMS_RANGE = (
    0.7,
    1.3,
)  # RMS in sigmas of hundreds of readings whose errors are as good as a few dozen independent ones
NOT_TOLD = (
    "Not identifiable from these 97 s: the scale factor (the angle of a count) apart from the bias along the mean rate. Only "
    "their sum, scale factor times mean rate plus bias, is known; either by itself is as wide as was assumed beforehand."
)
SHOWN_ROWS = 40  # rows of the prediction


class SentinelConfig(StudyConfig):
    """There is one flight, and so one case."""

    cases: int = 1


def run_case(config: SentinelConfig, number: int, streams: Streams) -> list[Row]:
    """All that is said of the flight, a row a number; the column `kind` says of what kind."""
    data = import_flight_data()
    rows: list[Row] = [{"kind": "assumed", "what": text} for text in data.assumed]
    for made in (
        build_drift_rows,
        build_noise_rows,
        build_parameter_rows,
        build_residual_rows,
        build_check_rows,
        build_forecast_rows,
    ):
        rows += made(data)
    return rows


STUDY = Study("studies.validation.sentinel2a.study:STUDY", SentinelConfig, run_case)


def select_kind(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    """Rows of a kind with the columns that they have."""
    chosen = rows[rows["kind"] == kind]
    return chosen.drop(columns=["kind", "case", "error"], errors="ignore").dropna(axis=1, how="all").reset_index(drop=True)


def report(config: SentinelConfig, rows: pd.DataFrame) -> Report:
    """Checks and tables."""
    drift, noise, parameters = select_kind(rows, "drift"), select_kind(rows, "noise"), select_kind(rows, "parameter")
    check, prediction = select_kind(rows, "check"), select_kind(rows, "prediction")
    nearest = check[check["from_s"] == check["from_s"].max()]
    last = list(MODELS)[-1]
    held = drift[(drift["what"] == last) & (drift["over_s"] == 30.0)]["held_out_arcsec"].iloc[0]
    value = parameters.set_index("what")["value"]
    checks = [
        Check("held-out drift over 30 s", float(held), bound_above(HELD_OUT_ARCSEC), "arcsec"),
        *check_extremes(
            "errors of a prediction over the last third, RMS", nearest["rms_in_sigma"], PREDICTION_RMS_RANGE, "sigma"
        ),
        Check(
            "errors of earlier predictions, largest RMS",
            float(check["rms_in_sigma"].max()),
            bound_above(PREDICTION_RMS_RANGE[1]),
            "sigma",
        ),
        Check("χ² per degree of freedom", float(value["chi2 per degree of freedom"]), (0.8, 1.2)),
        Check(
            "correlation of scale factor and bias along the rate",
            float(-value["correlation of the errors of scale factor and bias along"]),
            bound_below(0.95),
            "",
            NOT_TOLD,
        ),
    ]
    tables = {
        "drift": Table("Drift by gyro alone, RMS an axis with both attitudes' noise", drift),
        "check": Table("Predictions inside the first 65 s against the trackers' own readings", check),
        "parameters": Table("What is found", parameters),
        "not_identifiable": Table(
            "Not identifiable: combinations of G and b that may be added unseen", select_kind(rows, "not identifiable")
        ),
        "noise": Table("Noise", noise),
        "left": Table("What is left about the fit", select_kind(rows, "left")),
        "assumed": Table("Assumed by the import", select_kind(rows, "assumed")),
        "prediction": Table(
            "Prediction, 65 s to 97 s (some rows)",
            prediction,
            "sigma is that of a tracker's reading about its own axes, attitude_sigma that of the attitude alone.",
            shown=prediction.iloc[::SHOWN_ROWS][[name for name in prediction.columns if "attitude" not in str(name)]],
            digits=9,  # of quaternions
        ),
    }
    return Report(tables, {}, tuple(checks), (SENTINEL_ATTRIBUTION,))


ENTRY = Entry(STUDY, "97 s of a spacecraft's gyros and star trackers: drift, what cannot be told, and a prediction", report)
