"""Drawing a fault of one gyro, and what the diagnosis says of it.

Cases come in rounds of all set-ups and kinds of fault, so that any number of rounds is balanced. The signal-to-noise ratio is
√Δχ² of a fit of the fault alone, the twelve or 4n parameters and the start attitudes beside it: the norm of what it adds to
the whitened parity and attitude, G, b, K and c projected out. Of a noise that is f times the stated one it is
√(n (f² − 1 − ln f²)), twice the expected log likelihood ratio of n samples. A dead gyro's is as large as the motion makes it.

The gyro is *named* if all that the diagnosis says of gyros is of that one: the alternatives of every cause, and the findings,
which tell a gyro also where its fault may be on no list. The *kind* is named if it is among the alternatives as well. The
library of the diagnosis is the whole one.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.optimize import brentq

from diagnosis.diagnose import diagnose
from diagnosis.model.gyros import ArrayModel
from diagnosis.model.linearise import linearised
from diagnosis.model.parity import parity_model
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
    entropy : other than that of the cases whose misses the diagnosis was mended by
    snr : range of the signal-to-noise ratio, log-uniform
    references_s : time between reference attitudes, where there are any
    sample_s : of the gyros
    """

    cases: int = 400
    entropy: int = 2014
    snr: Range = (8.0, 60.0)
    references_s: float = Field(default=1200.0, gt=0)
    sample_s: float = Field(default=0.5, gt=0)

    @model_validator(mode="after")
    def _own_scenarios(self) -> Self:
        if self.overrides or self.dispersions:
            raise ValueError("the scenarios are those of the study; change snr, references_s or sample_s")
        return self


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
def world(array: str, references_s: float, sample_s: float) -> World:
    """A set-up; references_s is zero without reference attitudes."""
    more: dict[str, Scalar] = {"reference.every_s": references_s} if references_s else {"reference.at": "none"}
    scenario = scenarios.override(scenarios.load(SCENARIOS[array]), {"gyro.sample_s": sample_s, **more})
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
    here = world(array, config.references_s if references else 0.0, config.sample_s)
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
        time_s = float(any_step_time(rng, model.around))
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
    found_in = {str(one.axis) for one in found.where} & set(here.truth.names)
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
        "found": ", ".join(sorted(found_in)),
        "named": {*found_in, *of_causes(groups)} == {fault.gyro},
        "kind": any(f"{KINDS[kind]}:{fault.gyro}" in group for group in groups),
        "wrong": bool(found_in - {fault.gyro}) or any(fault.gyro not in of_causes([group]) for group in groups),
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


def of_causes(groups: Sequence[Sequence[str]]) -> set[str]:
    """The gyros of all alternatives, as effect:gyro."""
    return {label.rpartition(":")[2] for group in groups for label in group}


STUDY = Study("studies.validation.gyro_faults.cases:STUDY", GyroFaultsConfig, case, recording)
