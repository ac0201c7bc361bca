"""What the raw sensor tables say, in plain words; summary and report both show it."""

from __future__ import annotations

from diagnosis.result import Diagnosis
from diagnosis.sensor_result import RejectedExplanation, SensorDiagnosis
from studies.report import diagnosis_words as words


def describe_sensors(diagnosis: Diagnosis) -> list[str]:
    """The answer of the sensors, how sure it is, and how far the gap closes where the whole answer does not say so."""
    sensors = diagnosis.sensors
    if sensors is None:
        return []
    apart = sensors.closure is not None and sensors.closure is not diagnosis.closure
    closed = [words.describe_closure(sensors.closure)] if apart and sensors.closure else []
    return [_describe_verdict(sensors), _describe_gap(sensors), *closed, *(_describe_rejected(one) for one in sensors.rejected)]


def _describe_verdict(sensors: SensorDiagnosis) -> str:
    causes = [cause.label for cause in sensors.causes]
    if sensors.verdict == "none":
        return "Sun and Earth sensors show nothing that the nominal ones would not."
    if sensors.verdict == "unknown" or not causes:
        return "Sun or Earth sensors depart from the nominal ones in a way that no known effect explains."
    if sensors.verdict == "group":
        return "Sun or Earth sensors depart from the nominal ones, and what explains it cannot be told apart."
    return f"Sun or Earth sensors depart from the nominal ones: {words.join_items(causes, 'and')}."


def _describe_gap(sensors: SensorDiagnosis) -> str:
    if sensors.mean_square is None:
        return "Their measurements do not fit the nominal sensors in any arc."
    chance = words.format_p_value(sensors.p_value)
    return (
        "Mean square of their whitened residuals, with an attitude and a gyro bias fitted to each measurement arc (a time "
        f"of constant rate): {sensors.mean_square:.3f} with {sensors.dof} degrees of freedom; {chance} if they were nominal."
    )


def _describe_rejected(other: RejectedExplanation) -> str:
    labels = words.join_items(list(other.effects), "and")
    return (
        "An alignment calibration, which takes the two heads of a sun sensor for orthogonal, would find "
        f"{labels} instead. That does not explain the data: they are less likely by a factor of "
        f"e^{other.log_bayes_factor:.0f}, and on held-out days the mean square falls only from {other.before:.3f} to "
        f"{other.after:.3f} ({words.format_p_value(other.p_value)})."
    )
