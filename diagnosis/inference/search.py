"""Sets of effects: the evidence of each set, and its posterior.

A set's evidence is averaged over the options and scales of its members. With the others held at their best, a member's part
of the average is exact; the product of these parts stands for the whole average (a coordinate-wise Laplace approximation in
the discrete parameters). `diagnosis.inference.joint_search` finds the sets that are scored here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from diagnosis.inference.evidence import average_evidence, log_bayes
from diagnosis.inference.products import Conditioning, Grams, Products
from diagnosis.model.linear import Candidate, LinearModel, SelectedCandidate
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.arrays import Array, Indices

SWEEPS = 2  # over the members of a set, each moved to its best with the others held
SCREEN_COLUMNS = 24  # strongest columns of a random process, with which it is screened


@dataclass(frozen=True)
class Score:
    """Evidence of one candidate, given the members that are in the set already."""

    average: float  # log evidence averaged over options and scales
    best: float  # log evidence of the best option and scale
    option: int  # option, scale: which these are
    scale: int
    before: float = 0.0  # log evidence of the members that are in already


@dataclass(frozen=True)
class Explanation:
    """A set of effects."""

    members: tuple[SelectedCandidate, ...]  # its members with their best options and scales
    log_evidence: float  # averaged over options and scales, relative to the baseline
    log_posterior: float  # with the prior, not normalised

    @property
    def key(self) -> frozenset[int]:
        """Numbers of its candidates."""
        return frozenset(member.candidate for member in self.members)


BASELINE_EXPLANATION = Explanation((), 0.0, 0.0)  # the baseline, as likely beforehand as any gap


class Search:
    """Evidence of sets of candidates of a linear model."""

    def __init__(
        self,
        model: LinearModel,
        settings: DiagnosisSettings = DEFAULT,
        report_count: Callable[[int], None] = lambda count: None,
    ):
        self.model = model
        self.settings = settings
        self.report_count = report_count  # called with the number of scores so far, before each
        self._scored = 0
        self.gram = Grams(model)
        self.correlation = model.X.T @ model.y
        self._products = Products(model)
        self._scores: dict[tuple[int, frozenset[SelectedCandidate], int | None], Score] = {}
        self._latest: tuple[tuple[SelectedCandidate, ...], Conditioning | None] = ((), None)  # latest conditioning

    def inherit(self, earlier: Search) -> None:
        """Take over the products and scores of candidates that are the same in the model of another search."""
        pairs = enumerate(zip(self.model.candidates, earlier.model.candidates, strict=True))
        same = {number for number, (current, before) in pairs if current is before}
        self.gram.inherit(earlier.gram, same)
        for key, score in earlier._scores.items():
            if same.issuperset({key[0], *(member.candidate for member in key[1])}):
                self._scores[key] = score

    # ---- one candidate ---------------------------------------------------------------------------------------------------

    def tables(self, candidate: int, conditioning: Conditioning | None, most: int | None = None) -> Array:
        """Compute the log evidence (o, s) of a candidate's options and scales given some members, with `most` columns each."""
        entry = self.model.candidates[candidate]
        table = np.empty((len(entry.options), entry.scales.size))
        for batch in self.gram.list_batches(candidate, most):
            table[batch.options] = self._compute_table(batch.gram, batch.places, entry, conditioning)
        table[entry.outside_window] = -np.inf
        return table

    def _compute_table(self, gram: Array, places: Indices, entry: Candidate, conditioning: Conditioning | None) -> Array:
        correlation = self.correlation[places]
        if conditioning is not None:
            gram, correlation = conditioning.reduce_products(gram, correlation, places)
        return log_bayes(gram, correlation, entry.scales, entry.positive, entry.shifted)

    def score(self, candidate: int, members: tuple[SelectedCandidate, ...], most: int | None = None) -> Score:
        """Return average and best of a candidate's evidence given some members, with its `most` strongest columns only.

        Scores are cached: most optimisations and exchanges of members return to sets that were scored before.
        """
        self.report_count(self._scored)
        self._scored += 1
        return self._find_score(candidate, members, most)

    def _find_score(self, candidate: int, members: tuple[SelectedCandidate, ...], most: int | None = None) -> Score:
        if most is not None and all(option.count <= most for option in self.model.candidates[candidate].options):
            most = None  # one score, whether it screens or not
        key = (candidate, frozenset(members), most)
        if key not in self._scores:
            conditioning = self.condition_on(members)
            weights = self.model.candidates[candidate].log_weights
            table = self.tables(candidate, conditioning, most)
            # Of times that explain the data equally, that with more prior: a gap between intervals rather than one moment.
            option, scale = np.unravel_index(int(np.argmax(table + weights[:, None])), table.shape)
            before = 0.0 if conditioning is None else conditioning.log_bayes
            self._scores[key] = Score(
                average_evidence(table, weights), float(table[option, scale]), int(option), int(scale), before
            )
        return self._scores[key]

    def compute_observed_statistic(self, scanned: bool = False) -> float:
        """Compute the log of the evidence averaged over candidates with their priors.

        It is that of the listed candidates whose options a scan has chosen, or of all candidates that no scan has chosen.
        """
        entries = enumerate(self.model.candidates)
        included = [entry for entry in entries if entry[1].scanned == scanned and (entry[1].listed or not scanned)]
        parts = [self._find_score(number, ()).average + candidate.log_prior for number, candidate in included]
        return float(logsumexp(parts)) if parts else -np.inf

    def compute_null_statistic(self, correlation: Array) -> Array:
        """Compute the same statistic (d,) of candidates that no scan has chosen for d other observations with Xᵀy (p, d)."""
        parts = []
        for number, candidate in enumerate(self.model.candidates):
            if candidate.scanned:
                continue
            for batch in self.gram.list_batches(number):
                values, weights = correlation[batch.places], candidate.log_weights[batch.options]
                # (o, s, d)
                table = log_bayes(batch.gram, values, candidate.scales, candidate.positive, candidate.shifted)
                table += weights[:, None, None]
                table[candidate.outside_window[batch.options]] = -np.inf
                parts.append(
                    _sum_in_log(table.reshape(-1, table.shape[2])) - np.log(candidate.scales.size) + candidate.log_prior
                )
        return _sum_in_log(np.array(parts)) if parts else np.full(correlation.shape[1], -np.inf)

    # ---- sets ------------------------------------------------------------------------------------------------------------

    def forget(self) -> None:
        """Free the memory of cached products."""
        self._products.forget()
        self._latest = ((), None)

    def condition_on(self, members: tuple[SelectedCandidate, ...]) -> Conditioning | None:
        """Return the inner products given some members, to score other candidates against; None without members."""
        if not members:
            return None
        if members != self._latest[0]:
            self._latest = (members, self._build_conditioning(members))
        return self._latest[1]

    def _build_conditioning(self, members: tuple[SelectedCandidate, ...]) -> Conditioning:
        """Build the inner products given some members."""
        columns, scale, shifts = self.model.build_design(members)
        products = self._products  # not `self`, which keeps the result: a cycle of references would hold its memory

        def rows(places: Indices) -> Array:
            return scale[:, None] * np.vstack([products.get_products(member, places) for member in members])

        # Pair by pair, so that the cached products of two members serve every set with both.
        places = [self.model.build_design((member,))[0] for member in members]
        inner = np.block([[products.get_products(member, place) for place in places] for member in members])
        X = self.model.X
        shift = X.T @ X[:, shifts].sum(axis=1) if shifts.size else np.zeros(X.shape[1])
        conditioning = Conditioning(rows, scale[:, None] * inner * scale, scale * (self.correlation - shift)[columns], shift)
        conditioning.log_bayes += float(self.correlation[shifts].sum() - 0.5 * shift[shifts].sum())
        return conditioning

    def optimise_members(self, members: tuple[SelectedCandidate, ...]) -> Explanation:
        """Move the members of a set to their best option and scale, one after another, and return the set with its evidence."""
        occam = np.zeros(len(members))
        best = 0.0
        for sweep in range(SWEEPS if len(members) > 1 else 1):
            moved = False
            for place, member in enumerate(members):
                score = self.score(member.candidate, members[:place] + members[place + 1 :])
                new = SelectedCandidate(member.candidate, score.option, score.scale)
                moved |= new != member
                members = (*members[:place], new, *members[place + 1 :])
                occam[place] = score.average - score.best
                best = score.best + score.before
            if sweep and not moved:
                break
        return self._build_explanation(members, best + float(occam.sum()))

    def find_explanation(self, labels: tuple[str, ...]) -> Explanation | None:
        """Find the explanation with given labels, whatever its evidence; None if one of them cannot be seen at all."""
        places = [self.model.find(label) for label in labels]
        if not places or any(place is None for place in places):
            return None
        return self.optimise_members(tuple(SelectedCandidate(place, 0, 0) for place in places if place is not None))

    def _build_explanation(self, members: tuple[SelectedCandidate, ...], log_evidence: float) -> Explanation:
        entries = [self.model.candidate(member) for member in members]
        prior = sum(entry.log_prior + entry.log_odds for entry in entries)
        prior += (len(members) - 1) * float(np.log(self.settings.another))
        if len(members) < self.model.most_effects:
            prior += float(np.log1p(-self.settings.another))
        return Explanation(members, log_evidence, log_evidence + prior)

    def score_singles(self) -> list[Explanation]:
        """Score every candidate alone; explanations of one effect, the likeliest first."""
        singles = []
        for candidate in range(len(self.model.candidates)):
            score = self.score(candidate, ())
            singles.append(self._build_explanation((SelectedCandidate(candidate, score.option, score.scale),), score.average))
        return _rank_explanations(singles)

    def list_children(
        self, parent: Explanation, allowed: Callable[[int], bool] = lambda candidate: True, most: int | None = None
    ) -> list[Explanation]:
        """List the sets with one more allowed candidate, the best first; processes with their `most` strongest columns.

        Only columns of a process are sorted by strength; the last one of others may be a shift.
        """
        children = []
        for candidate, entry in enumerate(self.model.candidates):
            if candidate in parent.key or not allowed(candidate):
                continue
            score = self.score(candidate, parent.members, most if entry.process else None)
            member = SelectedCandidate(candidate, score.option, score.scale)
            children.append(self._build_explanation((*parent.members, member), parent.log_evidence + score.average))
        return _rank_explanations(children)


def _rank_explanations(explanations: list[Explanation]) -> list[Explanation]:
    return sorted(explanations, key=lambda explanation: -explanation.log_posterior)


def sum_log_posterior(explanations: list[Explanation]) -> float:
    """Compute the log of the summed posteriors of some explanations, not normalised."""
    return float(logsumexp([explanation.log_posterior for explanation in explanations]))


def _sum_in_log(logs: Array) -> Array:
    """Compute the log (d,) of the sum of exponentials of each column of (n, d) logs.

    It is scipy's ``logsumexp``, which looks at its arguments for several times as long as it computes, and this is called
    thousands of times for the draws of M0.
    """
    top = logs.max(axis=0)
    top[np.isneginf(top)] = 0.0
    with np.errstate(divide="ignore"):
        return np.asarray(top + np.log(np.exp(logs - top).sum(axis=0)))
