"""A case of ``gyrocal study withheld``: plan, gyro and effects by the entropy and its number, its diagnosis, and its row.

The kinds come in shuffled blocks with exact shares (`MIX`): no effect, one listed effect, two, one **withheld** (listed, but
the library is not told of it), one that was never listed (**unlisted**), and **mixed** ones, one to three listed effects beside
an unlisted one. Sizes are log-uniform in the signal-to-noise ratio (`studies.withheld.snr`), the root of the sum of the squares
of that in the attitude and that in the samples. A plan that does not determine G, or that an effect has nothing to act on, is
drawn again.

A stated cause is right if it is there, or if its waveform leaves at most 2 % of the power of an effect that is there. The same
rule says what counts as outside the library: a withheld effect may be named as one that reproduces it. A random error without a
name, of which side and axis are stated, is right if an effect acts there, and finds those that its group holds.
"""

import json
import resource
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field
from scipy.optimize import brentq

from diagnosis.answer import label_by_character
from diagnosis.budget import FLOOR, predict_held_out
from diagnosis.diagnose import diagnose
from diagnosis.inference.conformal import MISSING, UNKNOWN, compute_scores, name_of
from diagnosis.model.prepare import prepare
from diagnosis.result import Details, Diagnosis
from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Effect, Setting, Surroundings, setting
from simulator.effects.base import Value
from simulator.effects.chain import ActiveEffect, simulate_readings, simulate_references
from simulator.effects.common import measure_reference_arc
from simulator.simulate import build_surroundings
from simulator.streams import generator
from simulator.truth.rotation import separation
from studies.montecarlo.files import convert_to_plain
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.withheld.families import FAMILIES, Family
from studies.withheld.plans import Plan, draw_plan, log_uniform
from studies.withheld.snr import Change, ResidualModel, measure_attitude

MIX = {"none": 3, "single": 5, "pair": 3, "withheld": 3, "unlisted": 3, "mixed": 3}  # cases in a block
SNR = (5.0, 60.0)  # range of the drawn signal-to-noise ratios
SNR_TOLERANCE = 0.3  # of the logarithm, by which a drawn size may miss its ratio
MOST_LISTED = 3  # listed effects of a mixed case
MOST_PLANS = 60  # tried for a case
DESCRIBED = 0.3  # norm of the error of a plan's own samples, up to which M0 describes it
DETERMINED = 0.03  # sigma of an element of G, up to which a plan determines it
ALIKE = 0.8  # cosine of two responses from which two effects of a case are one to any diagnosis
SAME_POWER = 0.02  # share of an effect's power that a cause may leave to be right in its place
LEAST_MISFIT = 1.05  # of the floor, from which a share of the misfit is measured
FURTHER_DRAWS = 4  # recordings with other noise on which a share is measured
RANDOM_DRAWS = 4  # of a random change

Draw = Callable[[np.random.Generator, Surroundings], Value]


# ---- what is drawn ---------------------------------------------------------------------------------------------------------


def draw_phase(rng: np.random.Generator, around: Surroundings) -> Value:
    """A phase, deg."""
    return float(rng.uniform(-180.0, 180.0))


def draw_time(rng: np.random.Generator, around: Surroundings) -> Value:
    """Time of a step, s: inside an interval, or in three of ten the middle of a gap."""
    stream = around.stream
    begin, end = np.array([stream.t_s[[part.start, part.stop - 1]] for part in stream.intervals]).T
    if rng.random() < 0.7 or len(begin) == 1:
        chosen = int(rng.choice(len(begin), p=(end - begin) / (end - begin).sum()))
        return float(begin[chosen] + rng.uniform(0.15, 0.85) * (end - begin)[chosen])
    gap = int(rng.integers(len(begin) - 1))
    return float(0.5 * (end[gap] + begin[gap + 1]))


def draw_over_arc(spacings: float, arcs: float) -> Draw:
    """A time from some spacings of the references to a share of the longest interval, s."""

    def draw(rng: np.random.Generator, around: Surroundings) -> Value:
        spacing, arc = measure_reference_arc(around)
        return log_uniform(rng, spacings * spacing, max(arcs * arc, 1.1 * spacings * spacing))

    return draw


def choose(*words: str) -> Draw:
    """One of some words."""
    return lambda rng, around: str(rng.choice(words))


def between(low: float, high: float) -> Draw:
    """A number uniform in its logarithm."""
    return lambda rng, around: log_uniform(rng, low, high)


