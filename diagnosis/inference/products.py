"""Inner products of the columns of a linear model, and what is left of them given the columns that are in already.

With scaled columns C in the model, y ~ N(0, 1 + C Cᵀ), and further columns X enter the evidence by XᵀS⁻¹X and XᵀS⁻¹y with
S = 1 + C Cᵀ. The matrix inversion lemma makes that XᵀX − (CᵀX)ᵀ (1 + CᵀC)⁻¹ (CᵀX): no matrix of all observations is needed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model.linear import LinearModel, Member

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SMALL = 4  # most columns of groups that are computed together, those of one size at a time
MOST_KEPT = 4_000_000  # products of columns that are kept


class Conditioning:
    """Inner products given some scaled columns C and shifts that are in already.

    Parameters
    ----------
    rows : from places (n,) of columns of the model to their products (r, n) with C
    inner : (r, r) CᵀC
    correlation : (r,) Cᵀy, the shifts taken out of y
    shift : (p,) products of the shifts with all columns

    Attributes
    ----------
    log_bayes : log evidence of what is in
    """

    def __init__(self, rows: Callable[[Indices], Array], inner: Array, correlation: Array, shift: Array):
        factor = np.linalg.cholesky(np.eye(len(inner)) + inner)
        self._inverse = scipy.linalg.solve_triangular(factor, np.eye(len(inner)), lower=True, check_finite=False)
        self._rows = rows
        self._shift = shift
        self._y = self._inverse @ correlation
        self.log_bayes = float(0.5 * self._y @ self._y - np.log(np.diag(factor)).sum())

    def reduced_products(self, gram: Array, correlation: Array, places: Indices) -> tuple[Array, Array]:
        """Products XᵀX (o, k, k) and Xᵀy (o, k) of the columns at `places` (o, k), given what is in."""
        reduced = (self._inverse @ self._rows(places.ravel())).reshape(len(self._inverse), *places.shape)  # (r, o, k)
        # Products of (o, k, r) and (o, r, l) are far quicker than one sum over all indices.
        turned = reduced.transpose(1, 0, 2)
        gram = gram - np.matmul(turned.transpose(0, 2, 1), turned)
        return gram, correlation - self._shift[places] - np.tensordot(self._y, reduced, axes=1)


class Products:
    """Products of the columns of members with those of candidates.

    They are kept, since a search asks for them often; but not all of them, which of two random processes are gigabytes.
    """

    def __init__(self, model: LinearModel):
        self._model = model
        self._found: dict[tuple[int, int, int, int], Array] = {}
        self._kept = 0  # numbers in them

    def of(self, member: Member, places: Indices) -> Array:
        """(k, n) products of a member's columns but a shift with the columns of a candidate or of one of its options."""
        key = (member.candidate, member.option, int(places[0]) if places.size else 0, places.size)
        if key not in self._found:
            X = self._model.X
            found = X[:, _as_slice(self._model.design((member,))[0])].T @ X[:, _as_slice(places)]
            if self._kept + found.size > MOST_KEPT:
                self.forget()
            self._kept += found.size
            self._found[key] = found
        return self._found[key]

    def forget(self) -> None:
        """Give back their memory."""
        self._found.clear()
        self._kept = 0


class Grams:
    """XᵀX of each option, made when it is asked for first."""

    def __init__(self, model: LinearModel):
        self._model = model
        self._places: list[Indices | None] = []
        self._together: dict[int, Array] = {}
        self._single: dict[tuple[int, int], Array] = {}
        for candidate in model.candidates:
            counts = {option.count for option in candidate.options}
            uniform = len(counts) == 1 and next(iter(counts)) <= SMALL
            self._places.append(
                np.array([np.arange(o.start, o.start + o.count) for o in candidate.options]) if uniform else None
            )

    def uniform(self, candidate: int) -> bool:
        """Whether all its options have the same small number of columns."""
        return self._places[candidate] is not None

    def of(self, candidate: int) -> tuple[Array, Indices]:
        """(o, k, k) and the places (o, k) of the columns."""
        places = self._places[candidate]
        assert places is not None
        if candidate not in self._together:
            X = self._model.X[:, places]  # (N, o, k)
            self._together[candidate] = np.einsum("nok,nol->okl", X, X)
        return self._together[candidate], places

    def single(self, candidate: int, option: int) -> Array:
        """(k, k) of one option."""
        if (candidate, option) not in self._single:
            X = self._model.X[:, self._model.candidates[candidate].options[option].columns]
            self._single[candidate, option] = X.T @ X
        return self._single[candidate, option]


def _as_slice(places: Indices) -> Indices | slice:
    """Places without a gap as a slice, which needs no copy of the columns."""
    whole = places.size and places[-1] - places[0] + 1 == places.size and (np.diff(places) == 1).all()
    return slice(int(places[0]), int(places[-1]) + 1) if whole else places
