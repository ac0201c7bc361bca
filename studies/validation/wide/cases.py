"""The cases of the wide check, each by its number: the plan, what is in it, how strongly it shows.

The kinds come in blocks of twenty, shuffled, in which their shares are exact: five without effect, eight with one listed
effect, three with two, four with an unlisted one. Listed effects are whatever the registry holds; each draws axis, parameters
and, if it does so, size itself. All other sizes are set so that the evidence (`studies.validation.wide.evidence`) is
log-uniform.

An unlisted effect counts as such only if more than three sigma of what it does are left when the listed effect that explains
most of it is fitted; steps are tried at several times, parameters as the effects themselves say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, Literal

import numpy as np

from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Effect, Setting, Surroundings, setting
from simulator.effects.base import Array, Value
from simulator.effects.chain import Active, readings, referenced
from simulator.effects.common import log_uniform, spans
from simulator.simulate import surroundings
from simulator.streams import generator
from simulator.truth.rotation import separation
from studies.validation.wide.evidence import Change, Evidence, of_noise, of_process
from studies.validation.wide.families import FAMILIES
from studies.validation.wide.plans import GRADES, KINDS, Plan, drawn_plan
from studies.validation.wide.split import PartName, part

Kind = Literal["none", "single", "pair", "unlisted"]
ORDER: tuple[Kind, ...] = ("none", "single", "pair", "unlisted")
MIX = (5, 8, 3, 4)

SNR = (5.0, 60.0)
TOLERANCE = 0.1  # of the logarithm of the evidence; where an effect jumps, anything in the range will do
STEPS, TRIES, PLANS = 9, 4, 60
DRAWS = 6  # of a random change
DESCRIBED = 0.3  # norm of the error of a plan's own samples, up to which the baseline describes it
DETERMINED = 0.03  # sigma of an element of G, up to which a plan determines it
ALIKE = 0.8  # cosine of two responses above which a pair is one effect to any diagnosis
NOVEL = 3.0  # sigma that no listed effect explains
MOST_TRIALS, STEP_TIMES = 12, 12


@dataclass(frozen=True)
class Spec:
    """What the drawing depends on."""

    part: PartName
    entropy: int
    snr: tuple[float, float] = SNR

    def rng(self, case: int, name: str) -> np.random.Generator:
        """A stream of a case, which is its part's own."""
        return generator(self.entropy, case, f"wide:{self.part}:{part(self.part).entropy}:{name}")


@dataclass(frozen=True)
class World:
    """A case's plan, and what effects do to it."""

    spec: Spec
    case: int
    kind: str
    grade: str
    plan: Plan
    evidence: Evidence

    @cached_property
    def around(self) -> Surroundings:
        """The truth as effects see it."""
        return surroundings(self.plan.plain, self.plan.motion)

    def rng(self, name: str) -> np.random.Generator:
        """A stream of the case."""
        return self.spec.rng(self.case, name)

    def active(self, settings: Sequence[Setting], draw: int = 0) -> list[Active]:
        """Effects with streams of their own; draw 0 is that of the recording."""
        return [Active(_effect(one.effect), one, self.rng(f"effect:{draw}:{one.label()}")) for one in settings]

    def observed(self, settings: Sequence[Setting], draw: int = 0) -> tuple[Array, Array]:
        """Raw rates and reference attitudes with noise and effects."""
        noise = self.rng(f"gyro:{draw}"), self.rng(f"reference:{draw}")
        active = self.active(settings, draw)
        return readings(self.around, active, noise[0]), referenced(self.around, active, noise[1])

    def difference(self, settings: Sequence[Setting], draw: int = 0) -> Change:
        """What effects change under the same noise."""
        raw, references = self.observed(settings, draw)
        plain_raw, plain_references = self.observed((), draw)
        return Change(raw - plain_raw, separation(plain_references, references))

    def noise(self, draw: int = 0) -> Change:
        """The noise as stated."""
        raw, references = self.observed((), draw)
        return Change(raw - self.plan.plain.gyro.rates, separation(self.plan.motion.quaternions, references))

    def strength(self, one: Setting) -> float:
        """Evidence of an effect."""
        effect = _effect(one.effect)
        if effect.implements("columns") or effect.implements("reference_columns") or effect.implements("retimed"):
            return float(np.linalg.norm(self.evidence.seen(self.difference([one]))))
        evidence, draws, levels = self.evidence, [], []
        for draw in range(1, DRAWS + 1):
            change, noise = self.difference([one], draw), self.noise(draw)
            draws.append(evidence.seen(change))
            both = Change(change.raw + noise.raw, change.reference + noise.reference)
            levels.append(
                np.hypot(
                    of_noise(evidence.attitude(noise), evidence.attitude(both)),
                    of_noise(evidence.samples(noise), evidence.samples(both)) if change.raw.any() else 0.0,
                )
            )
        return max(of_process(draws), float(np.median(levels)))

    def recording(self, settings: Sequence[Setting]) -> Recording:
        """What a diagnosis sees."""
        plain = self.plan.plain
        rates, quaternions = self.observed(settings)
        return replace(
            plain, gyro=replace(plain.gyro, rates=rates), attitudes=replace(plain.attitudes, quaternions=quaternions)
        )


