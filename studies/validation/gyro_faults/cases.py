"""Drawing a fault of one gyro, and what the diagnosis says of it.

Cases come in rounds of all set-ups and kinds of fault, so that any number of rounds is balanced. The signal-to-noise ratio is
√Δχ² of a fit of the fault alone, the twelve or 4n parameters and the start attitudes beside it: the norm of what it adds to
the whitened parity and attitude, G, b, K and c projected out. Of a noise that is f times the stated one it is
√(n (f² − 1 − ln f²)), twice the expected log likelihood ratio of n samples. A dead gyro's is as large as the motion makes it.

A fault is *named* if the gyro is told: every alternative of every cause that is stated is one of that gyro, and its kind among
them. The library of the diagnosis is the whole one.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import brentq

from diagnosis.diagnose import diagnose
from diagnosis.model.gyros import ArrayModel
from diagnosis.model.parity import parity_model
from diagnosis.model.recording import linearised
from diagnosis.result import Diagnosis
from gyrocal import GyroArray, calibrate_gyros
from gyrocal.errors import InputError
from gyrocal.recording import Recording, triad
from gyrocal.recording.gyros import gain
from simulator import scenario as scenarios
from simulator.effects import ARRAY_EFFECTS, EFFECTS, Setting, setting
from simulator.effects.common import any_step_time, log_uniform
from simulator.effects.gyros import columns_of
from simulator.scenario import Scenario
from simulator.simulate import motion, observe, true_gyros
from simulator.truth.motion import Motion
from studies.montecarlo.study import Row, Scalar, Streams, Study, StudyConfig

Array = NDArray[np.float64]
Range = Annotated[tuple[float, float], Field(strict=False)]

SIX, FOUR = "six", "tetrahedron"
SETUPS = ((SIX, False), (SIX, True), (FOUR, True), (FOUR, False))  # gyros, whether there are reference attitudes
SCENARIOS = {SIX: "trmm_six", FOUR: "trmm_tetrahedron"}
NONE = "none"
KINDS = {"step": "bias_step", "scale": "gyro_scale_step", "noise": "noise_excess", "dead": "gyro_dead", NONE: ""}
DRAWS = 200


class GyroFaultsConfig(StudyConfig):
    """What is drawn.

    Attributes
    ----------
    snr : range of the signal-to-noise ratio, log-uniform
    references_s : time between reference attitudes, where there are any
    overrides : of all the set-ups' scenarios
    """

    cases: int = 400
    snr: Range = (8.0, 60.0)
    references_s: float = Field(default=1200.0, gt=0)
    overrides: dict[str, Scalar] = {"gyro.sample_s": 4.0}  # noqa: RUF012  # pydantic copies it


@dataclass(frozen=True)
class World:
    """A set-up without noise, and its linear model about the truth."""

    scenario: Scenario
    motion: Motion
    truth: GyroArray
    model: ArrayModel

    def snr(self, gyro: int, of_samples: Array, of_steps: Array | None) -> float:
        """Of a reading of one gyro that is high by so much in each sample, and in each step of the attitude, rad/s."""
        model = self.model
        parity = model.parity.reading(gyro, model.parity.means(of_samples)[:, None])
        attitude = None
        if model.body is not None and of_steps is not None:
            turned = model.step_gains[:, :, gyro, None] * of_steps[:, None, None]
            attitude = model.body.whitened(model.body.reading(turned))
        return float(np.linalg.norm(model.projected(model.stacked(attitude, parity, 1))))


@lru_cache(maxsize=len(SETUPS))
def world(array: str, references_s: float, overrides: tuple[tuple[str, Scalar], ...]) -> World:
    """A set-up; references_s is zero without reference attitudes."""
    more: dict[str, Scalar] = {"reference.every_s": references_s} if references_s else {"reference.at": "none"}
    scenario = scenarios.override(scenarios.load(SCENARIOS[array]), {**dict(overrides), **more})
    flown = motion(scenario)
    plain = observe(scenario, flown, gyro_rng=None, reference_rng=None)
    K, c = true_gyros(scenario)
    truth = GyroArray(plain.gyro.names, K, c)
    parity = parity_model(plain, truth, np.full(len(c), plain.gyro.arw))
    assert parity is not None
    body = linearised(triad(plain, K, c), np.eye(3), np.zeros(3)) if references_s else None
    gains = np.stack([gain(K, np.arange(len(c)))] * len(plain.intervals))
    return World(scenario, flown, truth, ArrayModel(plain, parity, body, gains))


@dataclass(frozen=True)
class Fault:
    """One gyro's fault; no setting is none."""

    gyro: str
    setting: Setting | None
    snr: float


