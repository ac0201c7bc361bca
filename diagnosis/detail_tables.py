"""The tables that an answer's figures are drawn from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from diagnosis.model import localization
from diagnosis.model.prepare import PreparedRecording
from diagnosis.result import Details

if TYPE_CHECKING:
    from diagnosis.explain import AttitudeInference

AXES = "xyz"


def build_details(prepared: PreparedRecording, explained: AttitudeInference, table: pd.DataFrame) -> Details:
    """Build the tables of an answer's figures."""
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
        fitted=explained.fitted,
        beside=explained.unnamed,
    )
