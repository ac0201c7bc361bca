"""One answer of two: what gyro and reference attitudes say, and what the raw sensor tables say."""

from __future__ import annotations

from dataclasses import replace

from diagnosis.answer import Explanations
from diagnosis.posterior import select_likeliest
from diagnosis.result import Diagnosis
from diagnosis.sensor_result import SensorDiagnosis
from diagnosis.settings import DiagnosisSettings
from diagnosis.verdict import decide_verdict

UNKNOWN_LABELS = ("unknown",)


def merge_answers(attitude: Diagnosis, sensors: SensorDiagnosis, settings: DiagnosisSettings) -> Diagnosis:
    """The result of both: a gap where either has one, the causes of both, and the verdict of all of it.

    Alternatives and closure are those of the gyro and the references if they show a gap, else those of the sensors.
    """
    present, causes = attitude.present or sensors.present, (*attitude.causes, *sensors.causes)
    unknown = 1 - (1 - attitude.unknown_probability) * (1 - sensors.unknown_probability)
    verdict = decide_verdict(
        present, causes, unknown, settings,
        beside_remainder=attitude.verdict == "partial", blind="not identifiable" in (attitude.verdict, sensors.verdict),
    )  # fmt: skip
    leading = sensors if sensors.present and not attitude.present else attitude
    return replace(
        attitude,
        verdict=verdict,
        present=present,
        p_value=min(1.0, 2 * min(attitude.p_value, sensors.p_value)),
        false_alarm_rate=attitude.false_alarm_rate + sensors.false_alarm_rate,
        where=(*attitude.where, *sensors.where),
        causes=causes,
        alternatives=leading.alternatives,
        unknown_probability=unknown,
        closure=leading.closure,
        notes=(*sensors.notes, *attitude.notes),
        p_values={**attitude.p_values, "sensor tables": sensors.p_value},
        posterior=_join_posteriors(attitude, sensors),
        sensors=sensors,
    )


def _join_posteriors(attitude: Diagnosis, sensors: SensorDiagnosis) -> Explanations:
    """Explanations of both together, which are independent of one another."""
    found: dict[tuple[str, ...], float] = {}
    for one, p in attitude.posterior:
        for other, q in sensors.posterior:
            labels = UNKNOWN_LABELS if UNKNOWN_LABELS in (one, other) else (*one, *other)
            found[labels] = found.get(labels, 0.0) + p * q
    return select_likeliest(found)
