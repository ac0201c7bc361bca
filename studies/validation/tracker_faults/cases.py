"""Drawing an effect of one star tracker, and what the diagnosis says of it.

Cases come in rounds of all plans and kinds, so that any number of rounds is balanced. The signal-to-noise ratio is √Δχ² of a
fit of what the effect did to these very references, G, b, the start attitudes and the mountings that are estimated beside it:
the norm of its whitened change with those projected out. Of white noise that is f times the stated one it is
√(n (f² − 1 − ln f²)), twice the expected log likelihood ratio of the n numbers of that tracker.

An effect is *named* if the answer has one cause and the effect of this tracker is among its alternatives; it is *alone* if
there is no other. It is *wrong* if a cause has not got it among its alternatives. What is neither is unknown, or not seen. The
library of the diagnosis is the whole one.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.optimize import brentq

from diagnosis.diagnose import diagnose
from diagnosis.model.linearise import linearised
from diagnosis.model.recording import RecordingModel
from gyrocal import attitude
from gyrocal.errors import InputError
from gyrocal.recording import Recording, triad
from simulator import scenario as scenarios
from simulator.effects import TRACKER_EFFECTS, Setting, setting
from simulator.effects.base import Surroundings, Value
from simulator.effects.common import log_uniform
from simulator.effects.tracker.base import TrackerEffect
from simulator.scenario import Scenario
from simulator.simulate import disturbed, motion, observe, surroundings, true_gyros, with_gyro_temperature
from simulator.truth.motion import Motion
from studies.montecarlo.study import Row, Streams, Study, StudyConfig
from studies.validation.gyro_faults.cases import alarmed

Array = NDArray[np.float64]
Range = Annotated[tuple[float, float], Field(strict=False)]

NONE = "none"
KINDS = (*TRACKER_EFFECTS, NONE)
DRAWS = 50
TETRAHEDRON = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
MOUNTING_SIGMA_DEG = 1e-3  # prior of the mounting that is estimated, and how far it is off


def _calm() -> list[dict[str, Any]]:
    """Three intervals that turn by 15 deg about x and y, and by 180 deg about z."""
    turns = [([1.0, 0.0, 0.0], 15.0, 300.0), ([0.0, 1.0, 0.0], 15.0, 300.0), ([0.0, 0.0, 1.0], 180.0, 900.0)]
    return [
        {
            "name": f"turn {k + 1}",
            "activity": "a turn, and on",
            "start_s": 2000.0 * k,
            "stop_s": 2000.0 * k + 1800.0,
            "mode": "+x",
            "slew": [{"axis": axis, "angle_deg": angle, "start_s": 400.0, "duration_s": lasts, "ramp_fraction": 0.2}],
        }
        for k, (axis, angle, lasts) in enumerate(turns)
    ]


PLANS: dict[str, dict[str, Any]] = {
    "agile": {},
    "dense": {"reference.every_s": 10.0},
    "calm": {"interval": _calm()},
    "four gyros": {"gyro.array": {"axes": TETRAHEDRON}},
    "mounting with a prior": {
        "reference.tracker.1.estimated": True,
        "reference.tracker.1.mounting_sigma_deg": [MOUNTING_SIGMA_DEG] * 3,
    },
}


class TrackerFaultsConfig(StudyConfig):
    """What is drawn.

    Attributes
    ----------
    entropy : other than that of the cases whose misses the diagnosis was mended by
    snr : range of the signal-to-noise ratio, log-uniform
    sample_s : of the gyro
    """

    cases: int = 140
    entropy: int = 2016
    snr: Range = (10.0, 60.0)
    sample_s: float = Field(default=1.0, gt=0)

    @model_validator(mode="after")
    def _own_scenarios(self) -> Self:
        if self.overrides or self.dispersions:
            raise ValueError("the scenarios are those of the study; change snr or sample_s")
        return self


@dataclass(frozen=True)
class World:
    """A plan without noise, and its linear model about the truth."""

    scenario: Scenario
    motion: Motion
    plain: Recording
    around: Surroundings
    model: RecordingModel

    def recording(
        self, one: Setting | None, streams: Streams | None, seed: int, case: int, turned_deg: tuple[float, ...] = ()
    ) -> Recording:
        """The plan with an effect, and with noise if there are streams.

        Parameters
        ----------
        turned_deg : three angles of the second tracker about its own axes, from the mounting that is stated
        """
        gyro, reference = (None if streams is None else streams.generator(f"{name}_noise") for name in ("gyro", "reference"))
        effects = [] if one is None else [one]
        if turned_deg:
            angles = dict(zip(("m_x_arcsec", "m_y_arcsec", "m_z_arcsec"), (3600 * x for x in turned_deg), strict=True))
            size = 3600 * float(np.linalg.norm(turned_deg))
            effects.append(setting("tracker_misalignment", self.plain.attitudes.sensors[1].name, size, angles))
        return disturbed(self.plain, self.motion, effects, gyro, reference, seed, case, around=self.around)

    def snr(self, one: Setting, seed: int, case: int) -> float:
        """Of what an effect does to the references."""
        moved, plain = self.recording(one, None, seed, case).attitudes, self.plain.attitudes
        A, B = (attitude.matrix_from_quaternion(values.quaternions) for values in (moved, plain))
        error = attitude.residual(A, B)[self.model.reference_rows]
        return float(np.linalg.norm(self.model.prepared(self.model.reference_error(error[:, :, None])[:, 0])))


@lru_cache(maxsize=len(PLANS))
def world(plan: str, sample_s: float) -> World:
    """A plan."""
    scenario = scenarios.override(scenarios.load("agile_trackers"), {"gyro.sample_s": sample_s, **PLANS[plan]})
    flown = motion(scenario)
    plain = with_gyro_temperature(observe(scenario, flown, gyro_rng=None, reference_rng=None))
    if plain.is_array:
        model = linearised(triad(plain, *true_gyros(scenario)), np.eye(3), np.zeros(3))
    else:
        model = linearised(plain, np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))
    return World(scenario, flown, plain, surroundings(plain, flown), model)


def set_up(number: int) -> tuple[str, str]:
    """Plan and kind of a case."""
    return list(PLANS)[number % len(PLANS)], KINDS[number // len(PLANS) % len(KINDS)]


def drawn(
    here: World, kind: str, limits: tuple[float, float], rng: np.random.Generator, seed: int, case: int
) -> Setting | None:
    """An effect of a tracker; none where its mounting is estimated and it is that.

    Raises
    ------
    InputError
        No draw reaches the signal-to-noise ratio with a plausible size.
    """
    seen = here.around.references.trackers
    assert seen is not None
    if kind == NONE:
        return None
    effect = TRACKER_EFFECTS[kind]
    assert isinstance(effect, TrackerEffect)
    estimated = [one.name for one in here.plain.attitudes.sensors if one.estimated]
    there = [name for name in effect.trackers(seen) if kind != "tracker_misalignment" or name not in estimated]
    for _ in range(DRAWS if there else 0):
        name, target = str(rng.choice(there)), log_uniform(rng, *limits)
        if effect.implements("noise_factor"):
            rows = here.plain.attitudes.sensor == seen.names.index(name)
            share = target**2 / (3 * int(np.sum(rows)))
            size = float(np.sqrt(brentq(lambda v, share=share: v - 1 - np.log(v) - share, 1.0, 10.0 + 2 * share)))
            return setting(kind, name, size)
        _, parameters = effect.draw(rng, here.around)
        one = effect.completed(setting(kind, name, effect.prior[0], parameters | _direction(effect, rng)))
        factor = target / here.snr(one, seed, case)
        if one.size * factor <= effect.prior[1]:
            return _larger(one, factor * (1.0 if effect.bounds[0] >= 0 else float(rng.choice([-1.0, 1.0]))))
    if there:
        raise InputError(f"{kind}: no SNR of {limits[0]:g} to {limits[1]:g} with a plausible size in {DRAWS} draws")
    return None


def _direction(effect: Any, rng: np.random.Generator) -> dict[str, Value]:
    """Numbers of an effect of several angles, and one of the words of its choices."""
    directions = getattr(effect, "directions", ())
    out: dict[str, Value] = {one.name: float(rng.normal()) for one in directions}
    words = [one for one in effect.parameters if one.choices and "*" not in one.choices]
    return out | {one.name: str(rng.choice(one.choices)) for one in words}


def _larger(one: Setting, factor: float) -> Setting:
    """An effect times a factor; that of several angles has a positive size."""
    effect = TRACKER_EFFECTS[one.effect]
    size, held = effect.from_amplitudes(factor * effect.amplitudes(one))
    return replace(one, size=size, parameters={**one.parameters, **held})


def case(config: TrackerFaultsConfig, number: int, streams: Streams) -> Row:
    """What was drawn and what was said."""
    plan, kind = set_up(number)
    here = world(plan, config.sample_s)
    one = drawn(here, kind, config.snr, streams.generator("effect"), config.entropy, number)
    recording = made(config, here, one, number, streams)
    start = time.process_time()
    found = diagnose(recording)
    took = time.process_time() - start
    label = one.label() if one else ""
    noisy = one is not None and TRACKER_EFFECTS[one.effect].implements("noise_factor")
    groups = [cause.group for cause in found.causes]
    return {
        "plan": plan,
        "effect": one.effect if one else NONE,
        "tracker": str(one.axis) if one else "",
        "size": one.size if one else 0.0,
        "parameters": _numbers(one) if one else "",
        "snr": np.nan if one is None or noisy else here.snr(one, config.entropy, number),
        "verdict": found.verdict,
        "alarm": alarmed(found),
        "said": "; ".join(", ".join(group) for group in groups),
        "unknown_probability": found.unknown_probability,
        "named": len(groups) == 1 and label in groups[0],
        "alone": len(groups) == 1 and groups[0] == (label,),
        "wrong": any(label not in group for group in groups),
        "size_in_sigma": _off(found.causes[0], one) if one and len(groups) == 1 and groups[0] == (label,) else np.nan,
        "cpu_s": took,
    }


def _numbers(one: Setting) -> str:
    """Its parameters, to be read."""
    return ", ".join(
        f"{name}={value:.4g}" if isinstance(value, float) else f"{name}={value}" for name, value in one.parameters.items()
    )


def _off(cause: Any, one: Setting) -> float:
    """Error of the size that was found, in its sigma."""
    return float((cause.size - one.size) / cause.sigma)


def made(config: TrackerFaultsConfig, here: World, one: Setting | None, number: int, streams: Streams) -> Recording:
    """The recording of a case; a mounting that is estimated is off as its prior says."""
    prior = here.plain.attitudes.sensors[1].mounting_sigma
    turned = () if prior is None else tuple(np.rad2deg(prior * streams.generator("mounting").standard_normal(3)).tolist())
    return here.recording(one, streams, config.entropy, number, turned)


def recording(config: TrackerFaultsConfig, number: int, streams: Streams) -> Recording:
    """The recording of one case."""
    plan, kind = set_up(number)
    here = world(plan, config.sample_s)
    one = drawn(here, kind, config.snr, streams.generator("effect"), config.entropy, number)
    return made(config, here, one, number, streams)


STUDY = Study("studies.validation.tracker_faults.cases:STUDY", TrackerFaultsConfig, case, recording)