@dataclass(frozen=True)
class Drawn:
    """A case: its world, its effects with their evidence, and what of an unlisted one no listed effect explains (or NaN)."""

    kind: Kind
    world: World
    settings: tuple[Setting, ...]
    snr: tuple[float, ...]
    separate_snr: tuple[float, ...]
    novelty: float

    def recording(self) -> Recording:
        """What a diagnosis sees."""
        return self.world.recording(self.settings)

    def truth(self) -> list[dict[str, Any]]:
        """Effects with axis, size, unit, parameters and evidence, as JSON."""
        return [
            {
                "effect": one.effect,
                "axis": one.axis,
                "size": one.size,
                "unit": _effect(one.effect).unit,
                "parameters": dict(one.parameters),
                "snr": snr,
                "separate_snr": separate,
            }
            for one, snr, separate in zip(self.settings, self.snr, self.separate_snr, strict=True)
        ]


def _effect(name: str) -> Effect:
    return FAMILIES[name] if name in FAMILIES else EFFECTS[name]


def kind_of(spec: Spec, case: int) -> Kind:
    """Kind of a case."""
    block, place = divmod(case, sum(MIX))
    return ORDER[int(spec.rng(block, "kinds").permutation(np.repeat(np.arange(4), MIX))[place])]


def world_of(spec: Spec, case: int) -> World:
    """Plan of a case: the first drawn that the baseline describes and that determines G.

    Raises
    ------
    InputError
        None of many does.
    """
    chosen, lot = part(spec.part), spec.rng(case, "plan")
    kind, grade = str(lot.choice(chosen.plans)), str(lot.choice(chosen.grades))
    for number in range(PLANS):
        plan = drawn_plan(spec.rng(case, f"plan:{number}"), KINDS[kind], GRADES[grade], f"wide {spec.part} {case}")
        evidence = Evidence(plan)
        if evidence.model_error < DESCRIBED and evidence.sigmas[:9].max() < DETERMINED:
            return World(spec, case, kind, grade, plan, evidence)
    raise InputError(f"case {case}: no plan '{kind}' of grade {grade} that the baseline describes and that determines G")


def draw(spec: Spec, case: int) -> Drawn:
    """Draw a case.

    Raises
    ------
    InputError
        No plan, or no effect for it, was found.
    """
    kind, world = kind_of(spec, case), world_of(spec, case)
    if kind == "none":
        return Drawn(kind, world, (), (), (), np.nan)
    if kind == "unlisted":
        for name in _by_lot(world, part(spec.part).families):
            for one, snr in _placed(world, FAMILIES[name]):
                novel = novelty(world, one)
                if novel > NOVEL:
                    return Drawn(kind, world, (one,), (snr,), (snr,), novel)
        raise InputError(f"case {case}: no unlisted effect that differs from the listed ones")
    found: list[tuple[Setting, float, Array]] = []
    for name in _by_lot(world, EFFECTS):
        kin = {EFFECTS[one.effect].kin for one, *_ in found} - {""}
        placed = next(_placed(world, EFFECTS[name]), None) if EFFECTS[name].kin not in kin else None
        if placed is None:
            continue
        shown = world.evidence.seen(world.difference([placed[0]]))
        if all(abs(_cosine(shown, other)) < ALIKE for *_, other in found):
            found.append((*placed, shown))
        if len(found) == (2 if kind == "pair" else 1):
            snrs = tuple(snr for _, snr, _ in found)
            cosine = _cosine(found[0][2], found[-1][2]) if len(found) == 2 else 0.0
            separate = tuple(float(snr * np.sqrt(1 - cosine**2)) for snr in snrs)
            return Drawn(kind, world, tuple(one for one, *_ in found), snrs, separate, np.nan)
    raise InputError(f"case {case}: too few listed effects that can show in its plan")


def _by_lot(world: World, names: Iterable[str]) -> list[str]:
    """Names in an order drawn for the case; a further name changes nothing of that of the others."""
    return sorted(names, key=lambda name: float(world.rng(f"lot:{name}").random()))