PERIOD, TIME_CONSTANT = draw_over_arc(3.0, 1.5), draw_over_arc(2.0, 1 / 3)
TOWARD = choose("x", "y", "z")
LISTED: dict[str, dict[str, Draw]] = {  # effects that are drawn, of those that a diagnosis may name, and their parameters
    "bias_drift": {},
    "bias_step": {"time_s": draw_time},
    "bias_orbital": {"phase_deg": draw_phase},
    "bias_periodic": {"period_s": PERIOD, "phase_deg": draw_phase},
    "bias_temperature": {},
    "bias_random_walk": {"gaps": choose("hold", "reset")},
    "bias_markov": {"time_constant_s": TIME_CONSTANT},
    "noise_flicker": {},
    "noise_excess": {},
    "noise_angle_white": {},
    "scale_asymmetry": {},
    "scale_quadratic": {},
    "g_matrix_step": {"time_s": draw_time, "toward": TOWARD},
    "g_matrix_temperature": {"toward": TOWARD},
    "time_offset": {},
    "clock_drift": {},
    "clock_slip": {"time_s": draw_time},
    "rate_lag": {},
    "rate_quantization": {},
    "rate_truncation": {},
    "rate_saturation": {},
    "spikes": {"fraction": between(2e-4, 3e-3)},
    "stale_samples": {"fraction": between(2e-3, 5e-2)},
    "reference_jump": {**dict.fromkeys(("e_x_deg", "e_y_deg", "e_z_deg"), draw_phase), "begin_s": draw_time},
    "reference_mode_offset": {"holds": choose("off", "on")},
    "reference_orbital": {"phase_deg": draw_phase},
    "reference_horizon": {"phase_deg": draw_phase},
    "reference_periodic": {"period_s": PERIOD, "phase_deg": draw_phase},
    "reference_correlated": {"time_constant_s": TIME_CONSTANT},
    "reference_noise_excess": {},
}
SIZES = {  # ranges that are narrower than the priors
    "noise_excess": (1.02, 10.0),
    "reference_noise_excess": (1.02, 10.0),
    "stale_samples": (1.0, 20.0),
}
LINEAR = ("rate", "random_rate", "reference", "random_reference")  # stages whose errors are in proportion to the size
FIXED = ("rate", "reference", "filter", "clock", "threshold")  # stages whose errors are the same whatever the noise
SIDES = {"clock": "time", "filter": "time"}  # of the stages that act neither on the gyro's rates nor on the references


def find_effect(name: str) -> Effect:
    """An effect of the list, or a family outside of it."""
    return EFFECTS[name] if name in EFFECTS else FAMILIES[name]


def find_side(name: str) -> str:
    """Side that an effect is on: gyro, reference or time."""
    effect = find_effect(name)
    own = effect.side if isinstance(effect, Family) else ""
    return own or SIDES.get(effect.stage, "reference" if effect.on_references else "gyro")


@dataclass(frozen=True)
class World:
    """A plan, and what effects do to it; every random stream is the case's own."""

    entropy: int
    case: int
    attempt: int
    plan: Plan
    model: ResidualModel
    noises: dict[int, tuple[Array, Array]] = field(default_factory=dict)  # rates and references with noise alone, by draw

    @cached_property
    def around(self) -> Surroundings:
        """The truth as effects see it."""
        return build_surroundings(self.plan.plain, self.plan.motion)

    def rng(self, name: str) -> np.random.Generator:
        """A stream of the case."""
        return generator(self.entropy, self.case, f"withheld:{self.attempt}:{name}")

    def simulate(self, settings: Sequence[Setting], draw: int = 0) -> tuple[Array, Array]:
        """Raw rates and reference attitudes with noise and effects; draw 0 is that of the recording."""
        if not settings and draw in self.noises:
            return self.noises[draw]
        active = [ActiveEffect(find_effect(one.effect), one, self.rng(f"effect:{draw}:{one.label()}")) for one in settings]
        noise = self.rng(f"gyro:{draw}"), self.rng(f"reference:{draw}")
        made = simulate_readings(self.around, active, noise[0]), simulate_references(self.around, active, noise[1])
        if not settings:
            self.noises[draw] = made
        return made

    def record(self, settings: Sequence[Setting], draw: int = 0) -> Recording:
        """The recording that a diagnosis sees, and further ones with other noise."""
        rates, quaternions = self.simulate(settings, draw)
        plain = self.plan.plain
        attitudes = replace(plain.attitudes, quaternions=quaternions)
        return replace(plain, gyro=replace(plain.gyro, rates=rates), attitudes=attitudes)

    def change(self, one: Setting, draw: int = 0) -> Change:
        """What an effect changes under the same noise."""
        (raw, references), (plain_raw, plain_references) = self.simulate([one], draw), self.simulate((), draw)
        return Change(raw - plain_raw, separation(plain_references, references))

    def noise(self, draw: int) -> Change:
        """The noise as stated."""
        raw, references = self.simulate((), draw)
        return Change(raw - self.plan.plain.gyro.rates, separation(self.plan.motion.quaternions, references))

    def list_changes(self, one: Setting) -> list[Change]:
        """What an effect changes, in one draw if it is the same in all."""
        draws = 1 if find_effect(one.effect).stage in FIXED else RANDOM_DRAWS
        return [self.change(one, draw) for draw in range(draws)]

    def measure(self, changes: Sequence[Change]) -> tuple[float, float]:
        """Signal-to-noise ratios in the attitude and in the samples of a change in some draws."""
        noises = [self.noise(draw) for draw in range(len(changes))] if len(changes) > 1 else []
        attitude = measure_attitude([self.model.respond(one) for one in changes], [self.model.respond(one) for one in noises])
        levels = [self.model.measure_samples(one.raw, n.raw) for one, n in zip(changes, noises, strict=False)]
        return attitude, float(np.median(levels)) if levels else self.model.measure_samples(changes[0].raw, None)

    def respond(self, change: Change) -> Array:
        """(M,) whitened change of attitude and samples."""
        return np.concatenate([self.model.respond(change), self.model.roughen(change.raw).ravel()])


