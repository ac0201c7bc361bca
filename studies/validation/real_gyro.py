"""The gap budget of a real gyro: each BROAD trial is imported, calibrated, diagnosed, and its second half predicted.

A case is a trial (`studies.validation.broad`, docs/validation.md). Trials share nothing: sensor units differ, each has
its own budget. G, b and the remainder of the first half predict the attitudes of the second half from many starts, see
`gyrocal.estimation.prediction_consistency`. Nothing is drawn at random.
"""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from pydantic import Field, ValidationInfo, field_validator

from diagnosis.budget import Step
from diagnosis.diagnose import diagnose
from diagnosis.result import Diagnosis
from diagnosis.settings import DEFAULT
from gyrocal import Recording, calibrate
from gyrocal.calibration.remainder import add_remainder
from gyrocal.estimation.prediction_consistency import compute_prediction_errors, cut_recording
from gyrocal.estimation.remainder_noise import KnownCalibration
from studies.montecarlo.manifest import hash_bytes
from studies.montecarlo.study import GridConfig, Streams, Study
from studies.report import diagnosis_figures, tables
from studies.report.checks import Check
from studies.report.diagnosis_sections import list_remainder_sizes
from studies.report.entry import Entry, Report
from studies.report.panels import Draw, Panel, build_sheet
from studies.report.tables import NO_VALUE, Table
from studies.validation import broad

Row = dict[str, Any]

REPOSITORY_ROOT = Path(__file__).parents[2]
BROAD_FOLDER = "../shared/real/broad"
CONSISTENT_RMS_RANGE = (0.8, 1.25)  # RMS of normalised errors where stated covariances hold
ACROSS = 2  # panels of the figure side by side
MOST_LISTED = 2  # causes of a group that are listed by name
STEP_INCHES, PANEL_INCHES = 0.27, 0.85  # height of a step, and of title and axis

PREDICTION = (
    "Predicted attitudes of the second half have normalised errors with an RMS of one where the covariance holds. "
    "Errors over long horizons overlap, so those of one trial scatter more than those of all."
)


