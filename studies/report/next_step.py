"""What to do after a diagnosis: what mends the cause found, by its stage of the measuring chain, or what to look at."""

from __future__ import annotations

from diagnosis.answer import Cause
from diagnosis.result import Diagnosis
from simulator.effects.sensor import ALL_EFFECTS
from studies.report import gap_budget

_IN_MODEL = "Take scale, alignment and bias from the calibration with the cause in it, which the answer holds"
_TAGS = "Mend the gyro's time tags or undo its filter, by the size found, and calibrate again"
_SAMPLES = "Have the gyro's samples mended where they are made, in the unit's settings or its telemetry, and calibrate again"
_REFERENCES = (
    "Leave the gyro; mend the reference attitudes or take the calibration that allows for their error, which the answer holds"
)
REMEDIES = {
    "rate": _IN_MODEL,
    "random_rate": f"{_IN_MODEL}, and repeat it as often as the bias wanders by more than you can bear",
    "filter": _TAGS,
    "clock": _TAGS,
    "threshold": _SAMPLES,
    "white_noise": "State the gyro's noise as found, and calibrate again: the sigmas change",
    "pickup": _IN_MODEL,
    "outliers": _SAMPLES,
    "range": _SAMPLES,
    "resolution": _SAMPLES,
    "telemetry": _SAMPLES,
    "reference": _REFERENCES,
    "random_reference": _REFERENCES,
    "reference_noise": "State the references' noise as found, and calibrate again: the sigmas change",
    "reference_telemetry": "Leave out the references found false; the answer already does",
    "sensor": "Put the values found into the sensor's model, determine the references again, and calibrate with those",
}


def describe_next_step(diagnosis: Diagnosis) -> str:
    """Describe the next step, without the maneuvers to fly."""
    if diagnosis.verdict == "none":
        return "Use the calibration as it is."
    if diagnosis.verdict == "unknown":
        place = next((one.interval for one in diagnosis.where if one.interval), None)
        first = f"Look at {place} first: what" if place else "Look at what"
        return (
            f"{first} was different there (mode, temperature, sensors in use)? Until it is explained the calibration's errors "
            "are larger than its sigmas."
        )
    if not diagnosis.causes:
        return "Do not decide by this recording: make another one."
    remedies = list(dict.fromkeys(_find_remedy(cause) for cause in diagnosis.causes))
    left = diagnosis.remainder
    if left is not None and left.share > 0.5:
        remedies.insert(0, f"Look at {gap_budget.SIDE_NAMES[left.side]} first, from which most of the gap comes")
    return " ".join(f"{one}." for one in remedies)


def _find_remedy(cause: Cause) -> str:
    return REMEDIES[ALL_EFFECTS[cause.effect].stage] if cause.effect in ALL_EFFECTS else _IN_MODEL
