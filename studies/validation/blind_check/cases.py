"""Drawing the cases: which effects, how strong, on which plan; by case number, so that a case is the same alone as in a batch.

How strong a deterministic or slow random effect is, is its evidence signal-to-noise ratio: the norm of what it adds to the
whitened observations once G, b and the start attitudes have taken up their part, √Δχ² of a fit of just this effect. It is
measured on the full simulation, noise-free with less without the effect. An effect on the samples themselves, or a wrong noise
level, has no such number; its size is drawn against the noise or the rates it acts on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from diagnosis.model.linearise import linearised
from diagnosis.model.recording import RecordingModel
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Setting, Surroundings, setting
from simulator.effects.base import Value
from simulator.effects.common import log_uniform
from simulator.scenario import Scenario
from simulator.simulate import disturbed, motion, observe, surroundings, with_gyro_temperature
from simulator.streams import generator
from simulator.truth.motion import Motion
from simulator.truth.rotation import perturbed
from studies.validation.blind_check.plans import plan
from studies.validation.blind_check.unlisted import UNLISTED, Unlisted, View

Array = NDArray[np.float64]
Kind = Literal["none", "one", "two", "unlisted", "withheld"]
KINDS: tuple[Kind, ...] = ("none", "one", "two", "unlisted")
Range = Annotated[tuple[float, float], Field(strict=False)]

TRIES = 60
SNR_TOLERANCE = 0.02  # relative, of the size an effect gets; more than that only where it is far from linear
ALIKE = 0.8  # cosine of two responses above which a pair is one effect to any diagnosis
STEP_TIMES = 8  # an interval, at which a listed step may imitate an unlisted effect


class Spec(BaseModel):
    """What the drawing depends on.

    Attributes
    ----------
    entropy : root of all random streams
    cases : number of cases
    base : scenario whose gyro, references and orbit the plans take over
    mix : cases of a block with no effect, one, two, and an unlisted one
    snr, pair_snr, unlisted_snr, withheld_snr : ranges of the evidence signal-to-noise ratio, log-uniform
    temperature_share : of the recordings that have a gyro temperature without needing one
    withhold : if above zero, all cases hold a listed effect that the diagnosis' library lacks, so many of each effect
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    entropy: int = Field(ge=0)
    cases: int = Field(ge=1)
    base: Scenario
    mix: Annotated[tuple[int, int, int, int], Field(strict=False)] = (6, 13, 5, 6)
    snr: Range = (4.0, 40.0)
    pair_snr: Range = (8.0, 40.0)
    unlisted_snr: Range = (4.0, 40.0)
    withheld_snr: Range = (12.0, 30.0)
    temperature_share: float = Field(default=0.4, ge=0, le=1)
    withhold: int = Field(default=0, ge=0)


@dataclass(frozen=True)
class World:
    """The noise-free truth of a case, and what an effect does to it.

    Attributes
    ----------
    scenario, motion : plan and its truth
    plain : noise-free recording without effects
    entropy, case : of the random streams
    """

    scenario: Scenario
    motion: Motion
    plain: Recording
    entropy: int
    case: int

    @property
    def G(self) -> Array:
        """True G."""
        return np.array(self.scenario.gyro.true_G)

    @property
    def bias(self) -> Array:
        """True bias, rad/s."""
        return np.deg2rad(self.scenario.gyro.true_bias_deg_s)

    @cached_property
    def model(self) -> RecordingModel:
        """The linear model about the truth."""
        return linearised(self.plain, self.G, self.bias)

    @cached_property
    def around(self) -> Surroundings:
        """The truth as effects see it."""
        return surroundings(self.plain, self.motion)

    def recording(self, settings: Sequence[Setting], invention: Invention | None = None, noise: bool = True) -> Recording:
        """The full simulation with effects, listed and not."""
        plain = self.plain if invention is None else invention.added(self)
        rngs = [generator(self.entropy, self.case, name) if noise else None for name in ("gyro_noise", "reference_noise")]
        return disturbed(plain, self.motion, settings, rngs[0], rngs[1], self.entropy, self.case)

    def response(self, settings: Sequence[Setting], invention: Invention | None = None) -> Array:
        """What effects add to the observations ζ, noise-free with less without them; (N,) rad."""
        shown = self.recording(settings, invention, noise=False)
        return np.asarray(linearised(shown, self.G, self.bias).zeta - self.model.zeta)

    def whitened(self, settings: Sequence[Setting], invention: Invention | None = None) -> Array:
        """The response, whitened and with what M0 takes up projected out; (N,), its norm is the SNR."""
        return self.model.prepared(self.response(settings, invention))


