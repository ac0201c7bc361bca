"""Scenarios with effects in them, and with the posterior of the effects' sizes: what a diagnosis has found, flown again.

A scenario file may hold, beside or in place of a plan of its own, three more tables:

- ``[replay]``: the plan is that of a recording, whose motion is simulated again (`simulator.replay`) with true_G and
  true_bias_deg_s. The folder is relative to the file; sha256 is that of the samples and references (`hash_recording`), so that
  sizes are not flown on data that have changed since they were found.
- ``[[effect]]``: name, axis where it has one, size in the effect's unit, parameters.
- ``[posterior]``: the covariance of all amplitudes, effect after effect in the file's order. The amplitudes a of an effect are
  those in which it is linear (`Effect.amplitudes`), such as size·cos φ and size·sin φ of a sine with free phase, so that
  a ~ N(a₀, C) is a posterior that a linear fit really has. A draw whose size is out of the effect's bounds is drawn again.

G and b are not drawn: whoever calibrates a flight finds them again, and its residuals do not depend on them.
"""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from gyrocal.errors import InputError
from gyrocal.recording import Recording, format_toml, format_validation_error
from gyrocal.recording import load as load_recording
from simulator import scenario as scenarios
from simulator.effects import REGISTRY, Setting, Surroundings, setting
from simulator.effects.base import Array
from simulator.replay import build_noise_free, reconstruct_motion
from simulator.scenario import Scenario, Section, Vector
from simulator.simulate import add_effects_and_noise, build_surroundings, make_noise_streams, motion, observe
from simulator.streams import generator
from simulator.truth.motion import Motion

MOST_SIZE_DRAWS = 1000  # draws that a size may be out of bounds
SYMMETRIC = 1e-9  # of the standard deviations' product
NEGATIVE = -1e-9  # eigenvalue of a correlation matrix that is more than rounding

Row = Annotated[tuple[float, ...], Field(strict=False)]


class ReplaySection(Section):
    """The recording whose motion is the plan, and the gyro that flies it."""

    recording: str = Field(min_length=1)
    sha256: str | None = None
    true_G: Annotated[tuple[Row, Row, Row], Field(strict=False)]
    true_bias_deg_s: Vector


class EffectSection(Section):
    """An effect with its numbers."""

    name: str
    axis: str | None = None
    size: float
    parameters: dict[str, float | int | str] = Field(default_factory=dict)


class PosteriorSection(Section):
    """Covariance of the amplitudes of all effects."""

    covariance: Annotated[tuple[Row, ...], Field(strict=False)]


class _Additions(Section):
    replay: ReplaySection | None = None
    effect: Annotated[tuple[EffectSection, ...], Field(strict=False)] = ()
    posterior: PosteriorSection | None = None


@dataclass(frozen=True)
class ReplayPlan:
    """A plan taken over from a recording: its motion, and the gyro that flies it."""

    recording: Recording  # whose tags, reference times, stated noises and tables a flight has
    G: Array  # (3, 3)
    bias: Array  # (3,) rad/s


