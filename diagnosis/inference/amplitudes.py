"""Size and sigma of the effects of an explanation, and the calibration with them in.

Columns are fitted together by least squares with flat priors, on the complement of what M0 leaves free. A step's time is not
known: its posterior over a fine grid enters the size by its mean and variance. Amplitude and phase come from the two
amplitudes of a wave, a random effect's size from its evidence over a fine grid of sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.detectors.deadzone import DeadStretches, half_width
from diagnosis.inference.candidates import Bank
from diagnosis.inference.evidence import Conditioning, log_bayes
from diagnosis.inference.search import Member
from diagnosis.model.recording import Model
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from simulator.effects import EFFECTS

Array = NDArray[np.float64]

FINE_STEPS = 160  # times a step is tried at when its time is refined
FINE_SIZES = 200


@dataclass(frozen=True)
class Fitted:
    """One effect's numbers.

    Attributes
    ----------
    size, sigma, parameters : in the effect's units
    columns : (N, k) whitened columns, of unit amplitude; of a random effect scaled to its size
    amplitudes : (k,) estimated
    random : whether the amplitudes are random ones of unit variance
    """

    size: float
    sigma: float
    parameters: dict[str, float | str]
    columns: Array
    amplitudes: Array
    random: bool

    @property
    def contribution(self) -> Array:
        """(N,) what it adds to the whitened observations."""
        return np.asarray(self.columns @ self.amplitudes)


def fit(model: Model, bank: Bank, y: Array, members: Sequence[Member]) -> list[Fitted]:
    """Sizes of all members, fitted together."""
    columns = [_columns(model, bank, member) for member in members]
    parameters = [dict(bank.candidates[m.candidate].options[m.option].parameters) for m in members]
    for _ in range(2):
        for place, member in enumerate(members):
            if "time_s" in parameters[place]:
                others = [columns[k] for k in range(len(members)) if k != place]
                columns[place], parameters[place] = _refined(model, bank, y, member, parameters[place], others)
    seen = [model.projected(part) for part in columns]
    return [_one(bank, y, members, columns, seen, parameters, place) for place in range(len(members))]


def _random(bank: Bank, member: Member) -> bool:
    return EFFECTS[bank.candidates[member.candidate].effect].is_process


def _columns(model: Model, bank: Bank, member: Member) -> Array:
    entry = bank.candidates[member.candidate]
    W = bank.W[:, entry.options[member.option].columns]
    # A random member enters the fit of the others as noise of its most likely size.
    return np.asarray(W * entry.scales[member.scale]) if _random(bank, member) else W


def _refined(
    model: Model, bank: Bank, y: Array, member: Member, parameters: dict[str, float | str], others: list[Array]
) -> tuple[Array, dict[str, float | str]]:
    """The step's column at its best time on a fine grid around the one found, with the spread of times it leaves."""
    entry = bank.candidates[member.candidate]
    times = sorted({float(o.parameters["time_s"]) for o in entry.options})
    place = times.index(float(parameters["time_s"])) if float(parameters["time_s"]) in times else None
    if place is None:
        return _columns(model, bank, member), parameters
    low, high = times[max(place - 1, 0)], times[min(place + 1, len(times) - 1)]
    trial = np.linspace(low, high, FINE_STEPS)
    firsts = np.unique(np.append(np.searchsorted(model.t_s, trial), np.searchsorted(model.t_s, times[place])))
    firsts = firsts[firsts < model.t_s.size]
    effect = EFFECTS[entry.effect]
    fixed = {key: value for key, value in parameters.items() if key == "toward"}
    on = effect.columns(model.stream, entry.axis, {**fixed, "time_s": float(model.t_s[0]) - 1.0})[:, :, 0]
    X = model.prepared(model.reading_steps(on, firsts))
    if others:
        Q = scipy.linalg.orth(model.projected(np.hstack(others)))
        X, y = X - Q @ (Q.T @ X), y - Q @ (Q.T @ y)
    power = np.maximum(np.einsum("nk,nk->k", X, X), 1e-300)
    amplitude = X.T @ y / power
    gain = 0.5 * amplitude**2 * power
    # A flat prior over the trial times, each standing for the time to its neighbours.
    at = model.t_s[firsts]
    width = np.gradient(at) if at.size > 1 else np.ones(1)
    weight = np.exp(gain - gain.max()) * width
    weight /= weight.sum()
    best = int(np.argmax(gain))
    mean = float(weight @ amplitude)
    spread = float(np.sqrt(max(weight @ (amplitude - mean) ** 2, 0.0)))
    time = float(weight @ at)
    column = model.whitened(model.reading_steps(on, firsts[[best]]))
    before = float(model.t_s[firsts[best] - 1]) if firsts[best] else float(at[best])
    if at[best] - before > 10 * float(model.dt[firsts[best]]):
        # Between two intervals the time is only known to lie in the gap.
        time, sigma_time = 0.5 * (float(at[best]) + before), (float(at[best]) - before) / np.sqrt(12)
    else:
        sigma_time = float(np.sqrt(max(weight @ (at - time) ** 2, 0.0)))
    return column, {**fixed, "time_s": time, "time_sigma_s": sigma_time, "_spread": spread}


