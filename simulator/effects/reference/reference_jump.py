"""Reference attitude that is off by a constant rotation for a while: e = (e_x, e_y, e_z) from begin_s to end_s, zero elsewhere.

A camera system that takes a marker for another one, a star tracker after a wrong identification, a filter that is set anew: all
three axes jump together, and jump back or not. The size is the norm of e, constant in body axes.

Which windows a diagnosis tries follows from the innovations of the references (`gyrocal.innovations`): a jump shows
in one of them, and the return in another one. All other windows leave these innovations unexplained; they are left out with
their share of the prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gyrocal.innovations import Innovations, compute_innovations
from simulator.effects.base import Array, Parameter, Parameters, References, Surroundings, Trial
from simulator.effects.common import DEG, number
from simulator.effects.directed_effect import DirectedEffect

FEWEST_JUMP_REFERENCES = 4  # references of a recording, of which one that jumps and returns can be told
JUMP_CHI2 = 36.0  # χ² of an innovation of three axes, which noise exceeds once in 10⁷
MOST_EDGES = 10  # innovations at which a window may begin or end
MOST_BETWEEN = 3  # edges that a window may have inside
FOREVER_S = 1e12  # end of a jump that stays


@dataclass(frozen=True)
class ReferenceJump(DirectedEffect):
    """See the module."""

    @property
    def directions(self) -> tuple[Parameter, ...]:
        """The three angles."""
        return self.parameters[:3]

    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        """One about each axis inside the window."""
        t_s = references.t_s
        inside = (t_s >= number(parameters, "begin_s")) & (t_s < float(parameters.get("end_s", FOREVER_S)))
        return np.asarray(DEG * np.eye(3) * inside[:, None, None])

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """The windows between the largest innovations; where none is large, one window that stands for all."""
        seen = compute_reference_innovations(around)
        edges = find_edges(seen)
        if not edges.size:
            return (_choose_middle_window(around),)
        steps = max(len(seen.values), 2)
        middle = 0.5 * (around.references.t_s[seen.first] + around.references.t_s[seen.second])
        interval = around.references.interval[seen.second]
        stays = [_build_window(float(middle[k]), FOREVER_S, 0.5 / steps) for k in edges]
        returns = [
            # Half of the prior is that of jumps that return: even in their begin, and in the logarithm of their length.
            _build_window(float(middle[i]), float(middle[k]), 0.5 / (steps * (k - i) * np.log(steps)))
            for (p, i), (q, k) in combinations(enumerate(edges.tolist()), 2)
            if q - p <= MOST_BETWEEN and interval[i] == interval[k]
        ]
        return [*stays, *returns]

    def missing(self, around: Surroundings) -> str | None:
        """It needs a series of references."""
        references = around.references
        most = int(np.bincount(references.interval[references.interval >= 0], minlength=1).max()) if references.t_s.size else 0
        return None if most >= FEWEST_JUMP_REFERENCES else f"it needs {FEWEST_JUMP_REFERENCES} references in an interval"


def compute_reference_innovations(around: Surroundings) -> Innovations:
    """Compute the innovations of the references of a recording."""
    references, stream = around.references, around.stream
    begin = stream.t_s - 0.5 * stream.duration_s
    return compute_innovations(
        begin, stream.rates, references.t_s, references.quaternions, references.interval, around.reference_sigma, around.arw
    )


def find_edges(seen: Innovations) -> np.ndarray:
    """Find the innovations too large for noise, the largest ones, in order of time."""
    chi2 = np.sum((seen.values / seen.sigma) ** 2, axis=1)
    large = np.flatnonzero(chi2 > JUMP_CHI2)
    return np.sort(large[np.argsort(-chi2[large], kind="stable")][:MOST_EDGES])


def _build_window(begin_s: float, end_s: float, weight: float) -> Trial:
    return Trial({"begin_s": begin_s, "end_s": end_s}, float(weight))


def _choose_middle_window(around: Surroundings) -> Trial:
    """The middle third of the interval with most references, at the prior of one window of many."""
    references = around.references
    number_ = int(np.argmax(np.bincount(references.interval[references.interval >= 0])))
    t_s = np.sort(references.t_s[references.interval == number_])
    third = t_s.size // 3
    return _build_window(float(t_s[third]), float(t_s[-max(third, 1)]), 1 / references.t_s.size)


EFFECT = ReferenceJump(
    name="reference_jump",
    summary="reference attitude off by a constant rotation for a while",
    says="the reference attitude is off by {size} for a while",
    unit="deg",
    stage="reference",
    prior=(1e-4, 180.0),
    bounds=(-180.0, 180.0),
    axes=(),
    parameters=(
        Parameter("e_x_deg", "deg", 1.0, "about x; only the direction of the three counts"),
        Parameter("e_y_deg", "deg", 0.0, "about y"),
        Parameter("e_z_deg", "deg", 0.0, "about z"),
        Parameter("begin_s", "s", None, "first time at which it is off, since the epoch", -1e12, 1e12),
        Parameter("end_s", "s", FOREVER_S, "time at which it returns", -1e12, 1e12),
    ),
    meaning="The reference attitude is off by a constant rotation about all axes from one time on and returns later or not, as "
    "when markers are mistaken for one another.",
)
