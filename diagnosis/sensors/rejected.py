"""What an alignment calibration would make of heads that are not at right angles, and how far it fails.

An alignment calibration knows orthogonal matrices and biases only. In place of the heads it puts a misalignment of DSS-2, and
of what DSS-1's head turns, biases of the Earth sensor. The comparison is made with what is named otherwise left in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy.special import chdtrc

from diagnosis.inference.search import Explanation
from diagnosis.sensors.reduced import Reduced
from diagnosis.sensors.search import LARGEST_SET, SensorSearch
from diagnosis.sensors.sizes import Sized, closure

ORTHOGONAL = ("dss_misalignment", "esa_bias")


@dataclass(frozen=True)
class Rejected:
    """An explanation that was put to the test beside the one that is named.

    Attributes
    ----------
    effects : labels
    log_bayes_factor : natural logarithm of how much likelier the data are under what is named
    before, after : mean square on days left out, under M0 and with it; the floor is 1
    p_value : that noise as stated leaves that much
    """

    effects: tuple[str, ...]
    log_bayes_factor: float
    before: float
    after: float
    p_value: float

    def to_json(self) -> dict[str, Any]:
        """One object."""
        return {**asdict(self), "effects": list(self.effects)}


def orthogonal(
    about_m0: Reduced, model: Reduced, search: SensorSearch, best: Explanation, found: Sequence[Sized]
) -> Rejected | None:
    """The orthogonal explanation beside what is named; None where no head is, or the effects of the former may not be named.

    Parameters
    ----------
    about_m0, model : linear models about M0 and about what was found
    search : of the latter
    best : the explanation that is named
    found : its effects
    """
    heads = [one.label for one in found if one.effect == "dss_head"]
    if not heads or not set(ORTHOGONAL) <= set(model.nameable):
        return None
    labels = tuple(dict.fromkeys([*(one.label for one in found if one.label not in heads), *ORTHOGONAL]))
    other = search.of(labels)
    if other is None:
        return None
    held_out = closure(about_m0, model, LARGEST_SET, fixed=labels)
    p_value = float(chdtrc(model.dof, held_out.after * model.dof))
    return Rejected(labels, best.log_evidence - other.log_evidence, held_out.before, held_out.after, max(p_value, 1e-300))