class Placed(NamedTuple):
    """An effect of a case with its signal-to-noise ratios in attitude and samples."""

    setting: Setting
    attitude: float
    samples: float

    @property
    def snr(self) -> float:
        """Both together."""
        return float(np.hypot(self.attitude, self.samples))


class DrawnCase(NamedTuple):
    """A case: its kind, its plan, and its effects, one outside the library last."""

    kind: str
    world: World
    effects: tuple[Placed, ...]

    @property
    def settings(self) -> list[Setting]:
        """The effects without their ratios."""
        return [one.setting for one in self.effects]

    @property
    def allowed_names(self) -> list[str] | None:
        """Names that the diagnosis may use; None for all."""
        if self.kind != "withheld":
            return None
        withheld = list_effects_with_symptom_of(self.effects[0].setting.effect)
        return [name for name in EFFECTS if name not in withheld]


def draw_kind(entropy: int, case: int) -> str:
    """Draw the kind of a case."""
    block, place = divmod(case, sum(MIX.values()))
    return str(generator(entropy, block, "withheld:kinds").permutation(np.repeat(list(MIX), list(MIX.values())))[place])


def draw_case(entropy: int, case: int) -> DrawnCase:
    """Draw a case; an `InputError` if no plan of many will do."""
    kind = draw_kind(entropy, case)
    for attempt in range(MOST_PLANS):
        try:
            plan = draw_plan(generator(entropy, case, f"withheld:{attempt}:plan"), f"withheld {case}")
        except InputError:  # such as an interval with one reference
            continue
        world = World(entropy, case, attempt, plan, ResidualModel(plan))
        if world.model.model_error < DESCRIBED and world.model.taken_up[1][:9].max() < DETERMINED:
            effects = _place_effects(world, kind)
            if effects is not None:
                return DrawnCase(kind, world, tuple(effects))
    raise InputError(f"case {case}: no plan of {MOST_PLANS} in which its effects can show")


def _place_effects(world: World, kind: str) -> list[Placed] | None:
    """The effects of a kind of case; None where too few can act."""
    few = int(world.rng("count").integers(1, MOST_LISTED, endpoint=True))
    listed = {"single": 1, "pair": 2, "withheld": 1, "mixed": few}.get(kind, 0)
    found: list[Placed] = []
    for names, wanted in ((list(LISTED), listed), (list(FAMILIES), listed + (kind in ("unlisted", "mixed")))):
        for name in sorted(names, key=lambda name: float(world.rng(f"lot:{name}").random())):
            if len(found) == wanted:
                break
            placed = place_effect(world, name)
            if placed is not None and _is_distinct(world, placed, found):
                found.append(placed)
        if len(found) < wanted:
            return None
    return found