@dataclass(frozen=True)
class Invention:
    """An unlisted effect with its numbers; size in deg/s or deg."""

    effect: Unlisted
    axis: str
    size: float
    phase: float
    share: float

    def added(self, world: World) -> Recording:
        """The noise-free recording with it."""
        plain = world.plain
        k = "xyz".index(self.axis)
        view = View(
            stream=world.around.stream,
            references=world.around.references,
            starts_s=np.array([interval.start_s for interval in plain.intervals]),
            stops_s=np.array([interval.stop_s for interval in plain.intervals]),
            axis=k,
            phase=self.phase,
            share=self.share,
            rng=generator(world.entropy, world.case, f"unlisted:{self.effect.name}"),
        )
        change = np.deg2rad(self.size) * self.effect.shape(view)
        if self.effect.acts_on == "rates":
            rates = plain.gyro.rates.copy()
            rates[:, k] += change
            return replace(plain, gyro=replace(plain.gyro, rates=rates))
        error = np.zeros((len(change), 3))
        error[:, k] = change
        quaternions = perturbed(plain.attitudes.quaternions, error)
        return replace(plain, attitudes=replace(plain.attitudes, quaternions=quaternions))


@dataclass(frozen=True)
class Drawn:
    """A case: the world it is in, its effects, its answer (a JSON object), what its diagnosis may name (None: all)."""

    world: World
    settings: tuple[Setting, ...]
    invention: Invention | None
    answer: dict[str, Any]
    nameable: tuple[str, ...] | None

    def recording(self) -> Recording:
        """What the diagnosis sees."""
        return self.world.recording(self.settings, self.invention)


def kind_of(spec: Spec, case: int) -> tuple[Kind, int]:
    """Kind of a case, and its number among those of its kind.

    The kinds come in blocks, shuffled, in each of which the mix is exact.
    """
    if spec.withhold:
        return "withheld", case
    order = np.repeat(np.arange(4), spec.mix)
    block, place = divmod(case, order.size)
    kinds = generator(spec.entropy, block, "blind:kinds").permutation(order)
    kind = int(kinds[place])
    return KINDS[kind], block * spec.mix[kind] + int(np.sum(kinds[:place] == kind))


def draw(spec: Spec, case: int) -> Drawn:
    """Draw a case.

    Raises
    ------
    InputError
        No setting of an effect reaches the strength asked for within its plausible range.
    """
    kind, number = kind_of(spec, case)
    names = _names(spec, kind, case, number)
    world = _world(spec, case, names)
    answer: dict[str, Any] = {
        "case": case,
        "kind": kind,
        "effects": [],
        "unlisted": None,
        "true_G": world.G.tolist(),
        "true_bias_deg_s": list(world.scenario.gyro.true_bias_deg_s),
        "temperature": bool(world.plain.tables),
    }
    if kind == "unlisted":
        invention, response = _invented(spec, world, UNLISTED[names[0]])
        answer["unlisted"] = {
            "effect": names[0],
            "axis": invention.axis,
            "size": invention.size,
            "snr": float(np.linalg.norm(response)),
            "novelty": novelty(world.model, response),
        }
        return Drawn(world, (), invention, answer, None)
    limits = {"two": spec.pair_snr, "withheld": spec.withheld_snr}.get(kind, spec.snr)
    settings, responses = _placed_together(world, names, limits)
    answer["effects"] = [_described(one, response, responses) for one, response in zip(settings, responses, strict=True)]
    nameable = tuple(name for name in EFFECTS if name not in names) if kind == "withheld" else None
    return Drawn(world, settings, None, answer, nameable)


