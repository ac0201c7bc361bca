"""The tables that an answer's figures are drawn from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from diagnosis.detectors.sample_report import SampleTest
from diagnosis.model import localization
from diagnosis.model.prepare import PreparedRecording
from diagnosis.posterior import Attribution
from diagnosis.result import Details
from diagnosis.sensor_result import EXPLANATIONS

if TYPE_CHECKING:
    from diagnosis.explain import AttitudeInference

AXES = "xyz"

WORTH_KEEPING = 1e-6  # probability of an explanation in the details


def tabulate_explanations(attribution: Attribution | None) -> pd.DataFrame:
    """All explanations with a probability worth keeping."""
    ranked = [one for one in attribution.ranked if one.probability >= WORTH_KEEPING] if attribution is not None else []
    return pd.DataFrame.from_records(
        [(" + ".join(one.labels), one.probability, one.log_evidence, one.unlisted) for one in ranked],
        columns=EXPLANATIONS,
    )


def build_details(prepared: PreparedRecording, explained: AttitudeInference, table: pd.DataFrame) -> Details:
    """The tables of an answer's figures, of the attitude and the samples."""
    model, fitted = prepared.model, explained.fitted
    contribution = sum((model.project_out_nuisance(one.contribution) for one in fitted), np.zeros(model.size))
    before, band = localization.compute_body_residuals(model, model.y)
    after, _ = localization.compute_body_residuals(model, model.y - contribution)
    names = np.array([model.recording.intervals[block.interval].name for block in model.blocks])
    interval = names[model.observation_block]
    residuals = pd.DataFrame({"interval": interval, "t_s": model.observation_t_s})
    for label, values in (("before", before), ("band", band), ("after", after)):
        for k, axis in enumerate(AXES):
            residuals[f"{label}_{axis}"] = np.rad2deg(values[:, k])
    regressors = []
    for one in fitted:
        own = model.project_out_nuisance(one.contribution)
        effect, _ = localization.compute_body_residuals(model, own)
        left, _ = localization.compute_body_residuals(model, model.y - (contribution - own))
        for k, axis in enumerate(AXES):
            regressors.append(
                pd.DataFrame(
                    {
                        "cause": one.label,
                        "interval": interval,
                        "axis": axis,
                        "t_s": model.observation_t_s,
                        "regressor_deg": np.rad2deg(effect[:, k]),
                        "residual_deg": np.rad2deg(left[:, k]),
                    }
                )
            )
    columns = ["cause", "interval", "axis", "t_s", "regressor_deg", "residual_deg"]
    return Details(
        residuals=residuals,
        statistics=table,
        regressors=pd.concat(regressors, ignore_index=True) if regressors else pd.DataFrame(columns=columns),
        explanations=tabulate_explanations(explained.attribution),
        stream=test_table(prepared.samples.tests),
        fitted=explained.fitted,
        beside=explained.beside,
    )


def test_table(tests: Sequence[SampleTest]) -> pd.DataFrame:
    """Tabulate the tests of the samples, a row each."""
    return pd.DataFrame.from_records(
        [(t.statistic, t.axis, t.value, t.expected, t.p_value, t.text) for t in tests],
        columns=["statistic", "axis", "value", "expected", "p_value", "text"],
    )
