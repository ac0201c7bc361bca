"""What the measurements of a batch leave free, and its name.

As in `gyrocal.calibration.observability`: columns are scaled by a plausible range of each unknown, and a singular value below
one says that this range is known better than the data would tell. One Sun direction leaves the rotation about it; with every
sensor's alignment free, a rotation of all of them goes unnoticed.
"""

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from gyrocal.calibration.observability import OBSERVABILITY_RANK_TOLERANCE, PLAUSIBLE_BIAS
from gyrocal.calibration.parameters import BIAS_NAMES
from gyrocal.errors import InputError, UnobservableError
from gyrocal.estimation.least_squares import Rows

Array = NDArray[np.float64]

PLAUSIBLE_ATTITUDE = float(np.deg2rad(1.0))
PLAUSIBLE_SENSOR = float(np.deg2rad(0.5))  # a misalignment or a penetration bias
NAMED_SHARE = 0.01  # of its plausible range, below which an unknown is not named


def check_observable(rows: Rows, C: Array, names: tuple[str, ...]) -> None:
    """Refuse measurements that leave something free, or are fewer than the unknowns.

    Parameters
    ----------
    rows : measurements, and a prior's
    C : (3, 3) attitude at the first node
    names : the sensor parameters after the bias

    Raises
    ------
    UnobservableError, InputError
    """
    unknowns = 6 + len(names)
    if len(rows.z) < unknowns:
        raise InputError(f"{len(rows.z)} measured numbers are too few for {unknowns} unknowns; take a longer arc")
    free = find_free_directions(rows)
    if len(free):
        texts = tuple(format_free_direction(direction, C, names) for direction in free)
        raise UnobservableError(
            f"the measurements do not determine {'; nor '.join(texts)}; add another sensor, a longer arc or a prior", texts
        )


def list_plausible_ranges(p: int) -> Array:
    """(3 + p,) plausible ranges of attitude, bias and sensor parameters."""
    return np.array([PLAUSIBLE_ATTITUDE] * 3 + [PLAUSIBLE_BIAS] * 3 + [PLAUSIBLE_SENSOR] * (p - 3))


def find_free_directions(rows: Rows, part: float = 1.0) -> Array:
    """(f, 3 + p) changes of (γ, δ) the measurements do not see to within this part of the plausible range.

    They are as sparse as pivoting makes them; the largest element of each is its plausible range.
    """
    scale = list_plausible_ranges(rows.parameters.shape[1])
    _, values, directions = np.linalg.svd(np.linalg.qr(rows.plain * scale, mode="r"))
    free = directions[(values * part < 1) | (values < OBSERVABILITY_RANK_TOLERANCE * values[0])]
    if not len(free):
        return free
    _, _, pivots = scipy.linalg.qr(free, pivoting=True, mode="economic")
    basis = np.linalg.solve(free[:, pivots[: len(free)]], free)
    return np.asarray(basis / np.abs(basis).max(axis=1, keepdims=True) * scale)


def format_free_direction(direction: Array, C: Array, names: tuple[str, ...]) -> str:
    """A free direction in words: the rotation, by its inertial axis, and what of bias and sensors goes with it."""
    scale = list_plausible_ranges(len(direction) - 3)
    share = np.abs(direction / scale)
    terms = []
    size = float(np.linalg.norm(direction[:3]))
    if share[:3].max() > NAMED_SHARE:
        axis = C.T @ direction[:3] / size
        axis *= np.sign(axis[np.argmax(np.abs(axis))])
        terms.append("a rotation about the inertial direction ({:.3f}, {:.3f}, {:.3f})".format(*(axis + 0.0)))
    labels = (*BIAS_NAMES, *names)
    terms += [labels[k - 3] for k in range(3, len(direction)) if share[k] > NAMED_SHARE]
    return " together with ".join([terms[0], ", ".join(terms[1:])] if len(terms) > 1 else terms)