def set_up(config: GyroFaultsConfig, number: int) -> tuple[World, str, bool, str]:
    """The world of a case, its gyros, whether there are references, and the kind of fault."""
    array, references = SETUPS[number % len(SETUPS)]
    kind = list(KINDS)[number // len(SETUPS) % len(KINDS)]
    here = world(array, config.references_s if references else 0.0, tuple(sorted(config.overrides.items())))
    return here, array, references, kind


def drawn(here: World, kind: str, limits: tuple[float, float], rng: np.random.Generator) -> Fault:
    """A fault of a gyro.

    Raises
    ------
    InputError
        No draw reaches the signal-to-noise ratio with a plausible size.
    """
    if kind == NONE:
        return Fault("", None, 0.0)
    known = {**EFFECTS, **ARRAY_EFFECTS}
    effect, names, model = known[KINDS[kind]], here.truth.names, here.model
    for _ in range(DRAWS):
        gyro, target = int(rng.integers(len(names))), log_uniform(rng, *limits)
        if kind == "noise":
            share = target**2 / model.parity.t_s.size
            size = float(np.sqrt(brentq(lambda v, share=share: v - 1 - np.log(v) - share, 1.0, 10.0 + 2 * share)))
            return Fault(names[gyro], setting(effect.name, names[gyro], size), target)
        time_s = any_step_time(rng, model.around)
        if kind == "dead":
            size, snr = _dead(here, gyro, time_s, bool(rng.random() < 0.5))
            if snr >= limits[0]:
                return Fault(names[gyro], setting(effect.name, names[gyro], size, {"time_s": time_s}), snr)
            continue
        streams = (model.stream, None if model.body is None else model.body_stream)
        high = [None if one is None else columns_of(effect, one, gyro, {"time_s": time_s})[:, 0] for one in streams]
        assert high[0] is not None
        size = target / here.snr(gyro, high[0], high[1])
        if effect.prior[0] <= size <= effect.prior[1]:
            signed = size * float(rng.choice([-1.0, 1.0]))
            return Fault(names[gyro], setting(effect.name, names[gyro], signed, {"time_s": time_s}), target)
    raise InputError(f"{kind}: no SNR of {limits[0]:g} to {limits[1]:g} with a plausible size in {DRAWS} draws")


def _dead(here: World, gyro: int, time_s: float, frozen: bool) -> tuple[float, float]:
    """Reading in deg/s of a gyro that dies, at zero or at what it read last, and its SNR."""
    model, truth = here.model, here.truth
    own = model.stream.raw[:, gyro]
    held = float(own[np.searchsorted(model.stream.t_s, time_s) - 1]) if frozen else 0.0
    high = [
        None if one is None else np.where(one.t_s >= time_s, held - (one.rates @ truth.K[gyro] + truth.c[gyro]), 0.0)
        for one in (model.stream, None if model.body is None else model.body_stream)
    ]
    assert high[0] is not None
    return float(np.rad2deg(held)), here.snr(gyro, high[0], high[1])


def observed(config: GyroFaultsConfig, number: int, streams: Streams, faulty: bool = True) -> tuple[Recording, Fault]:
    """The recording of a case, and its fault; the same noise without the fault if asked for."""
    here, _, _, kind = set_up(config, number)
    fault = drawn(here, kind, config.snr, streams.generator("fault"))
    seen = observe(
        here.scenario,
        here.motion,
        gyro_rng=streams.generator("gyro_noise"),
        reference_rng=streams.generator("reference_noise"),
        effects=[fault.setting] if fault.setting is not None and faulty else [],
        seed=config.entropy,
        case=number,
    )
    return seen, fault


def recording(config: GyroFaultsConfig, number: int, streams: Streams) -> Recording:
    """The recording of one case."""
    return observed(config, number, streams)[0]


def case(config: GyroFaultsConfig, number: int, streams: Streams) -> Row:
    """What was drawn and what was said; NEES of the calibration of the same recording without the fault."""
    here, array, references, kind = set_up(config, number)
    seen, fault = observed(config, number, streams)
    start = time.process_time()
    found = diagnose(seen)
    took = time.process_time() - start
    groups = [cause.group for cause in found.causes]
    row = {
        "gyros": array,
        "references": references,
        "fault": kind,
        "gyro": fault.gyro,
        "snr": fault.snr,
        "size": fault.setting.size if fault.setting else 0.0,
        "time_s": float(fault.setting.parameters.get("time_s", np.nan)) if fault.setting else np.nan,
        "verdict": found.verdict,
        "alarm": alarmed(found),
        "said": "; ".join(", ".join(group) for group in groups),
        "named": named(groups, KINDS[kind], fault.gyro),
        "wrong": wrong(groups, fault.gyro),
        "among": any(f"{KINDS[kind]}:{fault.gyro}" in group for group in groups),
        "nees": np.nan,
        "cpu_s": took,
    }
    if references:
        sound = calibrate_gyros(observed(config, number, streams, faulty=False)[0], iterations=2)
        error = sound.gyros.vector - here.truth.vector
        row["nees"] = float(error @ np.linalg.solve(sound.covariance, error))
    return row


def alarmed(found: Diagnosis) -> bool:
    """Whether a diagnosis says that something is wrong."""
    return found.present or found.verdict != "none"


def named(groups: Sequence[Sequence[str]], effect: str, gyro: str) -> bool:
    """Whether all alternatives of all causes are of the faulty gyro, and the fault is among them."""
    labels = [label for group in groups for label in group]
    return bool(gyro) and f"{effect}:{gyro}" in labels and {label.rpartition(":")[2] for label in labels} == {gyro}


def wrong(groups: Sequence[Sequence[str]], gyro: str) -> bool:
    """Whether some cause has no alternative that is of the faulty gyro."""
    return any(gyro not in {label.rpartition(":")[2] for label in group} for group in groups)


STUDY = Study("studies.validation.gyro_faults.cases:STUDY", GyroFaultsConfig, case, recording)
