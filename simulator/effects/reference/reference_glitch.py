"""Single references, or up to three in a row, that are off by a large random rotation about all axes.

A camera that swaps or loses markers, a star tracker that matches wrong stars. Groups come at random, of one to three references
each, until they are this share of all; a group is off by size · U(0.5, 1.5) in a random direction. In the innovations
(`simulator.effects.innovations`) such a group leaves and returns: the reference after it fits the one before it. These
references carry no attitude, and a diagnosis takes them out.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from simulator.effects.base import Array, Detection, Effect, Fault, Parameter, References, Setting, Surroundings
from simulator.effects.common import DEG, number
from simulator.effects.innovations import Innovations, compute_innovations
from simulator.truth.rotation import apply_rotation_errors, separation

LONGEST_GLITCH_GROUP = 3  # references of a group
GROUP_START_SIGMAS = 12.0  # sigmas of an innovation at which a group begins, beyond noise of any tails that sensors have
RETURNED = 25.0  # χ² of three axes over the whole group, which noise exceeds once in 10⁵
LESS = 1e-3  # of the χ² at its begin, that is left over the whole group, by errors of the gyro's calibration
CALM, BESIDE = 5.0, 3  # sigmas of the innovations before and after a group, and how many of them
CERTAIN = 30.0  # log odds
GLITCH_P_VALUE = 1e-30  # of an innovation of 12 sigma


class ReferenceGlitch(Effect):
    """See the module."""

    def replace_references(
        self, rng: np.random.Generator, quaternions: Array, references: References, setting: Setting
    ) -> Array:
        """Groups that are off, never at an interval's ends."""
        count = references.t_s.size
        share = number(setting.parameters, "fraction")
        edge = np.zeros(count, dtype=bool)
        for interval in np.unique(references.interval):
            own = np.flatnonzero(references.interval == interval)
            edge[own[[0, -1]]] = True
        off = np.zeros((count, 3))
        begins = np.flatnonzero(rng.random(count) < 2 * share / (LONGEST_GLITCH_GROUP + 1))  # two references a group on average
        for begin in begins:
            direction = rng.standard_normal(3)
            e = setting.size * DEG * rng.uniform(0.5, 1.5) * direction / np.linalg.norm(direction)
            off[begin : begin + int(rng.integers(1, LONGEST_GLITCH_GROUP + 1))] = e
        off[edge] = 0.0
        out, rows = quaternions.copy(), off.any(axis=1)
        out[rows] = apply_rotation_errors(quaternions[rows], off[rows])
        return out

    def find_faults(self, around: Surroundings) -> Sequence[Fault]:
        """Find groups that leave by far more than noise and return."""
        references = around.references
        seen = compute_innovations(around)
        z = np.sqrt(np.sum((seen.values / seen.sigma) ** 2, axis=1))
        lost, sizes, last, others = np.zeros(references.t_s.size, dtype=bool), [], -1, 0
        for step in np.flatnonzero(z > GROUP_START_SIGMAS).tolist():
            if step <= last:
                continue
            length = _find_length(references, seen, step)
            if length and _is_calm(z, step, length):
                lost[seen.second[step : step + length]] = True
                sizes.append(float(np.rad2deg(np.linalg.norm(seen.values[step]))))
                last = step + length
            else:
                others += 1
        # Errors of the gyro leave and do not return, but two of them in a row may undo each other by chance.
        if len(sizes) <= others:
            return ()
        size, share = float(np.mean(sizes)), float(lost.mean())
        sigma = float(np.std(sizes)) / np.sqrt(len(sizes)) if len(sizes) > 1 else 0.3 * size
        text = f"{int(lost.sum())} references in {len(sizes)} groups are off by {size:.3g} deg and fit again after"
        found = Detection(self.name, None, size, self.unit, sigma, {"fraction": share}, CERTAIN, GLITCH_P_VALUE, text)
        return (Fault(found, np.zeros(around.stream.t_s.size, dtype=bool), lost),)


def _is_calm(z: Array, step: int, length: int) -> bool:
    """Whether the innovations before and after a group are noise; a gyro that errs makes others beside it."""
    beside = np.concatenate([z[max(step - BESIDE, 0) : step], z[step + length + 1 : step + length + 1 + BESIDE]])
    return bool(beside.size > 0 and beside.max() < CALM)


def _find_length(references: References, seen: Innovations, step: int) -> int:
    """Number of references of the group that begins with a step: after as many the next one fits again; 0 for none."""
    begin, first = seen.values[step] / seen.sigma[step], references.quaternions[seen.first[step]]
    turn = Rotation.from_rotvec(seen.turned[step])
    for length in range(1, LONGEST_GLITCH_GROUP + 1):
        nxt = step + length
        if nxt >= len(seen.values) or seen.first[nxt] != seen.second[nxt - 1]:
            return 0
        turn = turn * Rotation.from_rotvec(seen.turned[nxt])
        carried = apply_rotation_errors(first[None], -turn.as_rotvec()[None])
        left = separation(carried, references.quaternions[[seen.second[nxt]]])[0] / seen.sigma[nxt]
        if float(left @ left) < max(RETURNED, LESS * float(begin @ begin)):
            return length
    return 0


EFFECT = ReferenceGlitch(
    name="reference_glitch",
    summary="single references off by a large random rotation",
    says="single references are off by {size} on average",
    unit="deg",
    stage="reference_telemetry",
    prior=(1e-3, 180.0),
    bounds=(0.0, 180.0),
    axes=(),
    parameters=(Parameter("fraction", "", 0.01, "share of the references that are off", 0.0, 0.3),),
    meaning="Single references, or up to three in a row, are off by a large random rotation, as when markers are swapped.",
    sign="positive",
)
