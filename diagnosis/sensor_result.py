"""The answer of a diagnosis of the raw sensor tables."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import pandas as pd

from diagnosis.answer import Cause, Closure, Explanations, Finding, Verdict

SENSOR_RESIDUAL_COLUMNS = ["sensor", "angle", "interval", "t_s", "alpha_deg", "beta_deg", "before_deg", "after_deg"]


@dataclass(frozen=True)
class RejectedExplanation:
    """An alternative explanation that was tested beside the named causes."""

    effects: tuple[str, ...]  # labels
    log_bayes_factor: float  # natural logarithm of the Bayes factor of the named causes against it
    before: float  # before, after: mean square on days left out, under M0 and with it; the floor is 1
    after: float
    p_value: float  # that noise as stated leaves that much

    def to_json(self) -> dict[str, Any]:
        """Return the fields as one object."""
        return {**asdict(self), "effects": list(self.effects)}


@dataclass(frozen=True)
class SensorDiagnosis:
    """The answer of the raw sensor tables; the parts that `diagnosis.result.Diagnosis` has too mean the same there."""

    verdict: Verdict  # none, named, group or unknown
    present: bool  # present, p_value, false_alarm_rate: the gap
    p_value: float
    false_alarm_rate: float
    where: tuple[Finding, ...]  # one finding for each sensor that departs
    # of M0's residuals in sigmas, per degree of freedom; one if M0 is true, None where M0 could not be fitted
    mean_square: float | None = None
    dof: int = 0  # degrees of freedom
    causes: tuple[Cause, ...] = ()  # one for each effect of the best explanation
    alternatives: Explanations = ()  # (effects, probability) of the next best
    unknown_probability: float = 1.0  # that an effect outside the library is at work
    closure: Closure | None = None  # on days left out; None without a named cause
    rejected: tuple[RejectedExplanation, ...] = ()  # explanation of an alignment calibration, tested beside the causes
    notes: tuple[str, ...] = ()  # limits, in sentences
    # labels of each explanation with its probability, as in `diagnosis.result.Diagnosis`
    posterior: Explanations = ((("unknown",), 1.0),)
    # sensor, angle, interval, t_s, alpha_deg, beta_deg, before_deg, after_deg — the latter two are residuals under M0 and with
    # the causes taken out; alpha and beta are NaN for the Earth sensor, and so is an angle not used
    residuals: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=SENSOR_RESIDUAL_COLUMNS), repr=False)

    def to_json(self) -> dict[str, Any]:
        """Return the fields that the merged result lacks; its causes and findings are among the others there."""
        return {
            "verdict": self.verdict,
            "gap": {"present": self.present, "p_value": self.p_value, "false_alarm_rate": self.false_alarm_rate},
            "mean_square": self.mean_square,
            "degrees_of_freedom": self.dof,
            "causes": [cause.label for cause in self.causes],
            "unknown_probability": self.unknown_probability,
            "closure": None if self.closure is None else self.closure.to_json(),
            "rejected": [explanation.to_json() for explanation in self.rejected],
            "notes": list(self.notes),
        }