def _is_distinct(world: World, placed: Placed, others: Iterable[Placed]) -> bool:
    own = world.respond(world.change(placed.setting))
    responses = [world.respond(world.change(other.setting)) for other in others]
    return all(abs(own @ one) < ALIKE * np.linalg.norm(own) * np.linalg.norm(one) for one in responses)


def place_effect(world: World, name: str) -> Placed | None:
    """Draw the numbers of an effect, and its size so that it shows as strongly as is drawn; None where it cannot act so."""
    effect, rng = find_effect(name), world.rng(f"draw:{name}")
    if effect.missing(world.around) is not None:
        return None
    target, axis = log_uniform(rng, *SNR), str(rng.choice(effect.axes)) if effect.axes else None
    axis = None if effect.axis_optional and rng.random() < 0.5 else axis
    if name in LISTED:
        parameters = {key: draw(rng, world.around) for key, draw in LISTED[name].items()}
    else:
        parameters = {"phase_deg": draw_phase(rng, world.around), "share": float(rng.random()), "pace": float(rng.random())}
    sign = 1.0 if effect.sign == "positive" or effect.bounds[0] >= 0 or rng.random() < 0.5 else -1.0
    low, high = SIZES.get(name, (max(effect.prior[0], effect.bounds[0]), min(effect.prior[1], effect.bounds[1])))

    def build(log_size: float) -> Setting:
        size = sign * float(np.exp(log_size))
        if name not in EFFECTS:
            return Setting(name, axis, size, parameters)
        made = effect.completed(setting(name, axis, size, parameters))
        if not effect.has_columns:
            return made
        size, held = effect.from_amplitudes(effect.amplitudes(made))  # a phase holds the sign
        return replace(made, size=size, parameters={**made.parameters, **held})

    try:
        reference = build(np.log(low)) if effect.stage in LINEAR else None
        unit = world.list_changes(reference) if reference else []

        def measure(log_size: float) -> tuple[float, float]:
            changes = [one.scale(float(np.exp(log_size)) / low) for one in unit] or world.list_changes(build(log_size))
            return world.measure(changes)

        def compare(log_size: float) -> float:
            return float(np.log(max(np.hypot(*measure(log_size)), 1e-3) / target))

        ends = np.log(low), np.log(high)
        if compare(ends[0]) * compare(ends[1]) > 0:
            return None
        found = float(brentq(compare, *ends, xtol=0.05, rtol=1e-3, maxiter=25, disp=False))
        placed = Placed(build(found), *world.measure(world.list_changes(build(found))))
    except InputError:  # with these numbers it does nothing here
        return None
    return placed if abs(np.log(placed.snr / target)) < SNR_TOLERANCE else None


# ---- what an answer is worth -----------------------------------------------------------------------------------------------

Cause = Mapping[str, Any]


def measure_left_power(world: World, one: Setting, cause: Cause) -> float:
    """Share of an effect's power that a stated cause leaves, with the cause's own numbers and any size."""
    effect = EFFECTS[cause["effect"]]
    shown = world.respond(world.change(one))
    given: dict[str, Value] = {p.name: p.default for p in effect.parameters if p.default is not None} | cause["parameters"]
    stated = Setting(effect.name, cause["axis"], cause["size"], given)
    try:
        changes = _list_column_changes(world, effect, stated) if effect.has_columns else [world.change(stated)]
        columns = np.stack([world.respond(change) for change in changes], axis=1)
    except InputError:
        return 1.0
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    taken = u[:, s > 1e-9 * max(float(s[0]), 1e-300)].T @ shown
    return float(1 - taken @ taken / max(float(shown @ shown), 1e-300))


def _list_column_changes(world: World, effect: Effect, stated: Setting) -> list[Change]:
    raw, reference = np.zeros_like(world.around.stream.raw), np.zeros((len(world.around.references.t_s), 3))
    if effect.on_references:
        columns = effect.reference_columns(world.around.references, stated.axis, stated.parameters)
        return [Change(raw, one) for one in np.moveaxis(columns, 2, 0)]
    columns = effect.columns(world.around.stream, stated.axis, stated.parameters)
    return [Change(one, reference) for one in np.moveaxis(columns, 2, 0)]


