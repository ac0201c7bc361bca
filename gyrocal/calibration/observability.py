"""Parameter combinations that the data determine, from the SVD of the whitened sensitivity.

Rows of H are whitened by the residuals' covariance, columns scaled by a plausible range of each parameter, that of the gyro's
grade (see `gyrocal.calibration.plausible_ranges`): of a space gyro 0.01 for elements of G (10 000 ppm, 0.6 deg) and 10 deg/h
for biases. A singular value is then the plausible range over the sigma the data alone would give that combination. Below one
the data say nothing new, and the combination counts as not found. Counting only exact zeros would not do: noise in the rates
makes every Θ of full rank, also where the motion never changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from gyrocal.arrays import Array, Indices

PLAUSIBLE_G = 0.01
PLAUSIBLE_BIAS = float(np.deg2rad(10 / 3600))
PLAUSIBLE_RANGE = np.array([PLAUSIBLE_G] * 9 + [PLAUSIBLE_BIAS] * 3)
BIAS_LETTERS = ("b", "c")  # that the names of biases begin with, in both parametrisations
MOST_SHOWN = 3  # parameter combinations that a message names
OBSERVABILITY_RANK_TOLERANCE = 1e-11  # singular values this far below the largest are rounding, however small the stated noise


@dataclass(frozen=True)
class Observability:
    """Singular values of the scaled, whitened sensitivity and what they leave free.

    Attributes
    ----------
    singular_values : (p,) plausible range over sigma, descending; zeros where there are fewer residuals than parameters
    unobservable : names of the combinations not found, empty if none
    directions : (k, p) their directions of unit length in parameters divided by plausible ranges
    leads : (k,) change of the first-named parameter along each direction, in its own unit
    """

    singular_values: Array
    unobservable: tuple[str, ...]
    directions: Array
    leads: Array

    @property
    def condition(self) -> float:
        """Largest over smallest singular value; infinite where a combination has none."""
        smallest = self.singular_values[-1]
        return float(self.singular_values[0] / smallest) if smallest > 0 else float("inf")


def evaluate_observability(whitened: Array, plausible: Array, names: tuple[str, ...]) -> Observability:
    """Evaluate a whitened sensitivity V^(-1/2) Θ (rows, p), per unit of G and rad/s of b, by plausible ranges (p,)."""
    p = len(names)
    rows = np.zeros((max(0, p - len(whitened)), p))
    _, values, directions = np.linalg.svd(np.vstack([whitened * plausible, rows]), full_matrices=False)
    free = (values < 1.0) | (values < OBSERVABILITY_RANK_TOLERANCE * values[0])
    basis = make_sparse_basis(directions[free])
    basis = basis / np.linalg.norm(basis, axis=1, keepdims=True)
    leads = [(direction * plausible)[_find_leading_parameter(direction, plausible, names)] for direction in basis]
    texts = tuple(_name_combination(direction, plausible, names) for direction in basis)
    return Observability(values, texts, basis, np.array(leads))


def list_combinations(texts: Sequence[str]) -> str:
    """List the first combinations in a message, and count the others."""
    omitted = f"; and {len(texts) - MOST_SHOWN} more" if len(texts) > MOST_SHOWN else ""
    return "; ".join(texts[:MOST_SHOWN]) + omitted


def make_sparse_basis(directions: Array) -> Array:
    """Express free directions (k, p) in a basis as sparse as pivoting makes it."""
    if len(directions) == 0:
        return directions
    _, _, pivots = scipy.linalg.qr(directions, pivoting=True, mode="economic")
    basis = np.linalg.solve(directions[:, pivots[: len(directions)]], directions)
    return np.asarray(basis[np.argsort(pivots[: len(directions)])])


def _find_notable_parameters(direction: Array) -> Indices:
    """Find the places of the parameters that take a notable part in a direction."""
    return np.flatnonzero(np.abs(direction) > 0.01 * np.abs(direction).max())


def _find_leading_parameter(direction: Array, scale: Array, names: tuple[str, ...]) -> int:
    """Find the parameter a combination is named after: no bias if another takes part, then the largest change."""
    notable = _find_notable_parameters(direction)
    elements = [k for k in notable if not names[k].startswith(BIAS_LETTERS)]
    return int(max(elements or notable, key=lambda k: abs(direction[k] * scale[k])))


def _name_combination(direction: Array, scale: Array, names: tuple[str, ...]) -> str:
    """Name a direction, such as "G_yy - 0.0656 deg/s b_y": a change of the parameters that the data do not show."""
    notable = _find_notable_parameters(direction)
    physical = direction * scale
    biases = [k for k in notable if names[k].startswith(BIAS_LETTERS)]
    elements = [k for k in notable if k not in biases]
    lead = _find_leading_parameter(direction, scale, names)
    physical = physical / physical[lead]
    terms = [(physical[k], f"{abs(physical[k]):.3g} {names[k]}") for k in elements]
    unit = np.rad2deg(1.0) if elements else 1.0
    label = " deg/s" if elements else ""
    terms += [(physical[k], f"{abs(physical[k]) * unit:.3g}{label} {names[k]}") for k in biases]
    text = "".join(f" {'-' if value < 0 else '+'} {term}" for value, term in terms)
    return text.removeprefix(" + ").strip()
