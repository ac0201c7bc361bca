"""Amplitudes of the effects of an explanation, under the prior that their evidence used.

With the others held at their best, the posterior of a member's amplitudes is a mixture over its options and scales, weighted
by their evidence. Each part is normal, a | y ~ N(Λ⁻¹ Xᵀy, Λ⁻¹) with Λ = XᵀX + I/s², products given the other members. Mean and
covariance of the mixture are stated, so that the time of a step, where it is not known, widens the sigma of its size. The size
of a random process is its scale s; its posterior, over a fine grid and all options, has the mean and sigma that are stated.
Since the prior has no mass where a size is implausible, no size needs to be rejected afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.special import log_ndtr, logsumexp

from diagnosis.inference.evidence import log_bayes, remove_shift
from diagnosis.inference.products import Conditioning
from diagnosis.inference.search import Search
from diagnosis.model.linear import Candidate, LinearModel, ParameterChoice, Parameters, SelectedCandidate
from gyrocal.arrays import Array

FINE_SIZES = 200  # of a random process
REACH = 6.0  # of that grid to either side of the likeliest scale, as a factor
NEGLIGIBLE = 1e-6  # probability of an option below which it is left out
STEP = 1e-3  # of their sigmas, by which amplitudes are changed to see how the size does
CERTAIN = 0.99  # of it, from which on it is not stated

TIME_KEY = "time_s"
TIME_WIDTH = "time_sigma_s"  # of an option: what is not known of its own time
PERIOD_KEY = "period_s"
PERIOD_WIDTH = "period_sigma_s"  # the same of a period
PROBABILITY = "_probability"  # of a parameter that is no number, such as the element of G


@dataclass(frozen=True)
class FittedEffect:
    """Amplitudes of one effect."""

    label: str  # label, effect, axis, unit: which
    effect: str
    axis: str | None
    unit: str
    size: float  # size, sigma, parameters: in the effect's unit
    sigma: float
    parameters: Parameters
    columns: Array  # (N, k) whitened columns before projection, of unit amplitude
    amplitudes: Array  # (k,) posterior mean
    sigmas: Array  # (k,) of each amplitude
    prior_sigma: float  # scale of the amplitudes under the prior, in the effect's unit
    process: bool  # whether it is a random process
    shift: Array  # (N,) known error that it adds beside its columns, whitened

    @property
    def contribution(self) -> Array:
        """Errors (N,) that it adds to the whitened observations."""
        return np.asarray(self.columns @ self.amplitudes + self.shift)


def fit(model: LinearModel, members: Sequence[SelectedCandidate]) -> list[FittedEffect]:
    """Estimate the amplitudes of all members of an explanation, over finer options around their own."""
    return estimate_amplitudes(*refine_explanation(model, members))


def refine_explanation(
    model: LinearModel, members: Sequence[SelectedCandidate]
) -> tuple[LinearModel, tuple[SelectedCandidate, ...]]:
    """Refine the options around those of an explanation; returns the model and the explanation optimised among them."""
    for member in members:
        model = model.refine(model, member)
    return model, Search(model).optimise_members(tuple(members)).members


def estimate_amplitudes(model: LinearModel, members: tuple[SelectedCandidate, ...]) -> list[FittedEffect]:
    """Estimate the amplitudes of all members of an explanation whose options and scales are at their best."""
    search = Search(model)
    return [_estimate_member(search, members, place) for place in range(len(members))]


def _estimate_member(search: Search, members: tuple[SelectedCandidate, ...], place: int) -> FittedEffect:
    model, member = search.model, members[place]
    conditioning = search.condition_on(members[:place] + members[place + 1 :])
    entry = model.candidate(member)
    option = entry.options[member.option]
    table = search.tables(member.candidate, conditioning) + entry.log_weights[:, None]
    weights = np.exp(table - logsumexp(table))
    # Options with other columns, such as a richer form of the same effect, have amplitudes of another meaning.
    comparable = [k for k, choice in enumerate(entry.options) if entry.process or choice.count == option.count]
    comparable = [k for k in comparable if weights[k].sum() > NEGLIGIBLE or k == member.option]
    products = {k: _compute_member_products(search, member.candidate, k, conditioning) for k in comparable}
    if entry.process:
        size, sigma = _process_size(entry, products, entry.scales[member.scale])
        (values,), (spread,) = _compute_amplitude_moments(
            *products[member.option], entry.scales[[member.scale]], entry.positive
        )
        parameters: Parameters = dict(option.parameters)
    else:
        same_kind = [k for k in comparable if _select_text_parameters(entry.options[k]) == _select_text_parameters(option)]
        values, spread = _average_options(entry, products, weights, same_kind, member.option)
        size, further_parameters = entry.read(values)
        sigma = float(np.hypot(_read_sigma(entry, values, spread), entry.size_sigma(size)))
        if len(same_kind) < len(comparable):
            sigma = _compute_alternative_sigma(entry, products, weights, comparable, member.option, size, sigma)
        parameters = {**_summarise_parameters(entry, weights, member.option), **further_parameters}
    member_columns, _, shifts = model.build_design((member,))
    return FittedEffect(
        entry.label, entry.effect, entry.axis, entry.unit, size, sigma, parameters, model.W[:, member_columns], values,
        np.sqrt(np.maximum(np.diag(spread), 0.0)), model.scale(member), entry.process, model.W[:, shifts].sum(axis=1),
    )  # fmt: skip


def _select_text_parameters(option: ParameterChoice) -> Parameters:
    """Select the parameters of an option that are text, such as an element of G; amplitudes compare only if these agree."""
    return {name: value for name, value in option.parameters.items() if isinstance(value, str)}


def _average_options(
    entry: Candidate, products: Mapping[int, tuple[Array, Array]], weights: Array, chosen: Sequence[int], best: int
) -> tuple[Array, Array]:
    """Average the amplitudes over `chosen` options and all scales, in the phase of option `best`: (k,), (k, k)."""
    parts = [_compute_amplitude_moments(*products[k], entry.scales, entry.positive) for k in chosen]
    # Only pairs of amplitudes have a phase; the columns of an unlisted rival may be any basis of its waveforms.
    if entry.scanned and parts[0][0].shape[1] % 2 == 0:
        parts = _align_phases([weights[k] for k in chosen], parts, chosen.index(best))
    return _merge_moments(weights[chosen] / weights[chosen].sum(), *zip(*parts, strict=True))


def _compute_alternative_sigma(
    entry: Candidate,
    products: Mapping[int, tuple[Array, Array]],
    weights: Array,
    comparable: Sequence[int],
    best: int,
    size: float,
    sigma: float,
) -> float:
    """Compute the sigma of a size whose options may be of another kind, such as another element of G.

    Each kind has its own size, and the probability of its options. Where the rates about two axes are proportional, the data
    cannot distinguish their elements, and the size may be that of either.
    """
    variance, total = 0.0, 0.0
    kinds = [_select_text_parameters(entry.options[k]) for k in comparable]
    for kind in [other_kind for place, other_kind in enumerate(kinds) if other_kind not in kinds[:place]]:
        chosen = [k for k, other_kind in zip(comparable, kinds, strict=True) if other_kind == kind]
        share, square_error = float(weights[chosen].sum()), sigma**2
        if best not in chosen:
            values, spread = _average_options(entry, products, weights, chosen, chosen[0])
            square_error = (entry.read(values)[0] - size) ** 2 + _read_sigma(entry, values, spread) ** 2
        variance, total = variance + share * square_error, total + share
    return float(np.sqrt(variance / total))


def _compute_member_products(
    search: Search, candidate: int, number: int, conditioning: Conditioning | None
) -> tuple[Array, Array]:
    """Compute XᵀX (k, k) and Xᵀy (k,) of an option given the other members, a shift subtracted from y."""
    entry = search.model.candidates[candidate]
    option = entry.options[number]
    places = np.arange(option.start, option.start + option.count)[None]
    gram, correlation = search.gram.single(candidate, number)[None], search.correlation[places]
    if conditioning is not None:
        gram, correlation = conditioning.reduce_products(gram, correlation, places)
    if entry.shifted:
        gram, correlation, _ = remove_shift(gram, correlation)
    return gram[0], correlation[0]


def _compute_amplitude_moments(gram: Array, correlation: Array, scales: Array, positive: bool) -> tuple[Array, Array]:
    """Compute the mean (s, k) and covariance (s, k, k) of the amplitudes at each scale."""
    values, vectors = np.linalg.eigh(gram)
    variance = scales[:, None] ** 2 / (1 + scales[:, None] ** 2 * np.maximum(values, 0.0))  # (s, k)
    mean = (variance * (vectors.T @ correlation)) @ vectors.T
    covariance = (vectors * variance[:, None]) @ vectors.T
    if positive:  # the moments of a normal variable cut at zero
        sigma = np.sqrt(covariance[:, 0, 0])
        z = mean[:, 0] / sigma
        ratio = np.exp(-0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(z))
        mean = (mean[:, 0] + sigma * ratio)[:, None]
        covariance = (sigma**2 * np.maximum(1 - z * ratio - ratio**2, 1e-6))[:, None, None]
    return np.asarray(mean), np.asarray(covariance)


def _merge_moments(weights: Array, means: Sequence[Array], covariances: Sequence[Array]) -> tuple[Array, Array]:
    """Merge means and covariances over options and scales to those of their mixture, (k,) and (k, k)."""
    mean = sum((w @ m for w, m in zip(weights, means, strict=True)), np.zeros(means[0].shape[1]))
    spread = np.zeros((mean.size, mean.size))
    for w, m, C in zip(weights, means, covariances, strict=True):
        deviations = m - mean
        spread += np.einsum("s,sij->ij", w, C) + (deviations * w[:, None]).T @ deviations
    return mean, spread


def _align_phases(weights: Sequence[Array], parts: Sequence[tuple[Array, Array]], best: int) -> list[tuple[Array, Array]]:
    """Rotate the amplitudes of sines of different periods to the phase of option `best`.

    Far from the middle of the data the phase changes with the period while size and fit hardly do. Each pair of amplitudes is
    one sine, such as that of an interval.
    """
    means = [w @ mean / w.sum() for w, (mean, _) in zip(weights, parts, strict=True)]
    phases = [np.arctan2(mean[1::2], mean[::2]) for mean in means]
    aligned = []
    for phase, (mean, covariance) in zip(phases, parts, strict=True):
        cosines, sines = np.cos(phases[best] - phase), np.sin(phases[best] - phase)
        turn = scipy.linalg.block_diag(*np.array([[cosines, -sines], [sines, cosines]]).transpose(2, 0, 1))
        aligned.append((mean @ turn.T, turn @ covariance @ turn.T))
    return aligned


def _summarise_parameters(entry: Candidate, weights: Array, best: int) -> Parameters:
    """Return the parameters of the best option, with mean and sigma of the numbers that differ between the options."""
    parameters = {
        name: value for name, value in entry.options[best].parameters.items() if name not in (TIME_WIDTH, PERIOD_WIDTH)
    }
    probabilities = weights.sum(axis=1)
    names = _select_text_parameters(entry.options[best])
    has_names = [_select_text_parameters(option) == names for option in entry.options]
    names_probability = float(sum(probabilities[has_names]) / probabilities.sum())
    if names_probability < CERTAIN:
        parameters |= {f"{name}{PROBABILITY}": names_probability for name in names}
    if PERIOD_WIDTH in entry.options[best].parameters:
        # Errors about the period of the best option, since the phase belongs to that.
        periods = np.array(
            [[float(choice.parameters[name]) for name in (PERIOD_KEY, PERIOD_WIDTH)] for choice in entry.options]
        )
        square_errors = (periods[:, 0] - float(parameters[PERIOD_KEY])) ** 2 + periods[:, 1] ** 2
        parameters[PERIOD_WIDTH] = float(np.sqrt(probabilities @ square_errors / probabilities.sum()))
    if TIME_KEY in parameters:
        alike = [
            k
            for k, option in enumerate(entry.options)
            if all(option.parameters.get(name) == value for name, value in parameters.items() if name != TIME_KEY)
        ]
        times = np.array([float(entry.options[k].parameters[TIME_KEY]) for k in alike], dtype=float)
        widths = np.array([float(entry.options[k].parameters.get(TIME_WIDTH, 0.0)) for k in alike])
        w = probabilities[alike] / probabilities[alike].sum()
        mean = float(w @ times)
        parameters[TIME_KEY] = mean
        parameters[TIME_WIDTH] = float(np.sqrt(w @ ((times - mean) ** 2 + widths**2)))
    return parameters


def _read_sigma(entry: Candidate, amplitudes: Array, covariance: Array) -> float:
    """Compute the sigma of the size that is read from the amplitudes, to first order of their errors."""
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not np.any(amplitudes):
        return float(np.linalg.norm(sigmas) / np.sqrt(max(sigmas.size, 1)))
    steps = STEP * sigmas
    derivatives = np.zeros(sigmas.size)
    for k in np.flatnonzero(steps):
        changed = np.where(np.arange(sigmas.size) == k, steps, 0.0)
        above, below = (entry.read(amplitudes + sign * changed)[0] for sign in (1, -1))
        derivatives[k] = (above - below) / (2 * steps[k])
    return float(np.sqrt(max(float(derivatives @ covariance @ derivatives), 0.0)))


def _process_size(entry: Candidate, products: Mapping[int, tuple[Array, Array]], centre: float) -> tuple[float, float]:
    """Compute the mean and sigma of the scale of a random process, over its options and a fine grid in log of the scale."""
    sizes = np.geomspace(centre / REACH, centre * REACH, FINE_SIZES)
    log = np.array([
        log_bayes(gram[None], correlation[None], sizes)[0] + entry.options[k].log_weight
        for k, (gram, correlation) in products.items()
    ])  # fmt: skip
    weight = np.exp(log - logsumexp(log)).sum(axis=0)
    mean = float(weight @ sizes)
    return mean, float(np.sqrt(weight @ (sizes - mean) ** 2))