def _one(
    bank: Bank,
    y: Array,
    members: Sequence[Member],
    columns: list[Array],
    seen: list[Array],
    parameters: list[dict[str, float | str]],
    place: int,
) -> Fitted:
    if _random(bank, members[place]):
        return _random_size(bank, y, members, columns, seen, parameters[place], place)
    noise = [seen[k] for k in range(len(members)) if _random(bank, members[k])]
    flat = [k for k in range(len(members)) if not _random(bank, members[k])]
    X = np.hstack([seen[k] for k in flat])
    scale = 1.0 / np.maximum(np.linalg.norm(X, axis=0), 1e-300)  # units differ by many decades
    X = X * scale
    gram, correlation = X.T @ X, X.T @ y
    if noise:
        conditioning = Conditioning(np.hstack(noise), y)
        reduced = conditioning.reduced(X)
        gram, correlation = gram - reduced.T @ reduced, correlation - reduced.T @ conditioning.y
    covariance = np.linalg.pinv(gram, rcond=1e-12, hermitian=True)
    amplitudes = scale * (covariance @ correlation)
    covariance = covariance * np.outer(scale, scale)
    start = sum(columns[k].shape[1] for k in flat if k < place)
    own = slice(start, start + columns[place].shape[1])
    effect = EFFECTS[bank.candidates[members[place].candidate].effect]
    if effect.name == "rate_deadzone":
        size, sigma = _zone(amplitudes[own], covariance[own, own], parameters[place])
        return Fitted(size, sigma, {}, columns[place], amplitudes[own], False)
    size, more = effect.from_amplitudes(amplitudes[own])
    sigma = _sigma(amplitudes[own], covariance[own, own])
    spread = float(parameters[place].get("_spread", 0.0))
    shown = {**{key: value for key, value in parameters[place].items() if key != "_spread"}, **more}
    return Fitted(float(size), float(np.hypot(sigma, spread)), shown, columns[place], amplitudes[own], False)


def _zone(amplitudes: Array, covariance: Array, known: dict[str, float | str]) -> tuple[float, float]:
    """Half width of a dead zone, see `deadzone.half_width`."""
    seen = {key: float(np.deg2rad(float(value))) for key, value in known.items()}
    one = DeadStretches(0, np.empty(0, dtype=int), 0.0, seen["_size"], seen["_sigma"], seen["_alive"])
    return half_width(one, float(amplitudes[0]), amplitudes[1:], np.sqrt(np.diag(covariance)[1:]))


def _sigma(amplitudes: Array, covariance: Array) -> float:
    """Sigma of the length of the amplitudes."""
    direction = amplitudes / max(float(np.linalg.norm(amplitudes)), 1e-300)
    return float(np.sqrt(direction @ covariance @ direction))


def _random_size(
    bank: Bank,
    y: Array,
    members: Sequence[Member],
    columns: list[Array],
    seen: list[Array],
    parameters: dict[str, float | str],
    place: int,
) -> Fitted:
    entry = bank.candidates[members[place].candidate]
    option = entry.options[members[place].option]
    X = bank.X[:, option.columns]
    gram, correlation = X.T @ X, X.T @ y
    rest = [k for k in range(len(members)) if k != place]
    if rest:
        # Fitted effects are as good as free: their scale is taken large.
        wide = [seen[k] if _random(bank, members[k]) else 1e3 * seen[k] / np.linalg.norm(seen[k], axis=0) for k in rest]
        conditioning = Conditioning(np.hstack(wide), y)
        reduced = conditioning.reduced(X)
        gram, correlation = gram - reduced.T @ reduced, correlation - reduced.T @ conditioning.y
    centre = entry.scales[members[place].scale]
    sizes = np.geomspace(centre / 6, centre * 6, FINE_SIZES)
    log = log_bayes(gram[None], correlation[None], sizes)[0]
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean = float(weight @ sizes)
    sigma = float(np.sqrt(weight @ (sizes - mean) ** 2))
    scaled = X * mean
    amplitudes = np.asarray(np.linalg.solve(np.eye(scaled.shape[1]) + scaled.T @ scaled, scaled.T @ y))
    return Fitted(mean, sigma, dict(parameters), bank.W[:, option.columns] * mean, amplitudes, True)


def calibrated(model: Model, effects: Sequence[Fitted]) -> tuple[Array, Array]:
    """Change of G and b with the effects in the model, (12,), and its covariance (12, 12).

    Start attitudes, calibration and the effects' amplitudes are fitted together; those of random effects have unit variance.
    """
    Q = np.linalg.qr(model.starts)[0]
    columns = np.hstack([model.calibration, *(effect.columns for effect in effects)])
    columns = columns - Q @ (Q.T @ columns)
    y = model.whitened(model.zeta)
    y = y - Q @ (Q.T @ y)
    prior = np.concatenate(
        [1e-2 / PLAUSIBLE_RANGE**2, *(np.full(e.columns.shape[1], 1.0 if e.random else 0.0) for e in effects)]
    )
    scale = 1.0 / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    information = (columns * scale).T @ (columns * scale) + np.diag(prior * scale**2)
    covariance = np.linalg.pinv(information, rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    change = covariance @ (columns.T @ y)
    return np.asarray(change[:12]), np.asarray(covariance[:12, :12])