def judge_causes(drawn: DrawnCase, causes: Sequence[Cause]) -> list[dict[str, Any]]:
    """Compare each stated cause with the simulated effects; `hits` and `near` hold the effects' numbers.

    `hits`: effects that a named cause equals or reproduces but for `SAME_POWER`, or random ones that a cause stated by side has
    in its group. `near`: effects on the same side and axis. Effects with one symptom are one answer, stated by its group.
    """
    out = []
    for cause in causes:
        named = "effect" in cause
        names = list_effects_with_symptom_of(cause["effect"]) if named else []
        side = find_side(cause["effect"] if named else cause["group"][0].partition(":")[0])
        hits, near = [], []
        for number, effect in enumerate(drawn.settings):
            equal_axis = effect.axis is None or effect.axis == cause["axis"]
            if (equal_axis or cause["axis"] is None) and find_side(effect.effect) == side:
                near.append(number)
            equal = equal_axis and effect.effect in names
            alike = equal or (named and measure_left_power(drawn.world, effect, cause) <= SAME_POWER)
            random = effect.effect in EFFECTS and EFFECTS[effect.effect].is_process
            if alike or (not named and random and effect.label() in cause["group"]):
                hits.append(number)
        label = Setting(cause["effect"], cause["axis"], 0.0).label() if named else label_by_character(cause["group"][0])
        in_set = bool(hits) or any(effect.label() in cause["group"] for effect in drawn.settings)
        judged = {"named": named, "right": bool(hits if named else near), "in_set": in_set, "hits": hits, "near": near}
        out.append({"cause": label, "p": cause["group_probability" if len(names) > 1 else "probability"], **judged})
    return out


def list_effects_with_symptom_of(name: str) -> list[str]:
    """List the effects that no recording tells from one, since they have its symptom; itself included."""
    symptom = EFFECTS[name].symptom
    return [other for other, effect in EFFECTS.items() if other == name or (symptom and effect.symptom == symptom)]


def decide_outcome(kind: str, present: bool, count: int, judged: Sequence[Mapping[str, Any]], verdict: str) -> str:
    """Say what becomes of a case.

    ``right``: all that is there is stated and nothing else, or no misfit is seen where there is none; of a mixed case all that
    is stated is there. ``part``: of several effects all that is stated is there, and one is missing. ``localised``: of an
    effect outside the library all causes have its side and axis. ``unknown``, ``missed``, ``alarm``; ``wrong``: the rest.
    """
    if kind == "none":
        return "alarm" if present else "right"
    if not present:
        return "missed"
    if verdict == "unknown" or not judged:
        return "unknown"
    right = all(one["right"] for one in judged)
    if right and (kind == "mixed" or {hit for one in judged for hit in one["hits"]} == set(range(count))):
        return "right"
    if kind in ("withheld", "unlisted"):
        return "localised" if all(one["near"] for one in judged) else "wrong"
    return "part" if right else "wrong"


def list_size_errors(drawn: DrawnCase, causes: Sequence[Cause]) -> list[float]:
    """(size − true size)/sigma of each cause that is there; sizes that are read off the samples are left out."""
    out = []
    for cause in causes:
        for one in drawn.settings:
            same = (cause.get("effect"), cause["axis"]) == (one.effect, one.axis)
            toward = one.parameters.get("toward")
            if same and cause["parameters"].get("toward", toward) == toward and cause["sigma"] > 1e-5 * abs(cause["size"]):
                out.append((cause["size"] - one.size) / cause["sigma"])
    return out


def score_truth(drawn: DrawnCase, scores: Mapping[str, float]) -> float:
    """Conformal score of what is put in; of an effect outside the library, that of unknown or of its side and axis."""
    if drawn.kind in ("none", "single", "pair"):
        random = [find_effect(one.effect).is_process for one in drawn.settings]
        labels = [one.label() for one in drawn.settings]
        stated = [label_by_character(label) if of_one else label for label, of_one in zip(labels, random, strict=True)]
        return scores.get(name_of(stated), MISSING)
    last = drawn.settings[-1]  # the one without a name is drawn last
    character = label_by_character(Setting(find_side(last.effect), last.axis, 0.0).label())
    return min(score for name, score in scores.items() if name == UNKNOWN or character in name.split(" + "))


def measure_true_share(drawn: DrawnCase, details: Details) -> float:
    """Share of the misfit that the stated causes close on further recordings of the same plan with the same effects.

    Noise and random effects are drawn anew. NaN where held-out data show next to no misfit, or samples are left out of these
    recordings.
    """
    gained = whole = dof = 0.0
    for draw in range(1, FURTHER_DRAWS + 1):
        model = prepare(drawn.world.record(drawn.settings, draw), DEFAULT, lambda text, share: None).model
        if any(one.columns.shape[0] != model.size for one in (*details.fitted, *details.beside)):
            continue
        held = predict_held_out(model, details.fitted, details.beside)
        squares = held.squares.sum(axis=0)
        gained, whole, dof = gained + float(squares[0] - squares[-1]), whole + float(squares[0]), dof + float(held.dof.sum())
    return gained / (whole - FLOOR * dof) if dof and whole > LEAST_MISFIT * FLOOR * dof else float("nan")


