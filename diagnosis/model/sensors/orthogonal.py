"""What an alignment calibration would make of heads that are not at right angles.

An alignment calibration knows orthogonal matrices and biases only. In place of the heads it puts a misalignment of DSS-2, and
of what DSS-1's head turns, biases of the Earth sensor. That explanation is tested beside the one that is named, with what is
named otherwise left in. Which effects it solves for, and which it mistakes for them, the effects say themselves
(`simulator.effects.sensor.SensorEffect.alignment`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model.linear import LinearModel
from diagnosis.model.sensors.columns import effect_of
from simulator.effects.sensor import SENSOR_EFFECTS, SensorEffect

Array = NDArray[np.float64]


def solved_for(effects: Iterable[SensorEffect]) -> tuple[str, ...]:
    """Labels of what an alignment calibration solves for; none where one of them is not among the effects."""
    whole = [effect for effect in SENSOR_EFFECTS.values() if effect.alignment == "solved"]
    given = {effect.name for effect in effects}
    return tuple(effect.name for effect in whole) if all(effect.name in given for effect in whole) else ()


def orthogonal_labels(named: Sequence[str], effects: Iterable[SensorEffect]) -> tuple[str, ...]:
    """The explanation of an alignment calibration beside the one that is named.

    Parameters
    ----------
    named : labels of the causes
    effects : that may be named

    Returns
    -------
    labels; none where no cause is one that such a calibration mistakes
    """
    others = solved_for(effects)
    kept = [label for label in named if effect_of(label)[0].alignment != "mistaken"]
    return tuple(dict.fromkeys([*kept, *others])) if len(kept) < len(named) and others else ()


def identifiable(model: LinearModel, named: Sequence[str]) -> tuple[str, ...]:
    """What an orthogonal misalignment of the same sensor takes of the angles of a head that is not at right angles."""
    notes = []
    for label in named:
        effect, axis = effect_of(label)
        sensor = effect.sensor(axis)
        others = [
            one.label
            for one in model.candidates
            if one.listed
            and SENSOR_EFFECTS[one.effect].alignment == "solved"
            and SENSOR_EFFECTS[one.effect].sensor(one.axis) == sensor
        ]
        if effect.alignment != "mistaken" or not others:
            continue
        shares = zip(effect.parameters, absorbed(model, label, others), strict=True)
        text = ", ".join(f"{100 * share:.0f} % of {parameter.name.removesuffix('_deg')}" for parameter, share in shares)
        notes.append(
            f"In these data a misalignment of the whole of {sensor} would absorb {text} of its β head, in squared residuals"
        )
    return tuple(notes)


def absorbed(model: LinearModel, label: str, by: Sequence[str]) -> Array:
    """(k,) share of each amplitude's trace, in square, that the columns of other effects can take.

    Parameters
    ----------
    label : of the effect, its first option
    by : labels of the others
    """
    own, *others = (_columns(model, one) for one in (label, *by))
    basis = scipy.linalg.orth(np.hstack(others))
    return np.asarray(np.sum((basis.T @ own) ** 2, axis=0) / np.sum(own**2, axis=0))


def _columns(model: LinearModel, label: str) -> Array:
    place = model.find(label)
    assert place is not None
    return model.X[:, model.candidates[place].options[0].columns]