@dataclass(frozen=True)
class AdoptedScenario:
    """A scenario with effects and their posterior."""

    title: str  # for people
    plan: Scenario | ReplayPlan  # a scenario, or a recording's
    effects: tuple[Setting, ...] = ()  # as stated
    covariance: Array | None = None  # (k, k) of all amplitudes; None if the file has no posterior

    @property
    def amplitudes(self) -> Array:
        """(k,) as stated, effect after effect."""
        return np.concatenate([np.empty(0), *(REGISTRY[effect.effect].amplitudes(effect) for effect in self.effects)])

    def replace_amplitudes(self, amplitudes: Array) -> tuple[Setting, ...]:
        """Set other amplitudes (k,) in the effects; an `InputError` for a size outside its effect's bounds."""
        out, start = [], 0
        for current in self.effects:
            effect = REGISTRY[current.effect]
            count = effect.amplitudes(current).size
            size, parameters = effect.from_amplitudes(amplitudes[start : start + count])
            out.append(setting(current.effect, current.axis, size, {**current.parameters, **parameters}))
            start += count
        return tuple(out)

    def draw_amplitudes(self, rng: np.random.Generator) -> Array:
        """Draw amplitudes (k,) from the posterior within the bounds of the sizes; the stated ones without a posterior."""
        if self.covariance is None or not self.effects:
            return self.amplitudes
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        fault: InputError | None = None
        for _ in range(MOST_SIZE_DRAWS):
            try:
                amplitudes = self.amplitudes + root @ rng.standard_normal(len(values))
                self.replace_amplitudes(amplitudes)
                return np.asarray(amplitudes)
            except InputError as error:
                fault = error
        raise InputError(
            f"{self.title}: {MOST_SIZE_DRAWS} draws from the posterior were all out of bounds, the last one: {fault}"
        )

    @cached_property
    def motion(self) -> Motion:
        """The noise-free motion: the costly part, and the same for every flight."""
        plan = self.plan
        return motion(plan) if isinstance(plan, Scenario) else reconstruct_motion(plan.recording, plan.G, plan.bias)

    @cached_property
    def _noise_free(self) -> tuple[Recording, Surroundings]:
        """The noise-free flight of a replay without effects, and what effects see of it."""
        assert isinstance(self.plan, ReplayPlan)
        noise_free = build_noise_free(self.plan.recording, self.motion, self.plan.G, self.plan.bias)
        return noise_free, build_surroundings(noise_free, self.motion)

    def fly(
        self, seed: int = 0, case: int = 0, effects: Sequence[Setting] | None = None, noise: bool = True, draw: bool = False
    ) -> Recording:
        """Simulate one flight, with the given effects in place of the stated, or with sizes drawn by a stream of the case."""
        if effects is None:
            drawn = self.draw_amplitudes(generator(seed, case, "posterior")) if draw else None
            effects = self.effects if drawn is None else self.replace_amplitudes(drawn)
        plan = self.plan
        gyro_rng, reference_rng = make_noise_streams(seed, case, noise)
        if isinstance(plan, ReplayPlan):
            noise_free, around = self._noise_free
            return add_effects_and_noise(noise_free, self.motion, effects, gyro_rng, reference_rng, seed, case, around=around)
        return observe(plan, self.motion, gyro_rng=gyro_rng, reference_rng=reference_rng, effects=effects, seed=seed, case=case)


def load(name_or_path: str | os.PathLike[str]) -> AdoptedScenario:
    """Load a scenario with what may stand beside it; any scenario is one without effects.

    Raises
    ------
    InputError
        One line: there is no such scenario, a fault by its path, or a recording that is not the one the sizes are from.
    """
    name = os.fspath(name_or_path)
    # A replay needs no scenario keys; and a base is merged first, so that an effect can be put into a built-in scenario.
    values = scenarios.load_document(name)
    tables = {key: values.pop(key) for key in scenarios.ADOPTED_TABLES if key in values}
    try:
        sections = _Additions.model_validate(tables)
    except ValidationError as error:
        raise InputError(f"{name}: {format_validation_error(error, _Additions)}") from None
    plan: Scenario | ReplayPlan
    if sections.replay is None:
        plan = scenarios.validate_scenario(values, name)
        title = plan.title
    else:
        title = str(values.pop("title", sections.replay.recording))
        if values:
            raise InputError(f"{name}: {', '.join(values)}: a replay takes its plan from the recording; leave it out")
        plan = _load_replay(sections.replay, Path(name).parent, name)
    effects = tuple(_build_setting(entry, name) for entry in sections.effect)
    scenario = AdoptedScenario(title, plan, effects)
    return replace(scenario, covariance=_read_covariance(sections.posterior, scenario.amplitudes.size, name))


