"""The linear model of every diagnosis, of a recording, of sensor tables or of other data.

Observations y are whitened, so that their noise is N(0, I) under the baseline M0, and the nuisance parameters that M0 itself
estimates (start attitudes, G and b, a sensor's epoch attitude …) are projected out. An unmodelled effect adds a group of
columns X of the same kind, times amplitudes a:

    y = Σ X_e a_e + noise,    a_e ~ N(0, s² I) with the scale s unknown within the effect's plausible range.

A *candidate* is one effect about one axis, or one *unlisted rival*, an error outside the library. It can have several
*options*, such as the times at which a step may have happened. A random process is a candidate like any other: its columns are
the factor of its covariance. A nonlinear effect is linearised about its own point; the constant term is a *shift*, one more
column, whose amplitude is one if the candidate acts. A candidate with only a shift acts or does not.

Builders make a `LinearModel` from a recording (`diagnosis.model.candidates`), from raw sensor tables
(`diagnosis.model.sensors.tables`) or from other data. `diagnosis.inference` knows none of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array, Indices, Mask

Parameters = dict[str, float | str]

# Scales of interest, as signal-to-noise ratios of the amplitude's standard deviation: smaller ones cannot be seen, and larger
# ones do not remain for a linear model to explain.
VISIBLE = (1.0, 300.0)
ROUNDING = 1e-9  # relative, by which a scale may lie beyond the end of its range
PER_DECADE = 4  # scales in a decade; the evidence of a few amplitudes changes little between neighbours
FINER = 3  # scales between neighbours, for a process that may have hundreds of amplitudes

COLUMN_CAPACITY = 30_000  # of a model, usually; what is not used takes no memory
RESTORED_ROWS_PER_BATCH = 64  # rows of columns that are restored together
UNBOUNDED_SCALES = (0.0, np.inf)  # window of an option that may have any scale


@dataclass(frozen=True)
class ParameterChoice:
    """One way in which an effect can be present."""

    start: int  # start, count: its columns among those of the model
    count: int
    log_weight: float  # log of its prior share among the options of its candidate
    parameters: Parameters  # what is fixed in it, such as the time of a step
    window: tuple[float, float] = UNBOUNDED_SCALES  # range of the scales that it may have, among those of its candidate

    @property
    def columns(self) -> slice:
        """Its columns in the model."""
        return slice(self.start, self.start + self.count)


def read_first_amplitude(amplitudes: Array) -> tuple[float, Parameters]:
    """Return the size of an effect with one amplitude, without further parameters."""
    return float(amplitudes[0]), {}


def add_no_sigma(size: float) -> float:
    """Return zero: no further sigma."""
    return 0.0


@dataclass(frozen=True)
class Candidate:
    """An effect about one axis, or an unlisted rival."""

    effect: str  # name of the effect; of a rival, what it does in words
    axis: str | None  # body axis or sensor, None if it has none
    listed: bool  # whether it may be named as a cause
    log_prior: float  # log of its prior share among all candidates
    options: tuple[ParameterChoice, ...]  # the ways in which it can be present
    scales: Array  # standard deviations of the amplitudes that the evidence is averaged over, in `unit`
    unit: str  # of its size
    process: bool = False  # whether it is a random process, whose size is the scale itself
    positive: bool = False  # whether its amplitude can only be positive
    log_odds: float = 0.0  # evidence from data outside the linear model, such as tests of the samples
    # from amplitudes (k,) to the size and further parameters
    read: Callable[[Array], tuple[float, Parameters]] = read_first_amplitude
    # from the size to the sigma that reading it off the amplitudes adds to theirs
    size_sigma: Callable[[float], float] = add_no_sigma
    shifted: bool = False  # whether the last column of each option is a shift; `read` gets the other amplitudes
    # whether its options are those periods of a sine, of all that were tried, which a scan has found to explain most: their
    # prior shares add up to less than one, and phases of different options do not compare
    scanned: bool = False

    @property
    def label(self) -> str:
        """The name with its axis, "effect:axis"."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"

    @cached_property
    def outside_window(self) -> Mask:
        """(o, s) which of the scales an option cannot have."""
        low, high = np.array([option.window for option in self.options]).T
        return np.asarray((self.scales < low[:, None] * (1 - ROUNDING)) | (self.scales > high[:, None] * (1 + ROUNDING)))

    @cached_property
    def log_weights(self) -> Array:
        """(o,) log prior share of each option; one with fewer scales has more of it at each, as the average is over all."""
        weights = np.array([option.log_weight for option in self.options])
        return weights - np.log1p(-np.mean(self.outside_window, axis=1))


