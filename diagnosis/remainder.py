"""The remainder: members of the model of a misfit that are no causes, in the units of a user.

It consists of members of the same set as the causes (`diagnosis.inference.joint_search`): random errors of gyro, references and
time tags, families outside the library, and effects that are less likely than these, or that close nothing on held-out data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.answer import UNDECIDED, Regressor, RemainderSummary
from diagnosis.arrays import AXES
from diagnosis.budget import Step, predict_held_out
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.processes import BIAS_WANDERS, REFERENCES_WANDER, TAGS_WANDER
from diagnosis.model.recording_model import RecordingModel
from diagnosis.replication import CLOCKS

SCALE_WANDERS = "scale factor or misalignment"  # begin of the names of errors in proportion to the rate
MOST_REGRESSORS = 4  # that are reported
DECISIVE = 2 / 3  # share of the power of a remainder


def summarise_remainder(
    model: RecordingModel,
    budget: Sequence[Step],
    fitted: Sequence[FittedEffect],
    unnamed: Sequence[FittedEffect],
    p_bounds: Mapping[str, float],
) -> RemainderSummary:
    """Summarise what no cause explains.

    Parameters
    ----------
    model : the recording
    budget : steps on held-out data; the last but one is the remainder's
    fitted : the causes
    unnamed : members of the remainder
    p_bounds : bound on the p-value of each member by its label
    """
    last = budget[-2]

    def size(name: str, axis: str | None) -> float:
        chosen = (effect for effect in unnamed if effect.process and effect.effect.startswith(name) and effect.axis == axis)
        return float(np.sqrt(sum(effect.size**2 for effect in chosen)))

    powers = [float(np.sum(model.project_out_nuisance(effect.contribution) ** 2)) for effect in unnamed]
    strongest = unnamed[int(np.argmax(powers))]
    return RemainderSummary(
        last.closed or 0.0, last.interval_90 or (0.0, 0.0),
        tuple(float(np.rad2deg(size(BIAS_WANDERS, axis))) * 3600 for axis in AXES),
        tuple(float(np.rad2deg(size(REFERENCES_WANDER, axis))) for axis in AXES),
        size(TAGS_WANDER, None), float(np.sqrt(sum(size(SCALE_WANDERS, axis) ** 2 for axis in AXES))),
        estimate_noise_factor(model, [*fitted, *unnamed]),
        find_remainder_side(unnamed, powers), float(strongest.parameters.get("time_constant_s", 0.0)),
        find_regressors(model, fitted, unnamed, p_bounds),
    )  # fmt: skip


def estimate_noise_factor(model: RecordingModel, members: Sequence[FittedEffect]) -> float:
    """Estimate the white noise beside all members of a set, over the stated one.

    Under y ~ N(0, φ S) with S = I + C Cᵀ of columns in units of their priors, yᵀ S⁻¹ y is φ times its degrees of freedom.
    """
    C = np.hstack([model.project_out_nuisance(member.columns * member.prior_sigma) for member in members])
    y = model.y - sum((model.project_out_nuisance(fitted.shift) for fitted in members), np.zeros(model.size))
    along = C.T @ y
    remaining = float(y @ y - along @ np.linalg.solve(np.eye(along.size) + C.T @ C, along))
    return float(np.sqrt(max(remaining, 0.0) / max(model.degrees_of_freedom, 1)))


def find_remainder_side(unnamed: Sequence[FittedEffect], powers: Sequence[float]) -> str:
    """Find the side that members of a remainder act on: gyro, references or time tags, by their powers (k,).

    Undecided where none has `DECISIVE` of the power: errors of a gyro that wanders are mistaken for wandering references.
    """
    sides: dict[str, float] = {}
    for effect, power in zip(unnamed, powers, strict=True):
        side = "time tags" if effect.effect in CLOCKS else "reference" if effect.effect.startswith("reference") else "gyro"
        sides[side] = sides.get(side, 0.0) + power
    side, power_of_side = max(sides.items(), key=lambda pair: pair[1])
    return side if power_of_side >= DECISIVE * sum(sides.values()) else UNDECIDED


def find_regressors(
    model: RecordingModel,
    fitted: Sequence[FittedEffect],
    unnamed: Sequence[FittedEffect],
    p_bounds: Mapping[str, float],
) -> tuple[Regressor, ...]:
    """Find the shapes of the remainder, with the share of the held-out misfit that each closes beside the causes.

    A shape is reported only if the 90 % interval of that share is above zero.
    """
    random = [effect for effect in unnamed if effect.process]
    shapes = [effect for effect in unnamed if not effect.process][:MOST_REGRESSORS]
    prediction = predict_held_out(model, [*fitted, *shapes], random) if shapes else None
    regressors = []
    for number, shape in enumerate(shapes, len(fitted)):
        assert prediction is not None
        share, (low, _) = prediction.closed(number, number + 1)
        if low > 0:
            regressors.append(Regressor(shape.label, p_bounds[shape.label], share))
    return tuple(regressors)
