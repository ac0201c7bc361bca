"""Reference that repeats its last attitude for a while: references from begin_s to begin_s + size show the one before begin_s.

A camera or a filter that hangs puts out its last result again. Such repeats agree to the last digit, which new measurements do
not, while the gyro shows that the body turned. They carry no attitude, and a diagnosis takes them out.
"""

from collections.abc import Sequence

import numpy as np

from simulator.effects.base import Array, Detection, Effect, Fault, Parameter, References, Setting, Surroundings
from simulator.effects.common import number
from simulator.effects.innovations import Innovations, compute_innovations

FEWEST_REPEATS = 2  # repeats in a row; one may be a tag that was read twice
FREEZE_TURN_SIGMAS = 8.0  # sigmas of an innovation that the body turns during them
CERTAIN = 30.0  # log odds: measurements do not agree to the last digit
FREEZE_P_VALUE = 1e-300


class ReferenceFreeze(Effect):
    """See the module."""

    def replace_references(
        self, rng: np.random.Generator, quaternions: Array, references: References, setting: Setting
    ) -> Array:
        """The last reference before begin_s again, within its interval."""
        begin = number(setting.parameters, "begin_s")
        frozen = (references.t_s >= begin) & (references.t_s < begin + setting.size)
        out = quaternions.copy()
        for interval in np.unique(references.interval[frozen]):
            own = references.interval == interval
            before = np.flatnonzero(own & (references.t_s < begin))
            if before.size:
                out[own & frozen] = quaternions[before[np.argmax(references.t_s[before])]]
        return out

    def find_faults(self, around: Surroundings) -> Sequence[Fault]:
        """Find runs of references that agree to the last digit while the gyro turns."""
        references = around.references
        seen = compute_innovations(around)
        lost, longest, begin = np.zeros(references.t_s.size, dtype=bool), 0.0, 0.0
        for low, high in _find_repeats(references, seen):
            rows = seen.second[low:high]
            turned = float(np.linalg.norm(np.cumsum(seen.turned[low:high], axis=0), axis=1).max())
            if high - low < FEWEST_REPEATS or turned < FREEZE_TURN_SIGMAS * float(seen.sigma[low:high].max()):
                continue
            lost[rows] = True
            lasts = float(seen.duration_s[low:high].sum())
            if lasts > longest:
                longest, begin = lasts, float(references.t_s[rows[0]])
        if not lost.any():
            return ()
        text = f"{int(lost.sum())} references repeat the one before exactly while the body turns, for {longest:.4g} s at most"
        sigma = float(np.median(seen.duration_s))
        found = Detection(self.name, None, longest, self.unit, sigma, {"begin_s": begin}, CERTAIN, FREEZE_P_VALUE, text)
        return (Fault(found, np.zeros(around.stream.t_s.size, dtype=bool), lost),)


def _find_repeats(references: References, seen: Innovations) -> list[tuple[int, int]]:
    """Runs of steps, first and last + 1, at which a reference repeats the one before."""
    q = references.quaternions
    same = (q[seen.first] == q[seen.second]).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    return [(int(low), int(high)) for low, high in edges.reshape(-1, 2)]


EFFECT = ReferenceFreeze(
    name="reference_freeze",
    summary="the reference repeats its last attitude for a while",
    says="the reference attitude stands still for {size} while the body moves",
    unit="s",
    stage="reference_telemetry",
    prior=(1e-2, 1e4),
    bounds=(0.0, 1e9),
    axes=(),
    parameters=(Parameter("begin_s", "s", None, "first time at which it repeats, since the epoch", -1e12, 1e12),),
    meaning="The reference repeats its last attitude for a while although the body moves; the size is how long at most.",
    sign="positive",
)