@dataclass(frozen=True)
class CandidateColumns:
    """A candidate before its place in the model is known."""

    # effect, axis, listed, unit, process, positive, log_odds, read, size_sigma, shifted, scanned: as in
    # `Candidate`
    effect: str
    axis: str | None
    listed: bool
    columns: Sequence[Array]  # per option (N, k) whitened columns
    parameters: Sequence[Parameters]  # per option
    weights: Array  # (o,) prior share of each option
    limits: tuple[float, float]  # plausible range of the size
    unit: str
    process: bool = False
    positive: bool = False
    weight: float = 1.0  # prior of its effect beside that of the others
    log_odds: float = 0.0
    read: Callable[[Array], tuple[float, Parameters]] = read_first_amplitude
    size_sigma: Callable[[float], float] = add_no_sigma
    shifted: bool = False
    scales: Array | None = None  # as in `Candidate`; by default those within the limits that the columns can show
    scanned: bool = False


def build_rival(
    name: str,
    axis: str | None,
    columns: Sequence[Array],
    process: bool = False,
    weights: Array | None = None,
    parameters: Sequence[Parameters] | None = None,
) -> CandidateColumns:
    """Build an error outside the library, with options of equal prior unless their weights are given."""
    count = len(columns)
    shares = np.full(count, 1 / count) if weights is None else weights
    return CandidateColumns(name, axis, False, columns, parameters or [{}] * count, shares, (0.0, np.inf), "", process)


@dataclass(frozen=True)
class SelectedCandidate:
    """A candidate in an explanation, with its option and its scale."""

    candidate: int
    option: int
    scale: int


# members, and the log of the likelihood ratio that a further candidate must exceed beside them
Wanted = tuple[tuple[SelectedCandidate, ...], float]


@dataclass(frozen=True)
class Fold:
    """One part of the data held out, and the rest to learn from."""

    # train_y, train_X: (t,), (t, p) training observations and columns, in units of their own scatter under M0; only their inner
    # products matter, so that a builder may turn them
    train_y: Array
    train_X: Array
    # left_y, left_X: (s,), (s, p) errors of M0's prediction of the part held out, of observations and of columns, in units of
    # the scatter of that prediction
    left_y: Array
    left_X: Array
    owner: NDArray[np.str_]  # (s,) name of the interval each row belongs to
    # degrees of freedom of each interval in the part held out, by name; the rows' number unless the builder compressed them
    dof: dict[str, float]