# ---- the study -------------------------------------------------------------------------------------------------------------


class WithheldConfig(StudyConfig):
    """What is drawn, and the table of another run that the report compares."""

    cases: int = 400
    entropy: int = 20261128
    compare: str = Field(default="", exclude=True)  # path of its table.parquet; no part of the study's identity


def make_recording(config: WithheldConfig, number: int, streams: Streams) -> Recording:
    """The recording of a case."""
    drawn = draw_case(config.entropy, number)
    return drawn.world.record(drawn.settings)


def run_case(config: WithheldConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Draw a case, diagnose its recording, and put both beside each other."""
    begun = time.process_time()
    drawn = draw_case(config.entropy, number)
    recording = drawn.world.record(drawn.settings)
    made = time.process_time()
    _reset_peak_memory()
    answer = diagnose(recording, library=drawn.allowed_names)
    cost = {"make_s": made - begun, "diagnose_s": time.process_time() - made, "peak_mb": _read_peak_memory()}
    return describe_case(drawn) | describe_answer(drawn, answer) | cost


def describe_case(drawn: DrawnCase) -> dict[str, Any]:
    """What was put in: columns of a row."""
    plain, truth = drawn.world.plan.plain, []
    for one in drawn.effects:
        described = {"effect": one.setting.effect, "axis": one.setting.axis, "size": one.setting.size}
        ratios = {"snr_attitude": one.attitude, "snr_samples": one.samples, "snr": one.snr}
        listed = one.setting.effect in (EFFECTS if drawn.allowed_names is None else drawn.allowed_names)
        truth.append(described | {"parameters": dict(one.setting.parameters), "listed": listed} | ratios)
    return {
        "kind": drawn.kind,
        "plan": drawn.world.plan.kind,
        "grade": drawn.world.plan.grade,
        "samples": len(plain.gyro.t_s),
        "references": len(plain.attitudes.t_s),
        "effects": " + ".join(one.label() for one in drawn.settings),
        "snr": min((one.snr for one in drawn.effects), default=np.nan),
        "snr_attitude": min((one.attitude for one in drawn.effects), default=np.nan),
        "snr_samples": min((one.samples for one in drawn.effects), default=np.nan),
        "truth": json.dumps(convert_to_plain(truth)),
    }


def describe_answer(drawn: DrawnCase, diagnosis: Diagnosis) -> dict[str, Any]:
    """What was answered, and what it is worth: columns of a row."""
    answer = diagnosis.to_json()
    verdict, causes = answer["verdict"], answer["causes"]
    present = bool(answer["gap"]["present"])
    judged = judge_causes(drawn, causes)
    closure = answer.get("closure") or {}
    low, high = closure.get("interval_90") or (np.nan, np.nan)
    hits = {hit for one in judged for hit in one["hits"]}
    return {
        "verdict": verdict,
        "said": " + ".join(one["cause"] for one in judged),
        "outcome": decide_outcome(drawn.kind, present, len(drawn.effects), judged, verdict),
        "found": sum(drawn.effects[hit].setting.effect in EFFECTS for hit in hits),
        "statements": json.dumps(convert_to_plain(judged)),
        "truth_score": score_truth(drawn, compute_scores(diagnosis.posterior)),
        "unknown_probability": answer["unknown_probability"],
        "p_value": answer["gap"]["p_value"],
        "size_sigmas": json.dumps(list_size_errors(drawn, causes)),
        "closed": closure.get("closed", np.nan),
        "closed_low": low,
        "closed_high": high,
        "true_closed": measure_true_share(drawn, diagnosis.details) if closure and drawn.effects else np.nan,
    }


def _reset_peak_memory() -> None:
    """Let the system count the peak memory anew; only Linux does."""
    if (place := Path("/proc/self/clear_refs")).exists():
        place.write_text("5")


def _read_peak_memory() -> float:
    """Peak memory since then, MB."""
    place = Path("/proc/self/status")
    lines = place.read_text().splitlines() if place.exists() else []
    found = [line.split()[1] for line in lines if line.startswith("VmHWM")]
    return float(found[0] if found else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024


STUDY = Study("studies.withheld.cases:STUDY", WithheldConfig, run_case, make_recording)
