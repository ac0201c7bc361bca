"""A whole diagnosis: samples, calibration, linear model, explanations, attribution, amplitudes, checks, closure, answer."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from diagnosis.answer import UNDECIDED, Finding
from diagnosis.assemble import build_diagnosis
from diagnosis.detectors.sample_report import IMPOSSIBLE, Symptom
from diagnosis.explain import explain_prepared
from diagnosis.inference.levels import Level
from diagnosis.model.prepare import Progress, prepare
from diagnosis.model.symptoms import SampleCause, list_sample_causes
from diagnosis.plan.invisible import find_invisible_effects
from diagnosis.posterior import combine_independent, join_explanations
from diagnosis.result import Diagnosis
from diagnosis.sensor_result import SensorDiagnosis
from diagnosis.sensor_tables import diagnose_sensors
from diagnosis.settings import DEFAULT, DiagnosisSettings
from diagnosis.verdict import decide_verdict
from gyrocal.errors import InputError
from gyrocal.masking import DataMask, find_mask
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from simulator.effects.base import Effect
from simulator.effects.sensor import ALL_EFFECTS, SENSOR_EFFECTS

LEVEL_SIGMA = 1e-6  # least relative sigma of the level of a clipped gyro


def diagnose(
    recording: Recording,
    *,
    progress: Progress | None = None,
    seed: int = 0,
    library: Sequence[str] | None = None,
    exclude: Sequence[tuple[float, float]] = (),
    settings: DiagnosisSettings = DEFAULT,
) -> Diagnosis:
    """Say whether a recording departs from M0, where, by which cause, and how far the gap shrinks with the cause in.

    An `InputError` if the recording cannot be used, or the library names an effect there is not.

    Parameters
    ----------
    recording : gyro stream and reference attitudes; raw tables of the sensors, if there are any, are diagnosed too
    progress : called with a text and the share done
    seed : of the null distribution
    library : names of the effects that may be named; all by default
    exclude : stretches to leave out, each from and to a time in s since the first gyro sample
    settings : thresholds and priors
    """
    tell = progress or (lambda text, share: None)
    began = time.perf_counter()
    # The matrices are small: threads of the linear algebra would wait for one another more than they work.
    with threadpool_limits(1, user_api="blas"):
        effects = list_nameable_effects(library)
        tell("gyro samples", 0.0)
        mask = find_mask(recording, exclude)
        usable = mask.apply(recording)
        prepared = prepare(usable, settings, tell)
        prepared, explained = explain_prepared(prepared, effects, settings, seed, tell)
        samples = (*list_sample_causes(prepared, effects, settings), *list_clipped_gyros(mask, effects))
        found = build_diagnosis(prepared, samples, explained, settings, time.perf_counter() - began)
        masked = tuple(mask.describe(recording))
        sigma = np.concatenate([found.sigma_G.ravel(), found.sigma_bias])
        invisible = find_invisible_effects(usable, found.G, found.bias, sigma)
        found = replace(found, invisible=invisible, mask=mask, masked=masked, masked_share=mask.compute_share(recording))
        found = doubt_sides(found, len(recording.intervals))
        return found if recording.sensors is None else add_sensor_findings(found, recording, library, settings, seed)


def doubt_sides(found: Diagnosis, intervals: int) -> Diagnosis:
    """Leave undecided whether the gyro makes a random error where references jump as often as a recording has intervals.

    References that jump by more than the misfit also drift by as much between the jumps, and a random walk of theirs is the
    same model as a random error of the rates that is short against an interval.
    """
    size = found.misfit_size
    jumps = [one for one in found.mask.stretches if one.what == "reference jump" and size and one.size >= size.added_deg]
    if len(jumps) < max(intervals, 1):
        return found
    causes = tuple(
        one
        if one.named or one.levels is None or one.levels.side.name != "gyro"
        else replace(one, levels=one.levels._replace(side=Level(UNDECIDED, one.levels.side.probability)))
        for one in found.causes
    )
    left = found.remainder
    left = replace(left, side=UNDECIDED) if left is not None and left.side == "gyro" else left
    return replace(found, causes=causes, remainder=left)


def list_clipped_gyros(mask: DataMask, effects: Sequence[Effect]) -> Iterator[SampleCause]:
    """List the gyros that the mask has found clipped as causes that the samples show by themselves."""
    name = next((effect.name for effect in effects if effect.symptom == "plateau"), None)
    for axis in "xyz":
        levels = np.abs([one.size for one in mask.stretches if one.what == "clipped" and one.axis == axis])
        if levels.size:
            size, sigma = float(np.median(levels)), float(max(np.std(levels), LEVEL_SIGMA * np.median(levels)))
            text = f"{levels.size} stretches of samples read the largest rate, {size:.4g} deg/s"
            symptom = Symptom("plateau", axis, size, "deg/s", sigma, {}, IMPOSSIBLE, text)
            finding = Finding("gyro stream", None, axis, None, "clipped_samples", float(levels.size), IMPOSSIBLE, text)
            yield SampleCause(symptom, name, finding)


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


def merge_answers(attitude: Diagnosis, sensors: SensorDiagnosis, settings: DiagnosisSettings) -> Diagnosis:
    """The result of both: a gap where either has one, the causes of both, and the verdict of all of it.

    Alternatives and closure are those of the gyro and the references if they show a gap, else those of the sensors.
    """
    present, causes = attitude.present or sensors.present, (*attitude.causes, *sensors.causes)
    unknown = combine_independent(attitude.unknown_probability, sensors.unknown_probability)
    verdict = decide_verdict(
        present, causes, unknown, settings,
        beside_remainder=attitude.verdict == "partial", blind="not identifiable" in (attitude.verdict, sensors.verdict),
    )  # fmt: skip
    leading = sensors if sensors.present and not attitude.present else attitude
    return replace(
        attitude,
        verdict=verdict,
        present=present,
        p_value=min(1.0, 2 * min(attitude.p_value, sensors.p_value)),
        false_alarm_rate=attitude.false_alarm_rate + sensors.false_alarm_rate,
        where=(*attitude.where, *sensors.where),
        causes=causes,
        alternatives=leading.alternatives,
        unknown_probability=unknown,
        closure=leading.closure,
        notes=(*sensors.notes, *attitude.notes),
        p_values={**attitude.p_values, "sensor tables": sensors.p_value},
        posterior=join_explanations(attitude.posterior, sensors.posterior),
        sensors=sensors,
    )
