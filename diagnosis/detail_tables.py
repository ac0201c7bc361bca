"""Tables for an answer's figures: residuals of the references, and what each cause explains of them."""

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
    """Build the tables of an answer's figures; `table` holds the statistics of the residuals by interval, axis and phase."""
    model, fitted = prepared.model, explained.fitted
    contribution = sum((model.project_out_nuisance(cause.contribution) for cause in fitted), np.zeros(model.size))
    before, band = localization.compute_body_residuals(model, model.y)
    after, _ = localization.compute_body_residuals(model, model.y - contribution)
    names = np.array([model.recording.intervals[block.interval].name for block in model.blocks])
    interval = names[model.observation_block]
    residuals = pd.DataFrame({"interval": interval, "t_s": model.observation_t_s})
    for label, values in (("before", before), ("band", band), ("after", after)):
        for k, axis in enumerate(AXES):
            residuals[f"{label}_{axis}"] = np.rad2deg(values[:, k])
    regressors = []
    for cause in fitted:
        removed = model.project_out_nuisance(cause.contribution)
        effect, _ = localization.compute_body_residuals(model, removed)
        remaining, _ = localization.compute_body_residuals(model, model.y - (contribution - removed))
        for k, axis in enumerate(AXES):
            regressors.append(
                pd.DataFrame(
                    {
                        "cause": cause.label,
                        "interval": interval,
                        "axis": axis,
                        "t_s": model.observation_t_s,
                        "regressor_deg": np.rad2deg(effect[:, k]),
                        "residual_deg": np.rad2deg(remaining[:, k]),
                    }
                )
            )
    columns = ["cause", "interval", "axis", "t_s", "regressor_deg", "residual_deg"]
    return Details(
        residuals=residuals,
        statistics=table,
        regressors=pd.concat(regressors, ignore_index=True) if regressors else pd.DataFrame(columns=columns),
        fitted=explained.fitted,
        unnamed=explained.unnamed,
    )