class RealConfig(GridConfig):
    """Which trials."""

    axes: ClassVar = ("trials",)
    folder: str = BROAD_FOLDER  # of the trials; a relative one counts from the repository
    # names of their files without ending; all of the folder by default
    trials: tuple[str, ...] = Field(default=(), validate_default=True)

    @field_validator("trials")
    @classmethod
    def _find_trials(cls, value: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        folder = (REPOSITORY_ROOT / info.data.get("folder", BROAD_FOLDER)).resolve()
        available = tuple(sorted(path.stem for path in folder.glob("*.parquet")))
        absent = [name for name in value if name not in available]
        if absent or not available:
            raise ValueError(
                f"no trial {', '.join(absent) or 'at all'} in {folder}; the BROAD trials are not part of this project "
                "(docs/validation.md says where they come from), point folder at them"
            )
        return value or available

    def points(self) -> tuple[str, ...]:
        """Return the trial of each case."""
        return self.trials

    def file(self, number: int) -> Path:
        """Return the file of a case."""
        return (REPOSITORY_ROOT / self.folder).resolve() / f"{self.trials[number]}.parquet"


def read_recording(config: RealConfig, number: int, streams: Streams) -> Recording:
    """Read a trial as a recording."""
    return broad.build_recording(broad.read(config.file(number))).recording


def run_case(config: RealConfig, number: int, streams: Streams) -> list[Row]:
    """Calibrate, predict and diagnose a trial; the column `kind` tells rows of the trial, causes, steps and predictions."""
    recording = read_recording(config, number, streams)
    result = add_remainder(recording, calibrate(recording))
    widened = 1.0 if result.remainder is None else float(np.median(result.remainder.sigma / result.sigma))
    trial: Row = {"kind": "trial", "chi2_per_dof": result.chi2 / result.dof, "sigmas_widened": widened}
    diagnosis = diagnose(recording, seed=config.entropy)
    trial |= summarise_diagnosis(diagnosis) | {"sha256": hash_bytes(config.file(number).read_bytes())}
    rows = [trial, *build_cause_and_step_rows(diagnosis), *build_prediction_rows(recording)]
    return [{"trial": config.trials[number], **row} for row in rows]


def summarise_diagnosis(diagnosis: Diagnosis) -> Row:
    """Summarise an answer: verdict, share of the misfit that all causes close, and the remainder with share, side and size."""
    row: Row = {"verdict": diagnosis.verdict, "unknown_probability": diagnosis.unknown_probability}
    if diagnosis.closure is not None:
        row |= {"closed": diagnosis.closure.closed, **split_interval("closed", diagnosis.closure.interval_90)}
    for step in diagnosis.budget:
        if step.step == "remainder":
            row |= {"remainder": step.closed, **split_interval("remainder", step.interval_90)}
            row["remainder_deg"] = step.misfit_deg
    if diagnosis.remainder is not None:
        row |= {"remainder_side": diagnosis.remainder.side, "remainder_size": list_remainder_sizes(diagnosis.remainder)}
    return row


def split_interval(name: str, interval: tuple[float, float] | None) -> Row:
    """Split an interval into two columns."""
    low, high = (np.nan, np.nan) if interval is None else interval
    return {f"{name}_low": low, f"{name}_high": high}


def build_cause_and_step_rows(diagnosis: Diagnosis) -> Iterator[Row]:
    """Build a row for each cause, with the probability of it or of one indistinguishable from it, and for each budget step."""
    for cause in diagnosis.causes:
        row = {"kind": "cause", "cause": cause.label, "size": cause.size, "sigma": cause.sigma, "unit": cause.unit}
        yield row | {"probability": cause.group_probability, "group": ", ".join(cause.group)}
    for step in diagnosis.budget:
        row = {name: getattr(step, name) for name in ("step", "misfit", "misfit_deg", "closed", "size", "sigma", "unit")}
        yield {"kind": "step", **row, **split_interval("closed", step.interval_90)}


def build_prediction_rows(recording: Recording) -> list[Row]:
    """Build a row for each horizon: errors of predictions in the second half by a calibration of the first half."""
    start_s, stop_s = recording.intervals[0].start_s, recording.intervals[-1].stop_s
    half_s = 0.5 * (start_s + stop_s)
    first, second = cut_recording(recording, start_s, half_s), cut_recording(recording, half_s, stop_s)
    calibration = KnownCalibration.build(add_remainder(first, calibrate(first)))
    return [
        {
            "kind": "prediction",
            "horizon_s": error.horizon_s,
            "predictions": float(len(error.error)),
            "rms_deg": float(np.rad2deg(error.rms)),
            "normalised_rms": float(np.sqrt(np.mean(np.square(error.normalised_rms)))),
            **{f"normalised_{axis}": float(value) for axis, value in zip("xyz", error.normalised_rms, strict=True)},
        }
        for error in compute_prediction_errors(second, calibration)
    ]


STUDY = Study("studies.validation.real_gyro:STUDY", RealConfig, run_case, read_recording)


def select_rows(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    """Select the rows of a kind with the columns that they have."""
    kind_rows = rows[rows["kind"] == kind].drop(columns=["kind", "case", "error"], errors="ignore")
    return kind_rows.dropna(axis=1, how="all").reset_index(drop=True)


def build_report(config: RealConfig, rows: pd.DataFrame) -> Report:
    """Build checks, tables and the figure of all waterfalls."""
    trials, causes, steps, predictions = (select_rows(rows, kind) for kind in ("trial", "cause", "step", "prediction"))
    tables = {
        "trials": Table(
            "Diagnosis of each trial",
            trials,
            "A probability is that of the cause or of an indistinguishable one. Shares are those of the held-out misfit, with "
            "90 % intervals. The remainder has no identified cause.",
            shown=describe_trials(trials, causes),
        ),
        "predictions": Table("Predictions of the second half by a calibration of the first half", predictions),
    }
    checks = (*check_verdicts(trials, causes), *check_predictions(predictions))
    return Report(tables, {"waterfalls": draw_waterfalls(steps)} if len(steps) else {}, checks, (broad.BROAD_ATTRIBUTION,))


def describe_trials(trials: pd.DataFrame, causes: pd.DataFrame) -> pd.DataFrame:
    """Describe each trial in a row of texts."""
    by_trial: dict[str, list[str]] = {}
    for row in causes.to_dict("records"):
        size = tables.format_size(row["size"], row["sigma"], row["unit"])
        group = row["group"].split(", ")
        name = " or ".join(group) if row["cause"] in group and len(group) <= MOST_LISTED else row["cause"]
        by_trial.setdefault(row["trial"], []).append(f"{name} {size} ({tables.format_percent(row['probability'])})")
    return pd.DataFrame(
        {
            "trial": row["trial"],
            "verdict": row["verdict"],
            "causes": "; ".join(by_trial.get(row["trial"], [])) or NO_VALUE,
            "closed": describe_share(row, "closed"),
            "remainder": describe_share(row, "remainder"),
            "side": row.get("remainder_side", np.nan),
            "size": row.get("remainder_size", np.nan),
            "χ² per degree of freedom": row["chi2_per_dof"],
            "sigmas widened": row["sigmas_widened"],
        }
        for row in trials.to_dict("records")
    )


def describe_share(row: Mapping[Any, Any], name: str) -> str:
    """Describe a share with its interval."""
    if pd.isna(row.get(name)):
        return NO_VALUE
    return tables.format_share(row[name], (row[f"{name}_low"], row[f"{name}_high"]))


def check_verdicts(trials: pd.DataFrame, causes: pd.DataFrame) -> list[Check]:
    """Count the verdicts, and list the causes that are identified in every trial, alone or in a group."""
    counts = ", ".join(f"{verdict} {count}" for verdict, count in trials["verdict"].value_counts().items())
    identified = causes[causes["probability"] >= DEFAULT.named] if len(causes) else pd.DataFrame(columns=["trial", "group"])
    members = [set(", ".join(groups).split(", ")) for _, groups in identified.groupby("trial")["group"]]
    common = set.intersection(*members) if len(members) == len(trials) else set()
    return [
        Check(f"verdicts of {len(trials)} trials", counts),
        Check("causes identified in every trial", ", ".join(sorted(common)) or "none"),
    ]


def check_predictions(predictions: pd.DataFrame) -> list[Check]:
    """Check the normalised errors of all trials over each horizon, and count the consistent trials."""
    low, high = CONSISTENT_RMS_RANGE
    checks = []
    for horizon, part in predictions.groupby("horizon_s"):
        normalised_rms = part["normalised_rms"].dropna()
        rms, inside = float(np.sqrt(np.mean(np.square(normalised_rms)))), int(normalised_rms.between(low, high).sum())
        checks += [
            Check(f"normalised error over {horizon:g} s, RMS of all trials", rms, CONSISTENT_RMS_RANGE, "", PREDICTION),
            Check(f"trials with {low:g} to {high:g} over {horizon:g} s, of {len(normalised_rms)}", inside),
        ]
    return checks


def draw_waterfalls(steps: pd.DataFrame) -> Draw:
    """Draw the waterfalls of all trials."""
    budgets = {str(name): tuple(build_step(row) for row in part.to_dict("records")) for name, part in steps.groupby("trial")}
    panels = [
        Panel(partial(diagnosis_figures.draw_steps, budget=budget), title=name, x="held-out whitened mean square")
        for name, budget in budgets.items()
    ]
    columns = min(ACROSS, len(panels))
    panels += [Panel(Axes.set_axis_off)] * (-len(panels) % columns)
    height = STEP_INCHES * max(map(len, budgets.values())) + PANEL_INCHES
    return build_sheet(*panels, size=(5.5 * columns, height * (len(panels) // columns)), columns=columns)


def build_step(row: Mapping[Any, Any]) -> Step:
    """Build a step of a budget from its row."""
    closed: tuple[Any, ...] = () if pd.isna(row["closed"]) else (row["closed"], (row["closed_low"], row["closed_high"]))
    return Step(row["step"], row["misfit"], row["misfit_deg"], *closed)


ENTRY = Entry(STUDY, "the gap budget of recorded MEMS gyros, and predictions of their second half (BROAD)", build_report)