def _world(spec: Spec, case: int, names: Sequence[str]) -> World:
    rng = generator(spec.entropy, case, "blind:plan")
    scenario = plan(rng, spec.base, f"blind case {case}")
    # Drawn always, so that the plan does not depend on the effect.
    by_chance = rng.random() < spec.temperature_share
    truth = motion(scenario)
    plain = observe(scenario, truth, gyro_rng=None, reference_rng=None)
    if by_chance or any(name in EFFECTS and EFFECTS[name].missing(surroundings(plain, truth)) is not None for name in names):
        plain = with_gyro_temperature(plain, spec.entropy, case)
    return World(scenario, truth, plain, spec.entropy, case)


def _names(spec: Spec, kind: Kind, case: int, number: int) -> tuple[str, ...]:
    """Effects of a case."""
    if kind == "none":
        return ()
    if kind == "withheld":
        return (list(EFFECTS)[number // spec.withhold % len(EFFECTS)],)
    first, *others = by_lot(spec.entropy, case, UNLISTED if kind == "unlisted" else EFFECTS)
    if kind != "two":
        return (first,)
    return first, next(name for name in others if not EFFECTS[first].kin or EFFECTS[name].kin != EFFECTS[first].kin)


def by_lot(entropy: int, case: int, names: Iterable[str]) -> list[str]:
    """Names in an order drawn for a case.

    Each draws a lot from a stream of its own, so that a further name takes its place among the others and changes nothing
    else: cases that it does not lead stay as they were.
    """
    return sorted(names, key=lambda name: float(generator(entropy, case, f"blind:lot:{name}").random()))


def _placed_together(
    world: World, names: Sequence[str], limits: tuple[float, float]
) -> tuple[tuple[Setting, ...], list[Array | None]]:
    """Settings that are not one and the same effect to any diagnosis, with their whitened responses."""
    rngs = {name: generator(world.entropy, world.case, f"blind:effect:{name}") for name in names}
    for _ in range(TRIES):
        placed = [_placed(rngs[name], world, name, limits) for name in names]
        responses = [response for _, response in placed if response is not None]
        if len(responses) < 2 or abs(_cosine(responses[0], responses[1])) < ALIKE:
            return tuple(one for one, _ in placed), [response for _, response in placed]
    raise InputError(f"case {world.case}: {' and '.join(names)} are alike however they are set")


def _placed(rng: np.random.Generator, world: World, name: str, limits: tuple[float, float]) -> tuple[Setting, Array | None]:
    """A setting of an effect and its whitened response; None for one without."""
    effect = EFFECTS[name]
    low, high = effect.prior
    for _ in range(TRIES):
        axis, parameters = effect.draw(rng, world.around)
        drawn = effect.draw_size(rng, world.around, axis)
        if drawn is not None:
            return setting(name, axis, drawn, parameters), None
        signed = effect.sign == "any" and effect.bounds[0] < 0
        sign = float(rng.choice([-1.0, 1.0])) if signed else 1.0
        target = log_uniform(rng, *limits)

        def response(size: float, axis: str | None = axis, parameters: Mapping[str, Value] = parameters) -> Array:
            return world.whitened([setting(name, axis, size, parameters)])

        size, shown = _scaled(response, sign * low, target, effect.prior)
        if shown is not None:
            return _usual_form(setting(name, axis, size, parameters)), shown
    raise InputError(
        f"case {world.case}: {name} reaches no SNR of {limits[0]:g} to {limits[1]:g} with a size in {low:g} to {high:g}"
    )


def _usual_form(one: Setting) -> Setting:
    """With what its amplitudes hold as they give it, such as a positive size where a phase has the sign."""
    effect = EFFECTS[one.effect]
    size, held = effect.from_amplitudes(effect.amplitudes(one))
    return replace(one, size=size, parameters={**one.parameters, **held})


def _scaled(
    response: Callable[[float], Array], start: float, target: float, plausible: tuple[float, float]
) -> tuple[float, Array | None]:
    """Size at which the response has the target norm, from a small one; no response if the size is not plausible."""
    size = start
    for _ in range(5):
        shown = response(size)
        norm = float(np.linalg.norm(shown))
        if norm > 0 and abs(norm / target - 1) < SNR_TOLERANCE:
            return size, shown
        if norm == 0:
            break
        size *= target / norm
        if not plausible[0] <= abs(size) <= plausible[1]:
            break
    return size, None


def _invented(spec: Spec, world: World, effect: Unlisted) -> tuple[Invention, Array]:
    rng = generator(world.entropy, world.case, f"blind:unlisted:{effect.name}")
    for _ in range(TRIES):
        axis = str(rng.choice(effect.axes))
        target, phase, share = log_uniform(rng, *spec.unlisted_snr), float(rng.uniform(0, 2 * np.pi)), float(rng.random())
        unit = Invention(effect, axis, 1e-6, phase, share)

        def response(size: float, unit: Invention = unit) -> Array:
            return world.whitened([], replace(unit, size=size))

        # Any size will do below a degree and a tenth of the fastest rate.
        size, shown = _scaled(response, 1e-6, target, (0.0, 1.0))
        if shown is not None:
            return replace(unit, size=size), shown
    raise InputError(f"case {world.case}: {effect.name} reaches no SNR of {spec.unlisted_snr[0]:g}")


def novelty(model: RecordingModel, response: Array) -> float:
    """Norm of what no single listed effect with columns explains of a whitened response: how unknown an unlisted effect is.

    Parameters
    ----------
    model : linear model about the truth
    response : (N,) whitened and projected
    """
    total = float(response @ response)
    explained = 0.0
    for columns in _listed_columns(model):
        prepared = model.prepared(columns)
        U, s, _ = np.linalg.svd(prepared, full_matrices=False)
        share = U[:, s > 1e-9 * max(float(s[0]), 1e-300)].T @ response
        explained = max(explained, float(share @ share))
    for columns in _listed_steps(model):
        prepared = model.prepared(columns)
        size = np.maximum(np.einsum("ij,ij->j", prepared, prepared), 1e-30)
        explained = max(explained, float(np.max((response @ prepared) ** 2 / size)))
    return float(np.sqrt(max(total - explained, 0.0)))


def _listed_columns(model: RecordingModel) -> list[Array]:
    out = []
    for effect in EFFECTS.values():
        if not effect.has_columns or effect.switched or effect.missing(model.around) is not None:
            continue
        periods = [trial.parameters for trial in effect.trials(model.around)] if effect.scanned else [{}]
        for axis, given in product(effect.axes or (None,), periods):
            if effect.on_references:
                columns = model.reference_error(effect.reference_columns(model.references, axis, given))
            else:
                columns = model.reading(effect.columns(model.stream, axis, given))
            if columns.any():
                out.append(columns)
    return out


def _listed_steps(model: RecordingModel) -> list[Array]:
    """Steps of each axis' bias and of its sensitivity to each rate, at several times in each interval and between them."""
    shares = np.arange(STEP_TIMES) / STEP_TIMES
    starts = np.concatenate(
        [(block.steps.start + shares * (block.steps.stop - block.steps.start)).astype(np.intp) for block in model.blocks]
    )[1:]
    out = []
    for axis in range(3):
        for shape in (np.ones(len(model.t_s)), *model.rates.T):
            high = np.zeros((len(model.t_s), 3))
            high[:, axis] = shape
            out.append(model.reading_steps(high, starts))
    return out


def _described(one: Setting, response: Array | None, responses: Sequence[Array | None]) -> dict[str, Any]:
    """An effect of an answer; separate_snr is what is left of its SNR when the other effect's part is taken out."""
    snr = None if response is None else float(np.linalg.norm(response))
    others = [other for other in responses if other is not None and other is not response]
    separate = snr
    if snr is not None and response is not None and others:
        separate = snr * float(np.sqrt(max(1 - _cosine(response, others[0]) ** 2, 0.0)))
    return {
        "effect": one.effect,
        "axis": one.axis,
        "size": one.size,
        "unit": EFFECTS[one.effect].unit,
        "parameters": dict(one.parameters),
        "snr": snr,
        "separate_snr": separate,
    }


def _cosine(a: Array, b: Array) -> float:
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
