"""Reference attitude that is off by a constant rotation for a while: e = (e_x, e_y, e_z) from begin_s to end_s, zero elsewhere.

A camera system that takes a marker for another one, a star tracker after a wrong identification, a filter that is set anew: all
three axes jump together, and jump back or not. The size is the norm of e, constant in body axes.

Which windows a diagnosis tries follows from the references themselves. Each is compared with the attitude that the gyro
propagates, before and after every time, over one reference and over twice as many up to an eighth of them: a jump that is
smaller than the noise of one reference shows in the means of many. A window begins and ends where such a difference is largest;
in a gap between two intervals it may begin as well. All other windows are left out with their share of the prior. One of up to
three references is a single false attitude, which belongs to the mask of a recording (`gyrocal.masking`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.innovations import Innovations, compute_innovations
from simulator.effects.base import Array, Parameter, Parameters, References, Surroundings, Trial
from simulator.effects.common import DEG, DirectedEffect, number

FEWEST_JUMP_REFERENCES = 4  # references of a window, more than a group of false ones has
JUMP_CHI2 = 36.0  # χ² of a difference of three axes, which noise exceeds once in 10⁷
MEDIAN_CHI2 = 2.366  # of three degrees of freedom
SMALLEST_ANGLE = 1e-15  # rad, of references without any noise
SHARE_OF_REFERENCES = 8  # of an interval, over which means are taken at most
MOST_EDGES = 10  # times at which a window may begin or end
MOST_BETWEEN = 3  # edges that a window may have inside
FOREVER_S = 1e12  # end of a jump that stays


@dataclass(frozen=True)
class _ReferenceJump(DirectedEffect):
    @property
    def directions(self) -> tuple[Parameter, ...]:
        return self.parameters[:3]

    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        t_s = references.t_s
        inside = (t_s >= number(parameters, "begin_s")) & (t_s < float(parameters.get("end_s", FOREVER_S)))
        return np.asarray(DEG * np.eye(3) * inside[:, None, None])

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """List the windows between the largest innovations; without a large one, one window that stands for all."""
        t_s, interval = around.references.t_s, around.references.interval
        innovations = compute_reference_innovations(around)
        edges = find_edges(innovations, around).tolist()
        middle = 0.5 * (t_s[innovations.first] + t_s[innovations.second])
        steps, interval_of_innovation = max(len(innovations.values), 2), interval[innovations.second]
        gaps = _list_gaps(t_s, interval)
        if not edges and not gaps:
            return (_choose_middle_window(around),)
        # Half of the prior is that of jumps that stay, half of those that return.
        windows = [_build_window(time, FOREVER_S, 0.5 / steps) for time in [*middle[edges].tolist(), *gaps]]
        for (p, i), (q, k) in combinations(enumerate(edges), 2):
            same_interval = interval_of_innovation[i] == interval_of_innovation[k]
            if q - p <= MOST_BETWEEN and same_interval and k - i >= FEWEST_JUMP_REFERENCES:
                # Even in the begin, and in the logarithm of the length.
                weight = 0.5 / (steps * (k - i) * np.log(steps))
                windows.append(_build_window(float(middle[i]), float(middle[k]), weight))
        return windows

    def missing(self, around: Surroundings) -> str | None:
        """Require a series of references."""
        references = around.references
        counts = np.bincount(references.interval[references.interval >= 0], minlength=1)
        return (
            None if counts.max() >= FEWEST_JUMP_REFERENCES else f"it needs {FEWEST_JUMP_REFERENCES} references in an interval"
        )


def compute_reference_innovations(around: Surroundings) -> Innovations:
    """Compute the innovations of the references of a recording."""
    references, stream = around.references, around.stream
    begin = stream.t_s - 0.5 * stream.duration_s
    return compute_innovations(
        begin, stream.rates, references.t_s, references.quaternions, references.interval, around.reference_sigma, around.arw
    )


def find_edges(innovations: Innovations, around: Surroundings) -> np.ndarray:
    """Find the innovations (k,) at which the references jump, the largest jumps, in order of time."""
    chi2 = np.sum((innovations.values / innovations.sigma) ** 2, axis=1)
    chi2[chi2 < JUMP_CHI2] = 0.0
    if around.residuals is not None:
        _add_jumps_of_means(chi2, innovations, around)
    large = np.flatnonzero(chi2)
    return np.sort(large[np.argsort(-chi2[large], kind="stable")][:MOST_EDGES])


def _add_jumps_of_means(chi2: Array, innovations: Innovations, around: Surroundings) -> None:
    """Enter jumps that show in means over several references only into χ² (k,) of the innovations, in place."""
    interval = around.references.interval
    interval_of_innovation = interval[innovations.second]
    for interval_number in np.unique(interval_of_innovation):
        rows, members = np.flatnonzero(interval_of_innovation == interval_number), np.flatnonzero(interval == interval_number)
        for length, statistic in _compare_means(around, members):
            # A jump makes a triangle of that width; one that shows in fewer references is known better.
            for k in np.flatnonzero(statistic > JUMP_CHI2).tolist():
                is_peak = statistic[k] == statistic[max(k - length, 0) : k + length].max()
                place = rows[np.searchsorted(innovations.second[rows], members[k + 1]).clip(max=rows.size - 1)]
                if is_peak and not chi2[max(place - length, 0) : place + length].any():
                    chi2[place] = statistic[k]


def _compare_means(around: Surroundings, members: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Compare the mean of several references before and after each but the first (m,) of an interval.

    Yields their number and χ² (m − 1,), for two references and twice as many up to a share of the interval. Where the
    propagated path is off by the mean μ of the residuals before a jump, in inertial axes, a jump of e in body axes leaves
    A_j η_j = e + A_j μ after it, whose mean is e + Ā μ.
    """
    assert around.residuals is not None
    eta, A = around.residuals[members], Rotation.from_quat(around.references.quaternions[members]).inv().as_matrix()
    sums = [
        np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        for values in (eta, np.einsum("kij,kj->ki", A, eta), A)
    ]
    length = 2
    while length * SHARE_OF_REFERENCES <= members.size:
        first = np.arange(length, members.size + 1 - length)
        mean = (sums[0][first] - sums[0][first - length]) / length
        body, turn = ((values[first + length] - values[first]) / length for values in sums[1:])
        e = body - np.einsum("kij,kj->ki", turn, mean)
        square = np.sum((e / np.maximum(np.median(np.abs(e), axis=0), SMALLEST_ANGLE)) ** 2, axis=1)
        statistic = np.zeros(members.size - 1)
        statistic[first - 1] = square * MEDIAN_CHI2 / max(float(np.median(square)), SMALLEST_ANGLE)
        yield length, statistic
        length *= 2


def _list_gaps(t_s: np.ndarray, interval: np.ndarray) -> list[float]:
    """List the middles of the gaps between intervals, s."""
    used = [number for number in np.unique(interval) if number >= 0]
    ends = [(t_s[interval == number].min(), t_s[interval == number].max()) for number in used]
    return [float(0.5 * (end + begin)) for (_, end), (begin, _) in pairwise(sorted(ends)) if begin > end]


def _build_window(begin_s: float, end_s: float, weight: float) -> Trial:
    return Trial({"begin_s": begin_s, "end_s": end_s}, float(weight))


def _choose_middle_window(around: Surroundings) -> Trial:
    """Choose the middle third of the interval with most references, at the prior of one window of many."""
    references = around.references
    number_ = int(np.argmax(np.bincount(references.interval[references.interval >= 0])))
    t_s = np.sort(references.t_s[references.interval == number_])
    third = t_s.size // 3
    return _build_window(float(t_s[third]), float(t_s[-max(third, 1)]), 1 / references.t_s.size)


EFFECT = _ReferenceJump(
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
