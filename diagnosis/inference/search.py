"""Search over sets of effects: evidence of each set, and what probability that gives to each.

A set's evidence is averaged over the options and scales of its members. With the others held at their best, a member's part
of the average is exact; the product of these parts stands for the whole average (a coordinate-wise Laplace approximation in
the discrete parameters). The search keeps a beam of sets, since the best single is not always in the best pair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.inference.candidates import Bank
from diagnosis.inference.evidence import averaged, log_bayes

Array = NDArray[np.float64]

LARGEST_SET = 3
BEAM = (10, 6)
ANOTHER = 0.1  # prior that one more effect is at work, given that some are
SWEEPS = 2
EXCHANGED = 4  # times the best set is tried with others in the place of its members
EXCHANGED_FOR = 4  # others worth settling
THINNED = 4  # of the best sets, each of whose members may turn out to have been a way to another
ENOUGH = 24  # columns of a random process to see whether it is worth a closer look
LEAST_CHANCE = 0.02  # of the likeliest time, below which a time of a step is left out
SMALL = 4  # columns of a group that is handled together with others of its size


@dataclass(frozen=True)
class Member:
    """A candidate in a set, with the option and scale it is held at."""

    candidate: int
    option: int
    scale: int


@dataclass(frozen=True)
class Score:
    """Evidence of one candidate given what is in.

    Attributes
    ----------
    average : log evidence averaged over options and scales
    best : log evidence of the best option and scale
    option, scale : which these are
    """

    average: float
    best: float
    option: int
    scale: int


@dataclass(frozen=True)
class Explanation:
    """A set of effects.

    Attributes
    ----------
    members : its members, held at their best
    log_evidence : averaged over options and scales, relative to the baseline
    log_posterior : with the prior, not normalised
    """

    members: tuple[Member, ...]
    log_evidence: float
    log_posterior: float

    @property
    def key(self) -> frozenset[int]:
        """Its candidates."""
        return frozenset(member.candidate for member in self.members)


class Search:
    """Evidence of sets of candidates of a bank for one vector of observations."""

    def __init__(self, bank: Bank, y: Array):
        self.bank = bank
        self.y = y
        self.gram = _Grams(bank)
        self.correlation = bank.X.T @ y
        self._products: dict[tuple[int, int], Array] = {}

    # ---- one candidate ---------------------------------------------------------------------------------------------------

    def tables(self, candidate: int, given: _Given | None, most: int | None = None) -> Array:
        """(o, s) log evidence of a candidate's options and scales given what is in, with its `most` strongest columns only."""
        entry = self.bank.candidates[candidate]
        if self.gram.uniform(candidate):
            gram, places = self.gram.of(candidate)
            return self._table(gram, places, entry.scales, given)
        parts = [
            self._table(
                self.gram.single(candidate, k)[None, :most, :most],
                np.arange(o.start, o.start + o.count)[None, :most],
                entry.scales,
                given,
            )
            for k, o in enumerate(entry.options)
        ]
        return np.vstack(parts)

    def _table(self, gram: Array, places: NDArray[np.intp], scales: Array, given: _Given | None) -> Array:
        correlation = self.correlation[places]
        if given is not None:
            reduced = given.reduced(places)  # (r, o, k)
            # Products of (o, k, r) and (o, r, l): far quicker than one sum over all indices.
            turned = reduced.transpose(1, 0, 2)
            gram = gram - np.matmul(turned.transpose(0, 2, 1), turned)
            correlation = correlation - np.tensordot(given.y, reduced, axes=1)
        return log_bayes(gram, correlation, scales)

    def score(self, candidate: int, given: _Given | None, most: int | None = None) -> Score:
        """Average and best of a candidate's evidence."""
        entry = self.bank.candidates[candidate]
        weights = np.array([option.log_weight for option in entry.options])
        table = self.tables(candidate, given, most)
        # Of times that explain the data alike, the one with more prior: a gap between intervals rather than one moment.
        option, scale = np.unravel_index(int(np.argmax(table + weights[:, None])), table.shape)
        return Score(averaged(table, weights), float(table[option, scale]), int(option), int(scale))

    def null_statistic(self, correlation: Array) -> Array:
        """log of the evidence averaged over all candidates with their priors, for many observations at once.

        Parameters
        ----------
        correlation : (p, d) Xᵀy of d observations

        Returns
        -------
        (d,)
        """
        parts = []
        for number, candidate in enumerate(self.bank.candidates):
            if self.gram.uniform(number):
                gram, places = self.gram.of(number)
                groups = [(gram, correlation[places], np.array([option.log_weight for option in candidate.options]))]
            else:
                groups = [
                    (self.gram.single(number, k)[None], correlation[option.columns][None], np.array([option.log_weight]))
                    for k, option in enumerate(candidate.options)
                ]
            for gram, values, weights in groups:
                table = log_bayes(gram, values, candidate.scales)  # (o, s, d)
                parts.append(
                    logsumexp(table + weights[:, None, None], axis=(0, 1)) - np.log(candidate.scales.size) + candidate.log_prior
                )
        return np.asarray(logsumexp(np.array(parts), axis=0))

    # ---- sets ------------------------------------------------------------------------------------------------------------

    def _rows(self, member: Member) -> Array:
        """(k, p) products of a member's columns with all of the bank, kept since a search asks for them often."""
        key = (member.candidate, member.option)
        if key not in self._products:
            columns = self.bank.candidates[member.candidate].options[member.option].columns
            self._products[key] = self.bank.X[:, columns].T @ self.bank.X
        return self._products[key]

    def given(self, members: tuple[Member, ...]) -> _Given | None:
        """What is in, ready to score the rest against."""
        if not members:
            return None
        scales = [self.bank.candidates[m.candidate].scales[m.scale] for m in members]
        rows = np.vstack([scale * self._rows(m) for scale, m in zip(scales, members, strict=True)])
        options = [self.bank.candidates[m.candidate].options[m.option] for m in members]
        own = np.concatenate([np.arange(o.start, o.start + o.count) for o in options])
        scale = np.repeat(scales, [o.count for o in options])
        return _Given(rows, rows[:, own] * scale, scale * self.correlation[own])

    def settled(self, members: tuple[Member, ...]) -> Explanation:
        """A set with its members moved to their best, one after another, and its evidence."""
        occam = np.zeros(len(members))
        best = 0.0
        for sweep in range(SWEEPS if len(members) > 1 else 1):
            moved = False
            for place, member in enumerate(members):
                others = members[:place] + members[place + 1 :]
                given = self.given(others)
                score = self.score(member.candidate, given)
                new = Member(member.candidate, score.option, score.scale)
                moved |= new != member
                members = (*members[:place], new, *members[place + 1 :])
                occam[place] = score.average - score.best
                best = score.best + (given.log_bayes if given is not None else 0.0)
            if sweep and not moved:
                break
        return self._explanation(members, best + float(occam.sum()))

    def over_times(self, members: tuple[Member, ...]) -> list[tuple[float, tuple[Member, ...]]]:
        """A set at each of the times its steps may have happened at, with the probabilities of those; they sum to one."""
        sets = [(1.0, members)]
        for place, member in enumerate(members):
            entry = self.bank.candidates[member.candidate]
            if "time_s" not in entry.options[member.option].parameters:
                continue
            weights = np.array([option.log_weight for option in entry.options])
            table = self.tables(member.candidate, self.given(members[:place] + members[place + 1 :])) + weights[:, None]
            chance = np.exp(logsumexp(table, axis=1) - logsumexp(table))
            likely = np.flatnonzero(chance > LEAST_CHANCE * chance.max())
            at = [replace(member, option=int(k), scale=int(np.argmax(table[k]))) for k in likely]
            share = chance[likely] / chance[likely].sum()
            sets = [(w * s, (*m[:place], new, *m[place + 1 :])) for w, m in sets for s, new in zip(share, at, strict=True)]
        return sets

    def _explanation(self, members: tuple[Member, ...], log_evidence: float) -> Explanation:
        entries = [self.bank.candidates[member.candidate] for member in members]
        prior = sum(entry.log_prior + entry.log_odds for entry in entries)
        prior += (len(members) - 1) * float(np.log(ANOTHER))
        if len(members) < LARGEST_SET:
            prior += float(np.log1p(-ANOTHER))
        return Explanation(members, log_evidence, log_evidence + prior)

    def singles(self) -> list[Explanation]:
        """Every candidate alone."""
        found = []
        for candidate in range(len(self.bank.candidates)):
            score = self.score(candidate, None)
            found.append(self._explanation((Member(candidate, score.option, score.scale),), score.average))
        return sorted(found, key=lambda explanation: -explanation.log_posterior)

    def explanations(self, depth: int = LARGEST_SET) -> list[Explanation]:
        """Sets of up to `depth` effects worth a thought, the best first."""
        found = {explanation.key: explanation for explanation in self.singles()}
        level = sorted(found.values(), key=lambda explanation: -explanation.log_posterior)
        for width in BEAM[: depth - 1]:
            new: dict[frozenset[int], Explanation] = {}
            for parent in self._beam(level, width):
                for child in self._children(parent, 12):
                    if child.key not in new or child.log_posterior > new[child.key].log_posterior:
                        new[child.key] = child
            ranked = sorted(new.values(), key=lambda explanation: -explanation.log_posterior)
            level = [self.settled(explanation.members) for explanation in ranked[: 2 * width]]
            level.sort(key=lambda explanation: -explanation.log_posterior)
            top = max(explanation.log_posterior for explanation in found.values())
            found.update({explanation.key: explanation for explanation in level})
            if not level or level[0].log_posterior < top - 6:
                break
        if depth > 1:
            self._exchange(found)
        return sorted(found.values(), key=lambda explanation: -explanation.log_posterior)

    def _exchange(self, found: dict[frozenset[int], Explanation]) -> None:
        """Take each member of the best sets out, and put others in its place in the best; a beam may never get there."""
        tried: set[frozenset[int]] = set()
        for _ in range(EXCHANGED):
            ranked = sorted(found.values(), key=lambda explanation: -explanation.log_posterior)
            for other in ranked[1:THINNED]:
                self._thin(other, found)
            best = max(found.values(), key=lambda explanation: explanation.log_posterior)
            for member in best.members if len(best.members) > 1 else ():
                others = tuple(one for one in best.members if one != member)
                key = frozenset(one.candidate for one in others)
                if key in tried:
                    continue
                tried.add(key)
                parent = self.settled(others)
                found.setdefault(parent.key, parent)
                for child in self._children(parent, EXCHANGED_FOR):
                    if child.key not in found:
                        found[child.key] = self.settled(child.members)
            if best is max(found.values(), key=lambda explanation: explanation.log_posterior):
                break

    def _thin(self, explanation: Explanation, found: dict[frozenset[int], Explanation]) -> None:
        """Every set with one member fewer."""
        for member in explanation.members if len(explanation.members) > 1 else ():
            others = tuple(one for one in explanation.members if one != member)
            key = frozenset(one.candidate for one in others)
            if key not in found:
                found[key] = self.settled(others)

    def _beam(self, level: list[Explanation], width: int) -> list[Explanation]:
        """The best, and the best of each listed effect after that, so that no kind crowds out the others."""
        kept = level[: width // 2]
        effects = {self._names(explanation) for explanation in kept}
        for explanation in level[width // 2 :]:
            if len(kept) >= width:
                break
            if self._names(explanation) not in effects:
                kept.append(explanation)
                effects.add(self._names(explanation))
        return kept

    def _names(self, explanation: Explanation) -> frozenset[str]:
        return frozenset(self.bank.candidates[k].effect for k in explanation.key)

    def _children(self, parent: Explanation, most: int) -> list[Explanation]:
        """The set with one more candidate."""
        given = self.given(parent.members)
        assert given is not None
        given.solve_all()
        base = parent.log_evidence
        children = []
        for candidate in range(len(self.bank.candidates)):
            if candidate in parent.key:
                continue
            score = self.score(candidate, given, ENOUGH)
            member = Member(candidate, score.option, score.scale)
            children.append(self._explanation((*parent.members, member), base + score.average))
        children.sort(key=lambda explanation: -explanation.log_posterior)
        return children[:most]


class _Given:
    """Inner products with what is in.

    Parameters
    ----------
    rows : (r, p) products Cᵀ X of the scaled columns that are in with all of the bank
    inner : (r, r) CᵀC
    correlation : (r,) Cᵀy
    """

    def __init__(self, rows: Array, inner: Array, correlation: Array):
        factor = np.linalg.cholesky(np.eye(len(inner)) + inner)
        self._inverse = scipy.linalg.solve_triangular(factor, np.eye(len(inner)), lower=True, check_finite=False)
        self._rows = rows
        self._all: Array | None = None
        self.y = self._inverse @ correlation
        self.log_bayes = float(0.5 * self.y @ self.y - np.log(np.diag(factor)).sum())

    def solve_all(self) -> None:
        """Prepare for questions about the whole bank."""
        self._all = self._inverse @ self._rows

    def reduced(self, places: NDArray[np.intp]) -> Array:
        """(r, *places) what to take out of inner products: <p, q> − reduced(p)ᵀ reduced(q)."""
        if self._all is not None:
            return np.asarray(self._all[:, places])
        flat = self._inverse @ self._rows[:, places.ravel()]
        return np.asarray(flat.reshape(len(flat), *places.shape))


class _Grams:
    """XᵀX of each option."""

    def __init__(self, bank: Bank):
        self._uniform: list[bool] = []
        self._places: list[NDArray[np.intp] | None] = []
        self._grams: list[Array | list[Array]] = []
        for candidate in bank.candidates:
            counts = {option.count for option in candidate.options}
            uniform = len(counts) == 1 and next(iter(counts)) <= SMALL
            self._uniform.append(uniform)
            if uniform:
                places = np.array([np.arange(o.start, o.start + o.count) for o in candidate.options])
                X = bank.X[:, places]  # (N, o, k)
                self._places.append(places)
                self._grams.append(np.einsum("nok,nol->okl", X, X))
            else:
                self._places.append(None)
                self._grams.append([bank.X[:, o.columns].T @ bank.X[:, o.columns] for o in candidate.options])

    def uniform(self, candidate: int) -> bool:
        """Whether all its options have the same small number of columns."""
        return self._uniform[candidate]

    def of(self, candidate: int) -> tuple[Array, NDArray[np.intp]]:
        """(o, k, k) and the places (o, k) of the columns."""
        gram, places = self._grams[candidate], self._places[candidate]
        assert isinstance(gram, np.ndarray)
        assert places is not None
        return gram, places

    def single(self, candidate: int, option: int) -> Array:
        """(k, k) of one option."""
        return np.asarray(self._grams[candidate][option])


def total(explanations: list[Explanation]) -> float:
    """log of the summed posterior, not normalised."""
    return float(logsumexp([explanation.log_posterior for explanation in explanations]))
