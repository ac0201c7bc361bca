"""The answer of a diagnosis, and the tables its figures are drawn from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from diagnosis.answer import Amplitudes, Cause, Closure, Explanations, Finding, RemainderSummary, Verdict
from diagnosis.budget import MisfitSize, Step, measure_misfit_size
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.inference.conformal import build_conformal_set
from diagnosis.sensor_result import SensorDiagnosis
from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array
from gyrocal.masking import DataMask

if TYPE_CHECKING:
    from diagnosis.plan.invisible import InvisibleEffect


@dataclass(frozen=True)
class Details:
    """Tables for figures; angles in degrees, body axes x, y, z in columns."""

    residuals: pd.DataFrame  # interval, t_s, before_x…z, band_x…z (one sigma under M0, after its own fit), after_x…z
    statistics: pd.DataFrame  # interval, axis, phase, statistic, value, dof, p_value — the map
    # cause, interval, axis, t_s, regressor_deg (error by the cause at its estimated size), residual_deg (residual under M0 less
    # the errors by the other causes)
    regressors: pd.DataFrame
    fitted: tuple[FittedEffect, ...] = ()  # the causes of the attitude
    unnamed: tuple[FittedEffect, ...] = ()  # members of the remainder


@dataclass(frozen=True)
class Diagnosis:
    """The whole answer; `to_json` is the documented format.

    Attributes
    ----------
    recording : title
    verdict : none, named, group, partial, unknown, not identifiable
    present, p_value, false_alarm_rate : the gap; p of the whole, and the rate of false alarms the threshold stands for
    where : findings, the strongest first
    causes : one for each effect of the best explanation
    alternatives : (effects, probability) of the next best explanations
    unknown_probability : that an effect outside the library is at work
    closure : None without a named cause or where it could not be measured
    G, bias, sigma_G, sigma_bias : calibration with the causes in the model, bias in rad/s
    baseline_G, baseline_bias : calibration under M0
    notes : limits of this recording, in sentences
    runtime_s : time taken
    details : tables for the figures
    sensors : diagnosis of the raw sensor tables, where there are any; its causes are among those above
    p_values : of each test by its name, under M0
    posterior : labels of each explanation with its probability, the likeliest first, to a sum of 0.999; "unknown" stands for
        all that hold something unlisted; without a gap, the empty explanation
    amplitudes : joint posterior of the effects that are linear, for a scenario with them in it
    budget : steps of the gap budget on held-out data
    remainder : the part of the misfit that no identified cause explains; None where none is left or estimated
    sigma_nominal : (12,) sigma of G row by row and b, rad/s, under the stated noise alone; None where it is the only one
    mask, masked, masked_share : stretches that were not measured and are left out, a sentence for each kind, and the share of
        the gyro samples in them
    invisible : effects that this recording cannot show and that move G and b most
    unobserved : elements of G and b that its motions do not show
    """

    recording: str
    verdict: Verdict
    present: bool
    p_value: float
    false_alarm_rate: float
    where: tuple[Finding, ...]
    causes: tuple[Cause, ...]
    alternatives: Explanations
    unknown_probability: float
    closure: Closure | None
    G: Array
    bias: Array
    sigma_G: Array
    sigma_bias: Array
    baseline_G: Array
    baseline_bias: Array
    notes: tuple[str, ...]
    runtime_s: float
    details: Details = field(repr=False)
    sensors: SensorDiagnosis | None = None
    p_values: Mapping[str, float] = field(default_factory=dict)
    posterior: Explanations = ()
    amplitudes: Amplitudes = field(default_factory=Amplitudes)
    budget: tuple[Step, ...] = ()
    remainder: RemainderSummary | None = None
    sigma_nominal: Array | None = None
    mask: DataMask = field(default_factory=DataMask)
    masked: tuple[str, ...] = ()
    masked_share: float = 0.0
    invisible: tuple[InvisibleEffect, ...] = ()
    unobserved: tuple[str, ...] = ()

    @property
    def misfit_size(self) -> MisfitSize | None:
        """Size of the misfit of held-out attitudes beside the stated noise; None where the attitude shows none."""
        return measure_misfit_size(self.budget, self.details.residuals)

    @property
    def conformal_90(self) -> tuple[str, ...]:
        """Explanations in the set that holds the truth in nine of ten recordings; ``none`` is the baseline."""
        return build_conformal_set(self.posterior, DEFAULT.conformal)

    def _summarise_sigmas(self) -> dict[str, Any]:
        """Return the sigmas under the stated noise and with the remainder, G row by row and b in deg/s, and which to use."""
        sigmas = np.concatenate([self.sigma_G.ravel(), self.sigma_bias])
        unit = np.concatenate([np.ones(self.sigma_G.size), np.full(3, np.rad2deg(1.0))])
        nominal = sigmas if self.sigma_nominal is None else self.sigma_nominal
        return {
            "sigma_nominal": (nominal * unit).tolist(),
            "sigma_with_remainder": (sigmas * unit).tolist(),
            "recommended": "nominal" if self.sigma_nominal is None else "with_remainder",
        }

    def to_json(self) -> dict[str, Any]:
        """Return the result as one object, format 1."""
        return {
            "format": 1,
            "recording": self.recording,
            "verdict": self.verdict,
            "gap": {"present": self.present, "p_value": self.p_value, "false_alarm_rate": self.false_alarm_rate},
            "where": [
                {
                    "signal": finding.signal,
                    "interval": finding.interval,
                    "axis": finding.axis,
                    "window_s": None if finding.window_s is None else list(finding.window_s),
                    "statistic": finding.statistic,
                    "value": finding.value,
                    "p_value": finding.p_value,
                    "text": finding.text,
                }
                for finding in self.where
            ],
            "causes": [
                {
                    **({"effect": cause.effect} if cause.named else {}),
                    "axis": cause.axis,
                    "size": cause.size,
                    "unit": cause.unit,
                    "sigma": cause.sigma,
                    "parameters": cause.parameters,
                    "probability": cause.probability,
                    "group": list(cause.group),
                    "group_probability": cause.group_probability,
                    "levels": None if cause.levels is None else cause.levels.to_json(),
                }
                for cause in self.causes
            ],
            "alternatives": [
                {"effects": list(effects), "probability": probability} for effects, probability in self.alternatives
            ],
            "unknown_probability": self.unknown_probability,
            "closure": None if self.closure is None else self.closure.to_json(),
            "calibration": {
                "G": self.G.tolist(),
                "bias_deg_s": np.rad2deg(self.bias).tolist(),
                "sigma_G": self.sigma_G.tolist(),
                "sigma_bias_deg_s": np.rad2deg(self.sigma_bias).tolist(),
                "baseline_G": self.baseline_G.tolist(),
                "baseline_bias_deg_s": np.rad2deg(self.baseline_bias).tolist(),
                **self._summarise_sigmas(),
            },
            "budget": [step.to_json() for step in self.budget],
            "remainder": None if self.remainder is None else self.remainder.to_json(),
            "misfit_size": None
            if self.misfit_size is None
            else vars(self.misfit_size) | {"material": self.misfit_size.material},
            "unobserved": list(self.unobserved),
            "masked": self.mask.to_json(),
            "masked_share": self.masked_share,
            "invisible": [effect.to_json() for effect in self.invisible],
            "p_values": dict(self.p_values),
            "posterior": [{"effects": list(labels), "probability": probability} for labels, probability in self.posterior],
            "conformal_90": list(self.conformal_90),
            "notes": list(self.notes),
            "runtime_s": self.runtime_s,
            **({} if self.sensors is None else {"sensors": self.sensors.to_json()}),
        }
