"""What a maneuver plan will show: the smallest visible size of each effect, what it cannot separate, what would help.

**Smallest visible size.** The diagnosis calls a gap when its statistic T, the evidence averaged over the whole bank of
candidates (`Search.null_statistic`), passes the point that M0 passes with probability `FALSE_ALARMS`. T is a log of a sum of
exponentials of convex quadratics in the observations y, and even in y; so {T ≤ threshold} is a convex set symmetric about 0,
and by Anderson's theorem (Proc. AMS 6, 1955, 170–176) the probability to leave it never falls as y = a x + n moves out along
a fixed signature x, nor as a random x is scaled up. The size at which 90 % of draws leave it therefore exists and is unique.
It is found with T itself on common draws of n, so that the price of looking everywhere is in it: no chi-square is assumed. x
is the whitened column of the effect with G, b and the start attitudes projected out (`diagnosis.model`), linearised at the
scenario's true G and b. Where an effect has a time, the size is that at the median one, and at the phase of mean power;
`best` and `worst` are for the largest and the smallest ‖x‖ among all, at the same a‖x‖, which hardly depends on them. A
random effect is drawn from its covariance.

**Inseparable pairs.** If A is at work with signature x, B imitates the part P_B x, ρ² = ‖P_B x‖²/‖x‖². The log evidence of
A over B then is about ½ a²‖x‖² (1 − ρ²), with Occam factors that grow only with log a left out (Kay, Fundamentals of
Statistical Signal Processing II, section 7.7, for the noncentrality). A probability of 0.95 takes log odds of ln 19, hence a
signal-to-noise ratio of

    SNR = a‖x‖ = sqrt(2 ln 19 / (1 − ρ²))

Two random effects are told apart by the Kullback–Leibler divergence of their covariances, I + s² K_A against the I + r² K_B
closest to it, which is the expected log likelihood ratio; s is that for which it is ln 19.

**Extra maneuvers** are intervals after the scenario's end. The SNR that the statistic needs hardly depends on the plan, so
the smallest visible size goes as 1/‖x‖, and for a random effect, whose mean square counts twice, as (tr K²)^(−1/4).

**Effects seen in the samples** follow from the thresholds of `diagnosis.stream` and `diagnosis.reference_noise`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import pandas as pd
import scipy.stats
from numpy.typing import NDArray

from diagnosis import random_effects, reference_noise, stream
from diagnosis.bank import AXES, Bank, available, build, columns_of, step_times
from diagnosis.diagnose import DRAWS, FALSE_ALARMS
from diagnosis.model import Model, linearised
from diagnosis.search import Search
from diagnosis.which import attribute
from gyrocal.errors import InputError
from gyrocal.observability import PLAUSIBLE_RANGE
from simulator.effects import EFFECTS, Effect, setting
from simulator.scenario import Scenario, override, profiles
from simulator.simulate import simulate

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Progress = Callable[[str, float], None]

POWER = 0.9
NULL_DRAWS = 2000  # of M0, for the threshold
POWER_DRAWS = 200  # of each effect; their 10 % point is good to 2 % of a size
NEAR = 0.1  # of the statistic: a size is good to 0.3 % then
MOST_STEPS = 14  # of the solution for a size
START_SNR = 6.5
GONE = 1e-6  # share of a signature that is left, below which it acts like the calibration itself
FAR = 1e4  # times the plausible size: what takes more than that is rounding
SURE = float(np.log(19.0))  # log odds of a probability of 0.95
LIMIT_SNR = 20.0  # needed to tell a pair apart, from which on it counts as inseparable
EXACT = 1e-7  # of 1 − ρ²: the same columns
RANDOM = ("bias_random_walk", "noise_flicker", "reference_correlated")
USUAL = {"gaps": "hold", "time_constant_s": 600.0}  # option of a random effect that is drawn
NAMED_FACTORS = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 6.0, 10.0)  # of the visible size
NAMED_DRAWS = 12
GAP_ORBITS = 1.0  # between the scenario's end and an extra maneuver
DAY = 86400.0

Verdict = Literal["visible", "implausible", "not identifiable", "not available"]


@dataclass(frozen=True)
class Signature:
    """What an effect does to the whitened and projected observations, per unit of its size.

    Attributes
    ----------
    effect, axis, label : label has the picked-up axis too, "g_matrix_step:z<y"
    X : (N, o, k) columns of each option (time of a step), k amplitudes (sine and cosine)
    share : (o,) what the projection leaves of each option, 1 for all
    weights : (o,) prior of the options, sum one
    parameters : of each option
    """

    effect: str
    axis: str | None
    label: str
    X: Array
    share: Array
    weights: Array
    parameters: tuple[dict[str, float | str], ...]

    @property
    def norms(self) -> Array:
        """(o,) ‖x‖ per unit size, root mean square over the phase."""
        return np.asarray(np.sqrt(np.sum(self.X**2, axis=(0, 2)) / self.X.shape[2]))

    @property
    def extremes(self) -> tuple[float, float]:
        """Smallest and largest ‖x‖ per unit size over options and phases."""
        values = np.linalg.svd(self.X.transpose(1, 0, 2), compute_uv=False)
        return float(values[:, -1].min()), float(values[:, 0].max())

    def typical(self) -> Array:
        """(N,) signature at the time of the median ‖x‖, and the phase of the mean ‖x‖²."""
        return np.asarray(self.X[:, self.middle] @ self.amplitudes)

    @property
    def middle(self) -> int:
        """The option with the median ‖x‖."""
        return _middle(self.norms, self.weights)

    @property
    def amplitudes(self) -> Array:
        """(k,) amplitudes of the typical signature: half way between the strongest and the weakest phase."""
        X = self.X[:, self.middle]
        return np.asarray(np.linalg.eigh(X.T @ X)[1].sum(axis=1) / np.sqrt(X.shape[1]))


@dataclass(frozen=True)
class Visible:
    """Smallest visible size of one effect.

    Attributes
    ----------
    effect, axis, label, unit : which
    verdict : whether it can be seen at a plausible size
    size : seen with probability 0.9 at a typical phase and time; infinite if never
    best, worst : at the best and the worst phase and time
    snr : a‖x‖ at which that is so; NaN for random effects and those seen in the samples
    plausible : range of its size
    seen_in : "attitude" or "samples"
    named : smallest size at which it is also named; NaN if not asked for, infinite if none was found
    text : condition or reason
    """

    effect: str
    axis: str | None
    label: str
    unit: str
    verdict: Verdict
    size: float
    best: float
    worst: float
    snr: float
    plausible: tuple[float, float]
    seen_in: Literal["attitude", "samples"]
    named: float = float("nan")
    text: str = ""


@dataclass(frozen=True)
class Pair:
    """An effect that another one imitates.

    Attributes
    ----------
    effect, other : labels; `effect` is at work and `other` imitates it
    share : ρ², NaN for random effects
    snr : that tells them apart; infinite if nothing does, NaN for random effects
    size : of `effect` that tells them apart, in its unit
    """

    effect: str
    other: str
    share: float
    snr: float
    size: float


@dataclass(frozen=True)
class Extra:
    """What an extra maneuver brings.

    Attributes
    ----------
    name : of the maneuver
    hours : it takes
    ratio : smallest visible size with it over that without, median over the effects of
        the median over their axes
    by_effect : the same by label, of effects that are visible with it
    resolved : pairs that it makes separable, of `pairs`
    pairs : inseparable pairs before
    gained : effects that become visible at a plausible size
    """

    name: str
    hours: float
    ratio: float
    by_effect: dict[str, float]
    resolved: tuple[tuple[str, str], ...]
    pairs: int
    gained: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """Everything a plan says."""

    scenario: str
    threshold: float
    degrees_of_freedom: int
    effects: tuple[Visible, ...]
    pairs: tuple[Pair, ...]
    extras: tuple[Extra, ...]
    notes: tuple[str, ...]
    runtime_s: float

    def unordered(self) -> set[tuple[str, str]]:
        """The inseparable pairs, each once."""
        return {_ordered(pair.effect, pair.other) for pair in self.pairs}

    def to_json(self) -> dict[str, Any]:
        """Document of `gyrocal plan --json`, format 1."""
        return {
            "format": 1,
            "scenario": self.scenario,
            "power": POWER,
            "false_alarm_rate": FALSE_ALARMS,
            "threshold": self.threshold,
            "degrees_of_freedom": self.degrees_of_freedom,
            "effects": [{**vars(one), "plausible": list(one.plausible)} for one in self.effects],
            "pairs": [dict(vars(one)) for one in self.pairs],
            "extras": [{**vars(one), "resolved": [list(pair) for pair in one.resolved]} for one in self.extras],
            "notes": list(self.notes),
            "runtime_s": self.runtime_s,
        }


def plan(
    scenario: Scenario,
    *,
    effects: Sequence[str] | None = None,
    extras: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
    named: bool = False,
    progress: Progress | None = None,
    seed: int = 0,
) -> Plan:
    """What a scenario will show.

    Parameters
    ----------
    scenario : the maneuver plan, with the gyro's and the references' noise
    effects : names of those to look at; all by default
    extras : extra maneuvers by name, each a list of interval sections; those of `maneuvers` by default, none if empty
    named : also look for the size at which an effect is named, which takes ten seconds and more for each
    progress : called with a text and the share done
    seed : of the draws

    Raises
    ------
    InputError
        There is no such effect, or an extra maneuver is no valid continuation of the scenario.
    """
    began = time.perf_counter()
    tell = progress or (lambda text, share: None)
    names = _chosen(effects)
    longer = {name: appended(scenario, parts) for name, parts in (maneuvers(scenario) if extras is None else extras).items()}
    tell("linear model", 0.0)
    model = linear_model(scenario)
    every = signatures(model, names)
    tell("candidates", 0.05)
    power = PowerOf(model, build(model), seed)
    tell("smallest visible sizes", 0.15)
    seen = list(_columns_seen(every, power, tell))
    random = random_columns(model, names)
    seen += list(random_seen(random, power))
    snr = np.array([one.snr for one in seen if np.isfinite(one.snr)])
    seen += _samples_seen(scenario, model, names, float(np.median(snr)) if snr.size else START_SNR)
    seen += _unavailable(model, names, random)
    if named:
        tell("smallest named sizes", 0.55)
        seen = _named(seen, every, random, power, tell)
    tell("pairs", 0.7)
    found = pairs(every, random, seen)
    helped = []
    for number, (name, extended) in enumerate(longer.items()):
        tell(f"extra: {name}", 0.7 + 0.3 * number / len(longer))
        helped.append(_helped(name, scenario, extended, model, every, random, seen, found))
    order = {name: number for number, name in enumerate(EFFECTS)}
    return Plan(
        scenario=scenario.title,
        threshold=power.threshold,
        degrees_of_freedom=model.degrees_of_freedom,
        effects=tuple(sorted(seen, key=lambda one: (order[one.effect], one.label))),
        pairs=tuple(found),
        extras=tuple(sorted(helped, key=lambda one: (one.ratio, -len(one.resolved)))),
        notes=_notes(scenario, model),
        runtime_s=time.perf_counter() - began,
    )


def _chosen(effects: Sequence[str] | None) -> list[str]:
    for name in effects or ():
        if name not in EFFECTS:
            raise InputError(f"{name}: no such effect; there are {', '.join(EFFECTS)}")
    return [name for name in EFFECTS if not effects or name in effects]


def linear_model(scenario: Scenario) -> Model:
    """The model about the true G and b, without noise, and with the simulator's gyro temperature as housekeeping."""
    recording = simulate(scenario, noise=False, effects=[setting("bias_temperature", "x", 0.0)])
    return linearised(recording, np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


# ---- signatures ----------------------------------------------------------------------------------------------------------


def signatures(model: Model, names: Sequence[str], at: tuple[Array, Array, Indices] | None = None) -> list[Signature]:
    """Signatures of the effects that are sums of columns.

    Parameters
    ----------
    model : the linear model
    names : effects
    at : times of steps, their weights, and the steps of the stream they begin with; those the diagnosis tries by default
    """
    out = []
    times, weights, firsts = step_times(model) if at is None else at
    for name in names:
        effect = EFFECTS[name]
        if effect.kind != "columns" or not available(model, effect):
            continue
        asked = {parameter.name for parameter in effect.parameters}
        for axis in effect.axes or (None,):
            label = name if axis is None else f"{name}:{axis}"
            if "time_s" not in asked:
                out.append(
                    _signature(model, effect, axis, label, columns_of(model, effect, axis, {})[:, None, :], np.ones(1), [{}])
                )
                continue
            for toward in AXES if "toward" in asked else [""]:
                fixed: dict[str, float | str] = {"toward": toward} if toward else {}
                on = effect.columns(model.stream, axis, {**fixed, "time_s": float(model.t_s[0]) - 1.0})[:, :, 0]
                W = model.whitened(model.reading_steps(on, firsts))[:, :, None]
                known = [{**fixed, "time_s": float(t)} for t in times]
                out.append(_signature(model, effect, axis, f"{label}<{toward}" if toward else label, W, weights, known))
    return out


def _signature(
    model: Model,
    effect: Effect,
    axis: str | None,
    label: str,
    W: Array,
    weights: Array,
    parameters: Sequence[dict[str, float | str]],
) -> Signature:
    X = model.projected(W.reshape(model.size, -1)).reshape(W.shape)
    share = np.linalg.norm(X, axis=(0, 2)) / np.maximum(np.linalg.norm(W, axis=(0, 2)), 1e-300)
    return Signature(effect.name, axis, label, X, share, weights / weights.sum(), tuple(parameters))


@dataclass(frozen=True)
class RandomColumns:
    """A random effect: y = a X z with z ~ N(0, I).

    Attributes
    ----------
    effect, axis : which
    X : (N, r) projected columns of unit amplitude, of the usual option
    parameters : of that option
    """

    effect: str
    axis: str
    X: Array
    parameters: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Effect and axis."""
        return f"{self.effect}:{self.axis}"

    @property
    def strength(self) -> float:
        """(tr K²)^¼ with K = X Xᵀ: the inverse goes with the smallest visible size."""
        return float(np.sum((self.X.T @ self.X) ** 2) ** 0.25)


def random_columns(model: Model, names: Sequence[str]) -> list[RandomColumns]:
    """The random effects among some, with the option of each that is nearest to the usual one."""
    out: list[RandomColumns] = []
    if not set(RANDOM) & set(names):
        return out
    for process in random_effects.processes(model, rivals=False):
        if process.name in names:
            nearest = min(range(len(process.columns)), key=lambda k: _unusual(process.parameters[k]))
            out.append(
                RandomColumns(
                    process.name, process.axis, model.projected(process.columns[nearest]), process.parameters[nearest]
                )
            )
    return out


def _unusual(parameters: Mapping[str, float | str]) -> float:
    """How far an option is from the usual one."""
    away = 0.0
    for name, value in parameters.items():
        usual = USUAL.get(name, value)
        away += abs(float(np.log(value / usual))) if isinstance(value, float) and isinstance(usual, float) else value != usual
    return away


# ---- smallest visible size -----------------------------------------------------------------------------------------------


class PowerOf:
    """The statistic of the diagnosis on draws.

    Parameters
    ----------
    model : the linear model
    bank : its candidates
    seed : of the draws
    """

    def __init__(self, model: Model, bank: Bank, seed: int = 0):
        self.bank = bank
        self.search = Search(bank, np.zeros(model.size))
        self.rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"diagnosis_plan")))
        null = np.concatenate(
            [self.search.null_statistic(bank.X.T @ self._noise(model, DRAWS)) for _ in range(NULL_DRAWS // DRAWS)]
        )
        # Beyond ln(draws + 1) the diagnosis goes by the bound P(B ≥ c) ≤ 1/c.
        self.threshold = float(min(np.quantile(null, 1 - FALSE_ALARMS), np.log(1 + DRAWS)))
        self.noise = self._noise(model, POWER_DRAWS)
        self._correlation = bank.X.T @ self.noise

    def _noise(self, model: Model, count: int) -> Array:
        return model.projected(self.rng.standard_normal((model.size, count)))

    def excess(self, moved: Array, amplitude: float) -> float:
        """The statistic that nine draws in ten pass, less the threshold; moved is (p, 1) or (p, d), Xᵀx."""
        values = self.search.null_statistic(self._correlation + amplitude * moved)
        return float(np.quantile(values, 1 - POWER)) - self.threshold

    def size(self, x: Array, start: float) -> float:
        """Amplitude of a signature, (N,) or (N, d) for each draw, that is seen in nine draws of ten; infinite if none is.

        A secant in log amplitude from `start`; the statistic grows about as the square of the amplitude.
        """
        moved = self.bank.X.T @ x.reshape(len(x), -1)
        here, value = start, self.excess(moved, start)
        low, high = 0.0, np.inf
        slope = 25.0
        for _ in range(MOST_STEPS):
            if abs(value) < NEAR:
                return here
            low, high = (max(low, here), high) if value < 0 else (low, min(high, here))
            there = here * float(np.exp(np.clip(-value / slope, -0.9, 0.9)))
            if not low < there < high:
                there = float(np.sqrt(low * high)) if np.isfinite(high) and low > 0 else (2 * low if low > 0 else 0.5 * high)
            new = self.excess(moved, there)
            slope = max((new - value) / np.log(there / here), 1.0)
            here, value = there, new
        return here if abs(value) < 1.0 else float("inf")


def _columns_seen(every: Sequence[Signature], power: PowerOf, tell: Progress) -> Iterator[Visible]:
    for number, one in enumerate(every):
        tell("smallest visible sizes", 0.15 + 0.35 * number / len(every))
        yield visible(one, power)


def visible(one: Signature, power: PowerOf) -> Visible:
    """Smallest visible size of an effect that is a sum of columns."""
    effect = EFFECTS[one.effect]
    smallest, largest = one.extremes
    reason = "acts like a change of G, b or start attitudes"
    row = _row(effect, "not identifiable", np.inf, reason, "attitude", one.axis)
    row = replace(row, label=one.label)
    if one.share.max() < GONE or FAR * effect.prior[1] * largest < START_SNR:
        return row
    x = one.typical()
    norm = float(np.linalg.norm(x))
    snr = START_SNR
    if norm > 0:
        snr = power.size(x / norm, START_SNR)
    size, best = snr / max(norm, 1e-300), snr / largest
    worst = snr / smallest if smallest > GONE * largest else np.inf
    row = replace(row, size=size, best=best, worst=worst, snr=snr, verdict="visible", text="")
    if best > effect.prior[1]:
        return replace(row, verdict="implausible", text=f"plausible only up to {effect.prior[1]:g} {effect.unit}")
    if size > effect.prior[1]:
        return replace(row, text="hidden at most times")
    return replace(row, text="hidden at worst") if worst > effect.prior[1] else row


def random_seen(random: Sequence[RandomColumns], power: PowerOf) -> Iterator[Visible]:
    """Smallest visible sizes of random effects."""
    for one in random:
        effect = EFFECTS[one.effect]
        # In terms of its strength a random effect needs about the square root of the number of ways it can be.
        x = one.X @ power.rng.standard_normal((one.X.shape[1], POWER_DRAWS))
        size = power.size(x, 4.0 / one.strength) if one.strength > 0 else np.inf
        verdict: Verdict = "visible" if size <= effect.prior[1] else "implausible"
        text = ", ".join(f"{name} {value:.4g}" if isinstance(value, float) else value for name, value in one.parameters.items())
        if verdict != "visible":
            text = f"plausible only up to {effect.prior[1]:g} {effect.unit}"
        yield Visible(
            one.effect, one.axis, one.label, effect.unit, verdict, size, size, size, float("nan"), effect.prior, "attitude",
            text=text,
        )  # fmt: skip


def _unavailable(model: Model, names: Sequence[str], random: Sequence[RandomColumns]) -> list[Visible]:
    """Effects whose columns this scenario has no motion or reference for."""
    out = []
    for name in names:
        effect = EFFECTS[name]
        if effect.kind == "columns" and not available(model, effect):
            text = "needs a table or a flight direction that the scenario does not have"
            if name == "reference_mode_offset":
                text = "needs references in both +x and -x forward"
            out.append(_row(effect, "not available", np.inf, text, "attitude"))
    lacking = set(RANDOM) & set(names) - {one.effect for one in random}
    return out + [_row(EFFECTS[name], "not available", np.inf, "needs a series of references", "attitude") for name in lacking]


def _row(
    effect: Effect, verdict: Verdict, size: float, text: str, seen_in: Literal["attitude", "samples"], axis: str | None = None
) -> Visible:
    label = effect.name if axis is None else f"{effect.name}:{axis}"
    nan = float("nan")
    return Visible(effect.name, axis, label, effect.unit, verdict, size, size, size, nan, effect.prior, seen_in, text=text)


# ---- smallest named size -------------------------------------------------------------------------------------------------


def _named(
    seen: list[Visible], every: Sequence[Signature], random: Sequence[RandomColumns], power: PowerOf, tell: Progress
) -> list[Visible]:
    rng = np.random.default_rng(power.rng.integers(2**63))
    drawn = {one.label: np.repeat(one.typical()[:, None], NAMED_DRAWS, axis=1) for one in every}
    drawn |= {one.label: one.X @ rng.standard_normal((one.X.shape[1], NAMED_DRAWS)) for one in random}
    out = []
    for number, one in enumerate(seen):
        tell(f"smallest named size: {one.label}", 0.55 + 0.15 * number / len(seen))
        if one.label in drawn and one.verdict == "visible" and np.isfinite(one.size):
            one = replace(one, named=named_size(one, drawn[one.label], power))
        out.append(one)
    return out


def named_size(one: Visible, x: Array, power: PowerOf) -> float:
    """Smallest multiple of the visible size at which nine draws of ten name the effect and nothing else.

    Parameters
    ----------
    one : the effect
    x : (N, d) drawn signatures of unit size

    Returns
    -------
    Infinite if ten times the visible size is not enough.
    """
    label = one.effect if one.axis is None else f"{one.effect}:{one.axis}"

    def enough(factor: float) -> bool:
        missed = 0
        for k in range(x.shape[1]):
            search = Search(power.bank, power.noise[:, k] + factor * one.size * x[:, k])
            answer = attribute(power.bank, search.explanations())
            right = answer.verdict == "named" and [slot.group[0][0] for slot in answer.slots] == [label]
            missed += not right
            if missed > (1 - POWER) * x.shape[1]:
                return False
        return True

    low, high = 0, len(NAMED_FACTORS)  # the first that is enough lies in [low, high]
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(NAMED_FACTORS[middle]) else (middle + 1, high)
    return NAMED_FACTORS[low] * one.size if low < len(NAMED_FACTORS) else float("inf")


# ---- pairs ---------------------------------------------------------------------------------------------------------------


def shares(every: Sequence[Signature]) -> tuple[Array, Array]:
    """ρ² of each effect (row) by each other (column), and the size of the other that does it per unit of the first.

    Over the options of the other the best imitation counts, over those of the effect itself the median.
    """
    count = len(every)
    bases = [_basis(one) for one in every]
    Q = np.hstack([basis.reshape(len(basis), -1) for basis in bases])
    parts = np.cumsum([0] + [one.X.shape[1] * one.X.shape[2] for one in every])
    rho, ratio = np.zeros((count, count)), np.zeros((count, count))
    for i, one in enumerate(every):
        power = np.sum(one.X**2, axis=(0, 2))  # (o,)
        products = np.sum((Q.T @ one.X.reshape(len(one.X), -1)).reshape(Q.shape[1], *one.X.shape[1:]) ** 2, axis=2)
        for j, other in enumerate(every):
            options, k = other.X.shape[1:]
            by = products[parts[j] : parts[j + 1]].reshape(options, k, -1).sum(axis=1)  # (options, o)
            best = by.argmax(axis=0)
            imitated = by[best, np.arange(power.size)]
            share = np.minimum(imitated / np.maximum(power, 1e-300), 1.0)
            middle = _middle(share, one.weights)
            rho[i, j] = share[middle]
            ratio[i, j] = np.sqrt(imitated[middle] / one.X.shape[2]) / max(other.norms[best[middle]], 1e-300)
    return rho, ratio


def _basis(one: Signature) -> Array:
    """(N, o, k) orthonormal basis of each option; zero where the option cannot be seen."""
    U, s, _ = np.linalg.svd(one.X.transpose(1, 0, 2), full_matrices=False)
    kept = (s > 1e-9 * max(float(s.max()), 1e-300)) & (one.share > GONE)[:, None]
    return np.asarray((U * kept[:, None, :]).transpose(1, 0, 2))


def separating_snr(share: Array) -> Array:
    """SNR that gives log odds of ln 19 where a share ρ² can be imitated."""
    left = 1 - np.asarray(share)
    return np.where(left > EXACT, np.sqrt(2 * SURE / np.maximum(left, EXACT)), np.inf)


def pairs(every: Sequence[Signature], random: Sequence[RandomColumns], seen: Sequence[Visible]) -> list[Pair]:
    """Pairs of visible effects that take more than an SNR of `LIMIT_SNR` to tell apart, the worst first.

    An imitation that takes an implausible size of the other does not count. Random effects are compared with one another;
    a pair of them counts if it takes as much more than the visible size as `LIMIT_SNR` is more than the usual SNR.
    """
    known = {one.label: one for one in seen if one.verdict == "visible"}
    some = [one for one in every if one.label in known]
    out = []
    if some:
        rho, ratio = shares(some)
        snr = separating_snr(rho)
        for i, j in np.argwhere(snr > LIMIT_SNR):
            if i == j:
                continue
            one = known[some[i].label]
            if ratio[i, j] * one.best > EFFECTS[some[j].effect].prior[1]:
                continue
            size = float(snr[i, j]) / float(some[i].norms[some[i].middle])
            out.append(Pair(one.label, some[j].label, float(rho[i, j]), float(snr[i, j]), size))
    noisy = [one for one in random if one.label in known]
    for first in noisy:
        for second in noisy:
            if first.label != second.label:
                size = telling_size(first, second, known[first.label].size)
                if size > LIMIT_SNR / START_SNR * known[first.label].size:
                    out.append(Pair(first.label, second.label, float("nan"), float("nan"), size))
    return sorted(out, key=lambda pair: (-np.nan_to_num(pair.snr, nan=0.0), pair.effect, pair.other))


def telling_size(one: RandomColumns, other: RandomColumns, start: float) -> float:
    """Size of a random effect at which another differs by a divergence of ln 19 at its best size.

    With orthogonal columns X of squared lengths d and unit directions Q, S = I + r² X Xᵀ has S⁻¹ = I − Q g Qᵀ with
    g = r² d/(1 + r² d), so that the divergence

        ½ [tr(S_B⁻¹ S_A) − N + ln|S_B| − ln|S_A|]

    takes only the squared products of the directions of both.
    """
    d_A, d_B = np.sum(one.X**2, axis=0), np.sum(other.X**2, axis=0)
    cross = ((other.X / np.sqrt(np.maximum(d_B, 1e-300))).T @ one.X) ** 2  # (r_B, r_A)
    sizes = start * np.geomspace(0.3, 30.0, 41)
    gain = np.geomspace(1e-3, 1e5, 120)[:, None] / max(float(d_B.max()), 1e-300) * d_B  # (q, r_B): r² d
    g = gain / (1 + gain)
    squared = sizes**2
    mixed = squared[:, None] * (d_A.sum() - g @ cross.sum(axis=1)) - g.sum(axis=1)  # (s, q)
    log_A = np.log1p(squared[:, None] * d_A).sum(axis=1)
    divergence = 0.5 * (mixed + np.log1p(gain).sum(axis=1) - log_A[:, None]).min(axis=1)
    enough = np.flatnonzero(divergence >= SURE)
    return float(sizes[enough[0]]) if enough.size else float("inf")


# ---- effects seen in the samples -----------------------------------------------------------------------------------------


def quiet_samples(scenario: Scenario) -> tuple[int, int]:
    """Gyro samples outside slews and transitions and clear of their edges: in all, and in the longest stretch."""
    total, longest = 0, 0
    for profile in profiles(scenario):
        edges = [0.0, *(t for span in sorted(profile.moving) for t in span), profile.stop_s - profile.start_s]
        counts = [int((b - a) / scenario.gyro.sample_s) - 2 * stream.HALF for a, b in zip(edges[::2], edges[1::2], strict=True)]
        total += sum(max(count, 0) for count in counts)
        longest = max([longest, *counts])
    return total, longest


def _samples_seen(scenario: Scenario, model: Model, names: Sequence[str], snr: float) -> list[Visible]:
    wanted = {
        "noise_excess": lambda: _noise_factor(scenario),
        "rate_quantization": lambda: _lattice(scenario, model, "rate_quantization"),
        "rate_truncation": lambda: _lattice(scenario, model, "rate_truncation"),
        "rate_deadzone": lambda: _dead_zones(model, snr),
        "rate_saturation": lambda: _saturation(model),
        "vibration": lambda: _vibration(scenario),
        "spikes": lambda: _spikes(scenario),
        "stale_samples": lambda: _stale(model),
        "reference_noise_excess": lambda: _reference_factor(scenario),
    }
    return [row for name in names if name in wanted for row in wanted[name]()]


def _sample_sigma(scenario: Scenario) -> float:
    """Noise of a sample, deg/s."""
    return scenario.gyro.arw_deg_per_sqrt_s / float(np.sqrt(scenario.gyro.sample_s))


def _noise_factor(scenario: Scenario) -> list[Visible]:
    """Second differences: z = (f² − 1)/rel must pass the point of `EVENT_P` with scatter f² rel."""
    effect, n = EFFECTS["noise_excess"], quiet_samples(scenario)[0]
    if n < 200 or scenario.gyro.arw_deg_per_sqrt_s == 0:
        return [_row(effect, "not identifiable", np.inf, "needs 200 quiet samples of a gyro with stated noise", "samples")]
    relative = np.sqrt(2 / n * reference_noise.CORRELATED)
    level, spread = scipy.stats.norm.isf(stream.EVENT_P / 2) * relative, scipy.stats.norm.ppf(POWER) * relative
    size = float(np.sqrt((1 + level) / (1 - spread))) if spread < 1 else np.inf
    low = float(np.sqrt(max(1 - level, 0.0) / (1 + spread)))
    return [_row(effect, "visible", size, f"any one axis; or a factor below {low:.3f}", "samples")]


def _lattice(scenario: Scenario, model: Model, name: str) -> list[Visible]:
    """A step that at most 0.7 of the values are distinct on, and above the share of the noise that counts."""
    sigma = _sample_sigma(scenario)
    rng = np.random.default_rng(0)
    raw = np.rad2deg(model.recording.gyro.rates)
    x = raw + sigma * rng.standard_normal(raw.shape)
    out = []
    for axis in range(3):
        steps = np.geomspace(1e-9, 1.0, 37)
        few = [np.unique(np.round(x[:, axis] / step)).size <= 0.7 * len(x) for step in steps]
        step = float(steps[int(np.argmax(few))]) if any(few) else np.inf
        size = max(step, stream.COARSE * sigma)
        out.append(_row(EFFECTS[name], "visible", size, "exact: readings are multiples of it", "samples", AXES[axis]))
    return out


def _dead_zones(model: Model, snr: float) -> list[Visible]:
    """A zone whose missing rates have the signal-to-noise ratio that other effects need."""
    effect = EFFECTS["rate_deadzone"]
    zones = np.geomspace(*effect.prior, 41)
    out = []
    for axis in range(3):
        inside = np.abs(model.raw[:, axis, None]) < np.deg2rad(zones)
        low = np.zeros((*model.raw.shape, zones.size))
        low[:, axis] = np.where(inside, -model.raw[:, axis, None], 0.0)
        norms = np.linalg.norm(model.prepared(model.reading(low)), axis=0)
        seen = np.flatnonzero(norms >= snr)
        if seen.size:
            text = "from about here on by the missing rates"
            out.append(_row(effect, "visible", float(zones[seen[0]]), text, "attitude", AXES[axis]))
        else:
            out.append(_row(effect, "implausible", np.inf, "no missing rate shows in the attitude", "attitude", AXES[axis]))
    return out


def _saturation(model: Model) -> list[Visible]:
    """Limits that at least five samples exceed."""
    out = []
    for axis in range(3):
        largest = np.sort(np.abs(model.recording.gyro.rates[:, axis]))[-stream.FEWEST_CLIPPED]
        limit = float(np.rad2deg(largest))
        out.append(_row(EFFECTS["rate_saturation"], "visible", limit, "limits up to this are seen", "samples", AXES[axis]))
    return out


def _vibration(scenario: Scenario) -> list[Visible]:
    """Power of a tone in the longest quiet stretch under a Hann window, of noise bandwidth 3/2.

    2 × power over noise is χ² with 2 degrees of freedom and noncentrality A² n/(3 σ²); it must pass 2 ln(tried/`LINE_P`).
    """
    effect, n, sigma = EFFECTS["vibration"], quiet_samples(scenario)[1], _sample_sigma(scenario)
    if n < 256 or sigma == 0:
        return [_row(effect, "not identifiable", np.inf, "needs 256 quiet samples in a row, and noise", "samples")]
    needed = noncentrality(2 * np.log(n / 2 / stream.LINE_P), 2)
    size = float(sigma * np.sqrt(3 * needed / n))
    text = f"above {stream.LOWEST_LINE:g} Hz; up to 1.2 times that between frequency bins"
    return [_row(effect, "visible", size, text, "samples")]


def noncentrality(point: float, degrees: int) -> float:
    """Of a χ² that passes a point with probability 0.9."""
    low, high = 0.0, 10 * point + 100
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if scipy.stats.ncx2.sf(point, degrees, middle) < POWER else (low, middle)
    return high


def _spikes(scenario: Scenario) -> list[Visible]:
    """Two outliers beyond `OUTLIER` sigmas of a reading less a median of seven, among exponential ones."""
    effect, n, sigma = EFFECTS["spikes"], quiet_samples(scenario)[0], _sample_sigma(scenario)
    fraction = next(float(one.default or 0.0) for one in effect.parameters if one.name == "fraction")
    # P(no more than one of a Poisson number) = 0.1 at 3.89.
    needed, limit = 3.89, stream.OUTLIER * sigma * np.sqrt(1 + np.pi / 14)
    if 3 * n * fraction <= needed:
        return [_row(effect, "implausible", np.inf, f"too few samples for a share of {fraction:g}", "samples")]
    size = float(limit / np.log(3 * n * fraction / needed))
    return [_row(effect, "visible", size, f"share {fraction:g} on all axes; two beyond {limit:.2g} suffice", "samples")]


def _stale(model: Model) -> list[Visible]:
    """Three exact repeats are enough; P(Poisson ≥ 3) = 0.9 at 5.32."""
    share = 5.32 / model.recording.gyro.t_s.size
    return [_row(EFFECTS["stale_samples"], "visible", 1.0, f"any run length, from a share of {share:.2g} on", "samples")]


def _reference_factor(scenario: Scenario) -> list[Visible]:
    """χ² of three axes' mean square second differences; one axis with a factor f has z = (f² − 1) v/rel."""
    effect = EFFECTS["reference_noise_excess"]
    every = scenario.reference.every_s
    count = 0
    if scenario.reference.at == "series" and every is not None:
        count = sum(max(int((one.stop_s - one.start_s) / every) - 1, 0) for one in scenario.interval)
    if every is None or count < reference_noise.FEWEST:
        text = "needs a longer series of references"
        return [_row(effect, "not identifiable", np.inf, text, "samples")]
    needed = float(np.sqrt(noncentrality(scipy.stats.chi2.isf(reference_noise.LEVEL, 3), 3)))
    relative = np.sqrt(2 * reference_noise.CORRELATED / count)
    out = []
    for axis, sigma in enumerate(scenario.reference.sigma_deg):
        walk = 2 * scenario.gyro.arw_deg_per_sqrt_s**2 * every
        factor = float(np.sqrt(1 + needed * relative * (6 * sigma**2 + walk) / (6 * sigma**2)))
        out.append(_row(effect, "visible", factor, "", "samples", AXES[axis]))
    return out


# ---- extra maneuvers -----------------------------------------------------------------------------------------------------


def appended(scenario: Scenario, sections: Sequence[Mapping[str, Any]]) -> Scenario:
    """The scenario with intervals after its end, whose start_s and stop_s count from there.

    Raises
    ------
    InputError
        They are no valid intervals.
    """
    end = scenario.interval[-1].stop_s
    intervals = [_plain(one.model_dump(exclude_none=True)) for one in scenario.interval]
    for section in sections:
        moved = dict(section)
        for name in ("start_s", "stop_s"):
            if isinstance(moved.get(name), int | float):
                moved[name] = float(moved[name]) + end
        intervals.append(moved)
    return override(scenario, {"interval": intervals})


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def maneuvers(scenario: Scenario) -> dict[str, list[dict[str, Any]]]:
    """The built-in extra maneuvers, an orbit after the scenario's end; times count from its end."""
    orbit = float(scenario.orbit.circular_orbit().period)
    orbit = round(orbit / scenario.gyro.sample_s) * scenario.gyro.sample_s
    start = GAP_ORBITS * orbit

    def one(activity: str, mode: str, length: float, **more: Any) -> list[dict[str, Any]]:
        name = _free("extra", {interval.name for interval in scenario.interval})
        return [{"name": name, "activity": activity, "start_s": start, "stop_s": start + length, "mode": mode, **more}]

    out = {
        "+x forward, one orbit (-1 RPO about y)": one("+x forward", "+x", orbit),
        "-x forward, one orbit (+1 RPO about y)": one("-x forward", "-x", orbit),
        "+y forward, one orbit": one("+y forward", "+y", orbit),
        "pitch turn, one orbit (-2 RPO about y)": one("pitch turn", "+x", orbit, slew=[_slew("y", -360, 60, orbit - 120)]),
        "inertial hold, one orbit": one(
            "inertial hold", "+x", orbit, hold={"start_s": 6.0, "stop_s": orbit - 6.0, "transition_s": 31.0}
        ),
        "yaw +180 deg": one("yaw slew", "+x", 1000.0, slew=[_slew("z", 180, 60, 800)]),
        "yaw -180 deg": one("yaw slew", "-x", 1000.0, slew=[_slew("z", -180, 60, 800)]),
    }
    for name, axis in (("roll", "x"), ("pitch", "y")):
        there_and_back = [_slew(axis, 60, 60, 280), _slew(axis, -60, 640, 280)]
        out[f"{name} +60 deg and back"] = one(f"{name} slews", "+x", 1000.0, slew=there_and_back)
    shift = 30 * DAY
    repeat = []
    taken = {interval.name for interval in scenario.interval}
    for interval in scenario.interval:
        section = _plain(interval.model_dump(exclude_none=True))
        moved = shift - scenario.interval[0].start_s
        section |= {"start_s": section["start_s"] + moved, "stop_s": section["stop_s"] + moved}
        section["name"] = _free(f"{section['name']}b", taken)
        taken.add(section["name"])
        repeat.append(section)
    out["the whole plan again, a month later"] = repeat
    return out


def _slew(axis: str, angle: float, start: float, duration: float) -> dict[str, Any]:
    along = [float(axis == name) for name in AXES]
    return {
        "axis": along,
        "angle_deg": float(angle),
        "start_s": float(start),
        "duration_s": float(duration),
        "ramp_fraction": 0.1,
    }


def _free(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "b"
    return name


def _helped(
    name: str,
    scenario: Scenario,
    extended: Scenario,
    model: Model,
    every: Sequence[Signature],
    random: Sequence[RandomColumns],
    seen: Sequence[Visible],
    found: Sequence[Pair],
) -> Extra:
    longer = linear_model(extended)
    names = sorted({one.effect for one in every} | {one.effect for one in random})
    # The same steps as without it: the extra intervals come after all of them.
    after = {one.label: one for one in signatures(longer, names, step_times(model))}
    noisy = {one.label: one for one in random_columns(longer, names)}
    before = {one.label: one for one in seen}
    ratio: dict[str, float] = {}
    for signature in every:
        # The simulated temperature of another span is another one.
        if EFFECTS[signature.effect].housekeeping is None and signature.share.max() > GONE:
            quotients = signature.norms / np.maximum(after[signature.label].norms, 1e-300)
            ratio[signature.label] = float(quotients[_middle(quotients, signature.weights)])
    ratio |= {one.label: one.strength / noisy[one.label].strength for one in random if one.strength > 0}
    gained = [
        signature.label
        for signature in every
        if before[signature.label].verdict != "visible"
        and after[signature.label].extremes[1] * EFFECTS[signature.effect].prior[1] >= START_SNR
        and after[signature.label].share.max() > GONE
    ]
    now = [replace(one, size=one.size * ratio.get(one.label, 1.0), best=one.best * ratio.get(one.label, 1.0)) for one in seen]
    left = {_ordered(one.effect, one.other) for one in pairs(list(after.values()), list(noisy.values()), now)}
    were = {_ordered(one.effect, one.other) for one in found}
    by_effect: dict[str, list[float]] = {}
    for label, value in ratio.items():
        if before[label].verdict == "visible":
            by_effect.setdefault(before[label].effect, []).append(value)
    hours = sum(one.stop_s - one.start_s for one in extended.interval[len(scenario.interval) :]) / 3600
    median = float(np.median([np.median(values) for values in by_effect.values()])) if by_effect else 1.0
    shown = {label: value for label, value in ratio.items() if before[label].verdict == "visible" or label in gained}
    return Extra(name, hours, median, shown, tuple(sorted(were - left)), len(were), tuple(gained))


# ---- small things --------------------------------------------------------------------------------------------------------


def _ordered(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)


def _middle(values: Array, weights: Array) -> int:
    """Index of the weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return int(order[min(np.searchsorted(total, 0.5 * total[-1]), order.size - 1)])


def _notes(scenario: Scenario, model: Model) -> tuple[str, ...]:
    notes = []
    if scenario.reference.at == "ends":
        notes.append(
            f"References only at the ends of {len(model.blocks)} intervals: {model.degrees_of_freedom} degrees of freedom are "
            "left beside the calibration; what happens inside an interval shows only by its sum, and few effects can be told "
            "from one another"
        )
    starts = np.linalg.qr(model.starts)[0]
    columns = (model.calibration - starts @ (starts.T @ model.calibration)) * PLAUSIBLE_RANGE
    sigma = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns + 1e-2 * np.eye(12))))
    parameters = [f"G_{a}{b}" for a in AXES for b in AXES] + [f"b_{a}" for a in AXES]
    unseen = [name for name, value in zip(parameters, sigma, strict=True) if value > 0.5]
    if unseen:
        notes.append(f"Not observed by these motions: {', '.join(unseen)}; effects that act like them cannot be seen either")
    notes += [
        "Not identifiable from any recording: a constant offset of all references, the same as a turn of G and the start "
        "attitudes; constant errors of G and b, which are calibrated away",
        "bias_temperature is as with the simulator's own gyro temperature; a recording without housekeeping shows it only as "
        "something unknown",
    ]
    if scenario.control_motion is not None:
        notes.append("Thresholds in the samples take the control motion for quiet; with a strong one fewer samples count")
    return tuple(notes)


def tables(found: Plan) -> dict[str, pd.DataFrame]:
    """The plan as tables: effects, pairs, extras."""
    effects = pd.DataFrame([vars(one) for one in found.effects])
    together = pd.DataFrame([vars(one) for one in found.pairs], columns=["effect", "other", "share", "snr", "size"])
    extras = pd.DataFrame(
        [
            {
                "maneuver": one.name, "hours": one.hours, "ratio": one.ratio, "resolved": len(one.resolved), "pairs": one.pairs,
                "gained": ", ".join(one.gained), "helps most": ", ".join(_most(one)),
            }
            for one in found.extras
        ]
    )  # fmt: skip
    return {"effects": effects, "pairs": together, "extras": extras}


def _most(one: Extra, count: int = 3) -> list[str]:
    best = sorted(one.by_effect.items(), key=lambda item: item[1])[:count]
    return [f"{label} ×{value:.2f}" for label, value in best if value < 0.99]
