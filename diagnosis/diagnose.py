"""A whole diagnosis: samples, calibration, linear model, explanations, attribution, amplitudes, checks, closure, answer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits

from diagnosis.assemble import build_diagnosis
from diagnosis.detectors.stream_faults import find_faults, remove_faults
from diagnosis.explain import AttitudeInference, explain_prepared
from diagnosis.merge import merge_answers
from diagnosis.model.fault_causes import convert_faults
from diagnosis.model.prepare import PreparedRecording, Progress, prepare
from diagnosis.model.symptoms import list_sample_causes
from diagnosis.result import Diagnosis
from diagnosis.sensor_tables import diagnose_sensors
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from simulator.effects.base import Effect, Fault
from simulator.effects.sensor import ALL_EFFECTS, SENSOR_EFFECTS


def diagnose(
    recording: Recording,
    *,
    progress: Progress | None = None,
    seed: int = 0,
    library: Sequence[str] | None = None,
    settings: DiagnosisSettings = DEFAULT,
) -> Diagnosis:
    """Say whether a recording departs from M0, where, by which cause, and how far the gap shrinks with the cause in.

    Parameters
    ----------
    recording : gyro stream and reference attitudes; raw tables of the sensors, if there are any, are diagnosed too
    progress : called with a text and the share done
    seed : of the null distribution
    library : names of the effects that may be named; all by default
    settings : thresholds and priors

    Raises
    ------
    InputError
        The recording cannot be used, or the library names an effect there is not.
    """
    tell = progress or (lambda text, share: None)
    began = time.perf_counter()
    # The matrices are small: threads of the linear algebra would wait for one another more than they work.
    with threadpool_limits(1, user_api="blas"):
        effects = list_nameable_effects(library)
        tell("gyro samples", 0.0)
        faults = find_faults(recording, effects)
        usable = remove_faults(recording, faults)
        prepared, explained = explain_prepared(prepare(usable, settings, tell), effects, settings, seed, tell)
        found = compose_diagnosis(prepared, explained, effects, settings, time.perf_counter() - began, faults)
        return found if recording.sensors is None else add_sensor_findings(found, recording, library, settings, seed)


def compose_diagnosis(
    prepared: PreparedRecording,
    explained: AttitudeInference,
    effects: Sequence[Effect],
    settings: DiagnosisSettings,
    runtime_s: float,
    faults: Sequence[Fault] = (),
) -> Diagnosis:
    """Make the answer of what samples and attitude show, and of faults taken out before; parameters as of `diagnose`."""
    samples = (*list_sample_causes(prepared, effects, settings), *convert_faults(faults))
    return build_diagnosis(prepared, samples, explained, settings, runtime_s)


def list_nameable_effects(library: Sequence[str] | None) -> list[Effect]:
    """The effects that may be named."""
    unknown = [] if library is None else [name for name in library if name not in ALL_EFFECTS]
    if unknown:
        raise InputError(f"no such effect: {', '.join(sorted(unknown))}; there are {', '.join(ALL_EFFECTS)}")
    return [effect for name, effect in EFFECTS.items() if library is None or name in library]


def add_sensor_findings(
    found: Diagnosis, recording: Recording, library: Sequence[str] | None, settings: DiagnosisSettings, seed: int
) -> Diagnosis:
    """Add what the raw sensor tables show to an answer; parameters as of `diagnose`."""
    began = time.perf_counter()
    effects = [effect for name, effect in SENSOR_EFFECTS.items() if library is None or name in library]
    try:
        sensors = diagnose_sensors(recording, effects, settings, seed)
    except InputError as error:
        return replace(found, notes=(*found.notes, f"The raw sensor tables were not looked at: {error}"))
    return replace(merge_answers(found, sensors, settings), runtime_s=found.runtime_s + time.perf_counter() - began)
