"""What an alignment calibration would make of heads that are not at right angles.

An alignment calibration knows orthogonal matrices and biases only. In place of the heads it puts a misalignment of DSS-2, and
of what DSS-1's head turns, biases of the Earth sensor. That explanation is tested beside the one that is named, with what is
named otherwise left in. Which effects it solves for, and which it mistakes for them, the effects say themselves
(`simulator.effects.sensor.SensorEffect.alignment`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from diagnosis.model.sensors.columns import find_sensor_effect
from simulator.effects.sensor import SENSOR_EFFECTS, SensorEffect


def list_solved_for(effects: Iterable[SensorEffect]) -> tuple[str, ...]:
    """List the labels of what an alignment calibration solves for; none where one of them is not among the effects."""
    whole = [effect for effect in SENSOR_EFFECTS.values() if effect.alignment == "solved"]
    given = {effect.name for effect in effects}
    return tuple(effect.name for effect in whole) if all(effect.name in given for effect in whole) else ()


def list_orthogonal(named: Sequence[str], effects: Iterable[SensorEffect]) -> tuple[str, ...]:
    """List the labels of the explanation of an alignment calibration beside the one that is named.

    Parameters
    ----------
    named : labels of the causes
    effects : that may be named

    Returns
    -------
    None where no cause is one that such a calibration mistakes
    """
    others = list_solved_for(effects)
    kept = [label for label in named if find_sensor_effect(label)[0].alignment != "mistaken"]
    return tuple(dict.fromkeys([*kept, *others])) if len(kept) < len(named) and others else ()