@dataclass(frozen=True)
class RestoredColumns:
    """Whitened columns before the projection, by the projected ones and what that took: hundreds of megabytes less."""

    X: Array  # (N, p) projected columns
    basis: Array  # (N, q) orthonormal basis of the nuisance parameters' columns
    hidden: Array  # (q, p) components of the columns along it

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of all columns."""
        return self.X.shape[0], self.X.shape[1]

    def __getitem__(self, place: Any) -> Array:
        """Restore selected columns, by [rows] or [rows, columns]."""
        rows, columns = place if isinstance(place, tuple) else (place, slice(None))
        X, basis, hidden = self.X[rows], self.basis[rows], self.hidden[:, columns]
        selected = np.empty((len(X), *hidden.shape[1:]), order="F")
        for first in range(0, len(selected), RESTORED_ROWS_PER_BATCH):  # all at once would be as large again
            batch = slice(first, first + RESTORED_ROWS_PER_BATCH)
            selected[batch] = X[batch, columns] + basis[batch] @ hidden
        return selected


@dataclass
class Room:
    """Memory with room for further columns beside those of a model, which a few more need not be copied for."""

    memory: Array  # (N, c)
    used: int = 0  # columns that are taken; nothing changes them any more

    def append(self, columns: Array) -> None:
        """Append columns (N, k), in a larger memory if there is no room for them."""
        stop = self.used + columns.shape[1]
        if stop > self.memory.shape[1]:
            larger = np.empty((len(self.memory), 2 * stop), order="F")
            larger[:, : self.used] = self.memory[:, : self.used]
            self.memory = larger
        self.memory[:, self.used : stop] = columns
        self.used = stop

    def append_columns(self, columns: Array, further: Array) -> Array:
        """Append columns to others side by side: without a copy if these are the last in this memory and there is room."""
        stop = self.used + further.shape[1]
        if columns.base is not self.memory or columns.shape[1] != self.used or stop > self.memory.shape[1]:
            return np.hstack([columns, further])
        self.append(further)
        return self.memory[:, :stop]


class ColumnStore:
    """Projected columns side by side in one memory, and what the projection took of them."""

    def __init__(self, basis: Array):
        self.basis = basis  # (N, q) orthonormal basis of the nuisance parameters' columns
        self.room, self._hidden = (Room(np.empty((rows, COLUMN_CAPACITY), order="F")) for rows in basis.shape)

    def add(self, W: Array) -> Array:
        """Add whitened columns (N, k); returns them projected."""
        hidden, used = self.basis.T @ W, self.room.used
        self._hidden.append(hidden)
        self.room.append(W - self.basis @ hidden)
        return self.room.memory[:, used : self.room.used]

    def restore(self) -> RestoredColumns:
        """Return all columns, projected and restorable to before the projection."""
        used = self.room.used
        return RestoredColumns(self.room.memory[:, :used], self.basis, self._hidden.memory[:, :used])


@dataclass(frozen=True)
class LinearModel:
    """Observations, and the columns of all candidates."""

    y: Array  # (N,) whitened observations with the nuisance parameters projected out
    X: Array  # (N, p) columns, the same way
    W: Array | RestoredColumns  # (N, p) whitened columns before the projection
    candidates: tuple[Candidate, ...]  # which columns belong to whom
    dof: int  # degrees of freedom of y under M0
    projected: Callable[[Array], Array] = field(repr=False)  # takes the nuisance parameters out of (N, d) values
    most_effects: int = 3  # largest number of effects in one explanation
    split: str = ""  # how `folds` parts the data, in words; "" where nothing can be held out
    # parts of the data held out in turn, of the model's W
    folds: Callable[[Array], Iterable[Fold]] = field(default=lambda W: (), repr=False)
    room: Room | None = field(default=None, repr=False)  # memory behind X for the columns of further options
    # a model with more options around a member's own, for a parameter such as the time of a step that lies between the options;
    # the model itself where there is nothing to refine
    refine: Callable[[LinearModel, SelectedCandidate], LinearModel] = field(default=lambda model, member: model, repr=False)
    # a model with more options of effects that are switched on, at the moments when they explain most beside each of some sets
    # of members
    moments: Callable[[LinearModel, Sequence[Wanted]], LinearModel] = field(default=lambda model, wanted: model, repr=False)

    def find(self, label: str) -> int | None:
        """Find the index of a candidate by its label."""
        return next((k for k, candidate in enumerate(self.candidates) if candidate.label == label), None)

    def candidate(self, member: SelectedCandidate) -> Candidate:
        """Return the candidate of a member."""
        return self.candidates[member.candidate]

    def option(self, member: SelectedCandidate) -> ParameterChoice:
        """Return the option of a member."""
        return self.candidates[member.candidate].options[member.option]

    def scale(self, member: SelectedCandidate) -> float:
        """Return the scale of a member."""
        return float(self.candidates[member.candidate].scales[member.scale])

    def build_design(self, members: Sequence[SelectedCandidate]) -> tuple[Indices, Array, Indices]:
        """Return an explanation's column indices: those with free amplitudes, with their prior scales, and those of shifts."""
        places, scales, shifts = [np.empty(0, dtype=np.intp)], [np.empty(0)], []
        for member in members:
            member_columns = np.arange(self.option(member).start, self.option(member).start + self.option(member).count)
            if self.candidate(member).shifted:
                shifts.append(member_columns[-1])
                member_columns = member_columns[:-1]
            places.append(member_columns)
            scales.append(np.full(member_columns.size, self.scale(member)))
        return np.concatenate(places), np.concatenate(scales), np.array(shifts, dtype=np.intp)

    def replace_options(
        self, place: int, options: Sequence[ParameterChoice], W: Array, X: Array, scales: Array | None = None
    ) -> LinearModel:
        """Replace the options of one candidate, append its new columns to the model, and set its scales."""
        candidates, new_scales = list(self.candidates), self.candidates[place].scales if scales is None else scales
        candidates[place] = replace(candidates[place], options=tuple(options), scales=new_scales)
        together = np.hstack([self.X, X]) if self.room is None else self.room.append_columns(self.X, X)
        if isinstance(self.W, RestoredColumns):
            hidden = self.W.basis.T @ W
            # Only if X has lost this basis alone are its columns those that W is restored from.
            restored_X = together if self.W.X is self.X else np.hstack([self.W.X, W - self.W.basis @ hidden])
            restored = replace(self.W, X=restored_X, hidden=np.hstack([self.W.hidden, hidden]))
            return replace(self, W=restored, X=together, candidates=tuple(candidates))
        return replace(self, W=np.hstack([self.W, W]), X=together, candidates=tuple(candidates))


def find_scale_range(
    largest: float, limits: tuple[float, float], visible: tuple[float, float] = VISIBLE
) -> tuple[float, float]:
    """Find the range of scales that the data can show and that are plausible; no range where there are none.

    `largest` is the largest ‖X‖ per unit amplitude.
    """
    return (max(limits[0], visible[0] / largest), min(limits[1], visible[1] / largest)) if largest > 0 else (np.inf, 0.0)


def refine_scales(scales: Array, best: int) -> Array:
    """Add `FINER` scales from one of the scales to each of its neighbours."""
    neighbours = [scales[k] for k in (best - 1, best + 1) if 0 <= k < scales.size]
    finer = [np.geomspace(scales[best], neighbour, FINER + 2)[1:-1] for neighbour in neighbours]
    return np.unique(np.concatenate([scales, *finer]))


def build_scales(low: float, high: float) -> Array:
    """Build scales from `low` to `high`, evenly spaced in log; empty if there are none between."""
    if low >= high:
        return np.empty(0)
    return np.geomspace(low, high, max(3, round(PER_DECADE * np.log10(high / low)) + 1))