def _placed(world: World, effect: Effect) -> Iterator[tuple[Setting, float]]:
    """Settings of an effect that can act here, with their evidence.

    An effect that draws its own size keeps it where its evidence is in the range, or where no other size leads there.
    """
    if effect.missing(world.around) is not None:
        return
    rng, snr = world.rng(f"draw:{effect.name}"), world.spec.snr
    sizes = max(effect.prior[0], effect.bounds[0]), min(effect.prior[1], effect.bounds[1])
    for _ in range(TRIES):
        target = log_uniform(rng, *snr)
        axis, parameters = effect.draw(rng, world.around)
        sign = 1.0 if effect.sign == "positive" or effect.bounds[0] >= 0 or rng.random() < 0.5 else -1.0
        size = effect.draw_size(rng, world.around, axis)

        def made(size: float, axis: str | None = axis, parameters: dict[str, Value] = parameters) -> Setting:
            return _usual_form(effect, effect.completed(_setting(effect, axis, size, parameters)))

        def strength(size: float, made: Callable[[float], Setting] = made) -> float:
            return world.strength(made(size))

        try:
            own = None if size is None else (size, strength(size))
            fits = own is not None and snr[0] <= own[1] <= snr[1]
            found = own if fits else _scaled(strength, sign, target, sizes, snr)
            if found is None and own is not None and own[1] > snr[1]:
                found = own
        except InputError:  # it does nothing here with these numbers
            continue
        if found is not None:
            yield made(found[0]), found[1]


def _setting(effect: Effect, axis: str | None, size: float, parameters: dict[str, Value]) -> Setting:
    """A setting; that of an unlisted effect has all its numbers drawn."""
    if effect.name in FAMILIES:
        return Setting(effect.name, axis, size, parameters)
    return setting(effect.name, axis, size, parameters)


def _usual_form(effect: Effect, one: Setting) -> Setting:
    """With what its amplitudes hold as they give it, such as a positive size where a phase has the sign."""
    if not effect.has_columns:
        return one
    size, held = effect.from_amplitudes(effect.amplitudes(one))
    return replace(one, size=size, parameters={**one.parameters, **held})


def _scaled(
    strength: Callable[[float], float], sign: float, target: float, sizes: tuple[float, float], snr: tuple[float, float]
) -> tuple[float, float] | None:
    """Size, and its evidence, near a target: secants in the logarithms, from a small size."""
    size, last = sizes[0], None
    for _ in range(STEPS):
        norm = strength(sign * size)
        if norm > 0 and abs(np.log(norm / target)) < TOLERANCE:
            return sign * size, norm
        slope = 1.0
        if last and norm > 0 and last[1] > 0 and norm != last[1] and size != last[0]:
            slope = float(np.clip(np.log(norm / last[1]) / np.log(size / last[0]), 0.3, 3.0))
        step = float(np.clip(np.log(target / norm) / slope, -16.0, 16.0)) if norm > 0 else np.log(30.0)
        last = (size, norm)
        size = float(np.clip(size * np.exp(step), *sizes))
        if size == last[0]:
            break
    norm = last[1] if last else 0.0
    inside = last is not None and snr[0] <= norm <= snr[1]
    return (sign * last[0], norm) if inside and last else None


def _cosine(a: Array, b: Array) -> float:
    """Of two changes, zero where one is nothing."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b / size) if size > 0 else 0.0


def novelty(world: World, one: Setting) -> float:
    """Norm of what no listed effect with columns explains of an unlisted effect, as it is in the recording."""
    change = world.difference([one])
    response = world.evidence.attitude(change)
    total = float(np.sum(world.evidence.seen(change) ** 2))
    explained = 0.0
    for effect in EFFECTS.values():
        if effect.has_columns and effect.missing(world.around) is None:
            for columns in _columns(world, effect):
                u, s, _ = np.linalg.svd(columns, full_matrices=False)
                share = u[:, s > 1e-9 * max(float(s[0]), 1e-300)].T @ response
                explained = max(explained, float(share @ share))
    return float(np.sqrt(max(total - explained, 0.0)))


def _columns(world: World, effect: Effect) -> Iterator[Array]:
    """Whitened columns of a listed effect for its axes, for parameters that it would have tried, at times where it may
    begin."""
    around, zero = world.around, Change(np.zeros_like(world.around.stream.raw), np.zeros((len(world.around.references.t_s), 3)))
    trials = list(effect.trials(around))
    trials = trials[:: max(1, len(trials) // MOST_TRIALS)]
    times = _step_times(around) if effect.switched else [np.nan]
    for axis, trial, time in product(effect.axes or (None,), trials, times):
        given = {one.name: one.default for one in effect.parameters if one.default is not None} | dict(trial.parameters)
        given |= {"time_s": float(time)} if effect.switched else {}
        if effect.on_references:
            columns = effect.reference_columns(around.references, axis, given)
            changes = [replace(zero, reference=one) for one in np.moveaxis(columns, 2, 0)]
        else:
            columns = effect.columns(around.stream, axis, given)
            changes = [replace(zero, raw=one) for one in np.moveaxis(columns, 2, 0)]
        if np.isfinite(columns).all() and columns.any():
            yield np.stack([world.evidence.attitude(one) for one in changes], axis=1)


def _step_times(around: Surroundings) -> Array:
    """Times in and between the intervals, s."""
    begin, end = spans(around.stream)
    inside = (begin[:, None] + (end - begin)[:, None] * np.array([0.2, 0.5, 0.8])).ravel()
    times = np.sort(np.concatenate([inside, 0.5 * (begin[1:] + end[:-1])]))
    return np.asarray(times[:: max(1, len(times) // STEP_TIMES)])