def format_adopted(
    title: str, recording: str, digest: str, G: Array, bias: Array, effects: Sequence[Setting], covariance: Array
) -> str:
    """Format an adopted scenario as TOML; arguments as of the tables in the module's text, bias in rad/s."""
    lines = [f"title = {format_toml(title)}", "", "[replay]"]
    plan = {"recording": recording, "sha256": digest, "true_G": G.tolist(), "true_bias_deg_s": np.rad2deg(bias).tolist()}
    lines += [f"{key} = {format_toml(value)}" for key, value in plan.items()]
    for setting_of_effect in effects:
        lines += ["", "[[effect]]", f"name = {format_toml(setting_of_effect.effect)}"]
        if setting_of_effect.axis is not None:
            lines.append(f"axis = {format_toml(setting_of_effect.axis)}")
        lines.append(f"size = {format_toml(setting_of_effect.size)}  # {REGISTRY[setting_of_effect.effect].unit}")
        if setting_of_effect.parameters:
            parameters = ", ".join(f"{key} = {format_toml(value)}" for key, value in setting_of_effect.parameters.items())
            lines.append(f"parameters = {{ {parameters} }}")
    if effects:
        names = [effect.label() for effect in effects for _ in REGISTRY[effect.effect].amplitudes(effect)]
        lines += ["", "[posterior]", f"# of the amplitudes of {', '.join(names)}"]
        lines.append(f"covariance = {format_toml(covariance.tolist())}")
    return "\n".join([*lines, ""])


def hash_recording(recording: Recording) -> str:
    """Hash a recording's samples, references, stated noises and intervals as loaded from file, by SHA-256."""
    hashed = hashlib.sha256()
    gyro, attitudes = recording.gyro, recording.attitudes
    correlation = () if attitudes.correlation is None else (attitudes.correlation,)
    for values in (gyro.t_s, gyro.rates, attitudes.t_s, attitudes.quaternions, attitudes.sigma, *correlation):
        hashed.update(np.ascontiguousarray(values).tobytes())
    spans = [(interval.name, interval.start_s, interval.stop_s) for interval in recording.intervals]
    hashed.update(repr([gyro.sample_s, gyro.arw, *spans]).encode())
    return hashed.hexdigest()


def _load_replay(section: ReplaySection, folder: Path, name: str) -> ReplayPlan:
    recording = load_recording(folder / section.recording)
    if section.sha256 not in (None, hash_recording(recording)):
        raise InputError(
            f"{name}: replay.recording {section.recording} is not what it was when its effects were found; adopt it again"
        )
    G = np.array(section.true_G)
    if G.shape != (3, 3) or abs(np.linalg.det(G)) < scenarios.SMALLEST_DETERMINANT:
        raise InputError(f"{name}: replay.true_G must be 3×3 and invertible")
    return ReplayPlan(recording, G, np.deg2rad(section.true_bias_deg_s))


def _build_setting(section: EffectSection, name: str) -> Setting:
    if section.name in REGISTRY and REGISTRY[section.name].stage == "sensor":
        raise InputError(f"{name}: effect {section.name} acts on raw sensor tables, not on rates and references")
    try:
        return setting(section.name, section.axis, section.size, dict(section.parameters))
    except InputError as error:
        raise InputError(f"{name}: effect {error}") from None


def _read_covariance(section: PosteriorSection | None, size: int, name: str) -> Array | None:
    if section is None:
        return None
    try:
        values = np.array(section.covariance, dtype=float).reshape(len(section.covariance), -1)
    except ValueError:
        values = np.empty((0, 1))
    if values.shape != (size, size) and size:
        raise InputError(f"{name}: posterior.covariance must be {size}×{size}, a row for each amplitude of the effects")
    sigma = np.sqrt(np.maximum(np.diag(values), 0.0))
    scale = np.where(sigma > 0, sigma, 1.0)
    scaled = values / np.outer(scale, scale)
    if size and (np.abs(scaled - scaled.T).max() > SYMMETRIC or np.linalg.eigvalsh(scaled)[0] < NEGATIVE):
        raise InputError(f"{name}: posterior.covariance must be symmetric with no negative eigenvalue")
    return values
