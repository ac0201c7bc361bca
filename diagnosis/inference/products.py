"""Inner products of the columns of a linear model, also conditioned on columns that are in the model already.

With scaled columns C in the model, y ~ N(0, 1 + C Cᵀ), and further columns X enter the evidence by XᵀS⁻¹X and XᵀS⁻¹y with
S = 1 + C Cᵀ. The matrix inversion lemma makes that XᵀX − (CᵀX)ᵀ (1 + CᵀC)⁻¹ (CᵀX): no matrix of all observations is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from diagnosis.model.linear import LinearModel, SelectedCandidate
from gyrocal.arrays import Array, Indices

MOST_BATCH_COLUMNS = 24  # most columns of options that are computed together, those of one size at a time
MOST_KEPT = 16_000_000  # products of columns that are kept


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
    log_bayes : log evidence of the columns C
    """

    def __init__(self, rows: Callable[[Indices], Array], inner: Array, correlation: Array, shift: Array):
        factor = np.linalg.cholesky(np.eye(len(inner)) + inner)
        self._inverse = lapack.dtrtri(factor, lower=1)[0] if len(factor) else factor  # none of members with shifts alone
        self._rows = rows
        self._shift = shift
        self._y = self._inverse @ correlation
        self.log_bayes = float(0.5 * self._y @ self._y - np.log(np.diag(factor)).sum())

    def reduce_products(self, gram: Array, correlation: Array, places: Indices) -> tuple[Array, Array]:
        """Reduce XᵀX (o, k, k) and Xᵀy (o, k) of the columns `places` (o, k) to those given the members in the model."""
        reduced = (self._inverse @ self._rows(places.ravel())).reshape(len(self._inverse), *places.shape)  # (r, o, k)
        # Products of (o, k, r) and (o, r, l) are far quicker than one sum over all indices.
        turned = reduced.transpose(1, 0, 2)
        gram = gram - np.matmul(turned.transpose(0, 2, 1), turned)
        along = (self._y @ reduced.reshape(len(reduced), places.size)).reshape(places.shape)
        return gram, correlation - self._shift[places] - along


class Products:
    """Products of the columns of members with those of candidates.

    They are cached, since a search needs them often, up to `MOST_KEPT` numbers: those of two random processes are gigabytes.
    """

    def __init__(self, model: LinearModel):
        self._model = model
        self._cache: dict[tuple[int, int, bytes], Array] = {}
        self._kept = 0  # numbers in them

    def get_products(self, member: SelectedCandidate, places: Indices) -> Array:
        """Return the products (k, n) of a member's columns, without a shift, with other columns of the model."""
        key = (member.candidate, member.option, places.tobytes())  # the first columns of three options are as many as one has
        if key not in self._cache:
            option, X = self._model.option(member), self._model.X
            member_columns = slice(option.start, option.start + option.count - self._model.candidate(member).shifted)
            products = X[:, member_columns].T @ X[:, _convert_to_slice(places)]
            if self._kept + products.size > MOST_KEPT:
                self.forget()
            self._kept += products.size
            self._cache[key] = products
        return self._cache[key]

    def forget(self) -> None:
        """Free their memory."""
        self._cache.clear()
        self._kept = 0


@dataclass(frozen=True)
class Batch:
    """Options of a candidate that have as many columns each, or the first columns of these."""

    options: Indices  # (o,) their numbers
    gram: Array  # (o, k, k) XᵀX
    places: Indices  # (o, k) of the columns


class Grams:
    """XᵀX of the options of candidates, computed at first use; those of few columns side by side."""

    def __init__(self, model: LinearModel):
        self._model = model
        self._cache: dict[tuple[int, int | None], list[Batch]] = {}
        self._single: dict[tuple[int, int], Array] = {}

    def list_batches(self, candidate: int, most: int | None = None) -> list[Batch]:
        """List all options of a candidate in batches, with the `most` first columns of each only."""
        key = candidate, most
        if key not in self._cache:
            options = self._model.candidates[candidate].options
            counts = np.array([option.count if most is None else min(option.count, most) for option in options])
            groups = [np.flatnonzero(counts == count) for count in dict.fromkeys(counts.tolist())]
            self._cache[key] = [
                self._build_batch(candidate, options_together, int(counts[group[0]]))
                for group in groups
                for options_together in ([group] if counts[group[0]] <= MOST_BATCH_COLUMNS else group[:, None])
            ]
        return self._cache[key]

    def inherit(self, earlier: Grams, candidates: Set[int]) -> None:
        """Take over the products of some candidates."""
        self._cache |= {key: products for key, products in earlier._cache.items() if key[0] in candidates}
        self._single |= {key: products for key, products in earlier._single.items() if key[0] in candidates}

    def _build_batch(self, candidate: int, options: Indices, count: int) -> Batch:
        starts = np.array([self._model.candidates[candidate].options[k].start for k in options])
        places = starts[:, None] + np.arange(count)
        if count == 1:  # hundreds of times of a step
            X = self._model.X[:, _convert_to_slice(places.ravel())]
            return Batch(options, np.einsum("no,no->o", X, X)[:, None, None], places)
        if options.size == 1:  # without a copy: of a random process it is a megabyte
            return Batch(options, self.single(candidate, int(options[0]))[None, :count, :count], places)
        return Batch(options, np.array([self.single(candidate, int(k))[:count, :count] for k in options]), places)

    def single(self, candidate: int, option: int) -> Array:
        """Return XᵀX (k, k) of one option."""
        if (candidate, option) not in self._single:
            X = self._model.X[:, self._model.candidates[candidate].options[option].columns]
            self._single[candidate, option] = X.T @ X
        return self._single[candidate, option]


def _convert_to_slice(places: Indices) -> Indices | slice:
    """Convert indices without a gap to a slice, which needs no copy of the columns."""
    is_contiguous = places.size and places[-1] - places[0] + 1 == places.size and (np.diff(places) == 1).all()
    return slice(int(places[0]), int(places[-1]) + 1) if is_contiguous else places
