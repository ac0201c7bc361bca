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
    """Diagnose whether a recording departs from M0, where, by which cause, and how much of the misfit that cause removes.

    Raises an `InputError` if the recording cannot be used, or the library names an unknown effect.

    Parameters
    ----------
    recording : gyro stream and reference attitudes; raw tables of the sensors, if there are any, are diagnosed too
    progress : called with a text and the share done
    seed : of the null distribution
    library : names of the effects that may be named; all by default
    exclude : stretches to leave out, each from and to a time in s since the first gyro sample
    settings : thresholds and priors
    """
    report_progress = progress or (lambda text, share: None)
    began = time.perf_counter()
    # The matrices are small: threads of the linear algebra would wait for one another more than they work.
    with threadpool_limits(1, user_api="blas"):
        effects = list_nameable_effects(library)
        report_progress("gyro samples", 0.0)
        mask = find_mask(recording, exclude)
        usable = mask.apply(recording)
        prepared = prepare(usable, settings, report_progress)
        prepared, explained = explain_prepared(prepared, effects, settings, seed, report_progress)
        samples = (*list_sample_causes(prepared, effects, settings), *list_clipped_gyros(mask, effects))
        diagnosis = build_diagnosis(prepared, samples, explained, settings, time.perf_counter() - began)
        masked = tuple(mask.describe(recording))
        sigma = np.concatenate([diagnosis.sigma_G.ravel(), diagnosis.sigma_bias])
        invisible = find_invisible_effects(usable, diagnosis.G, diagnosis.bias, sigma)
        share = mask.compute_share(recording)
        diagnosis = replace(diagnosis, invisible=invisible, mask=mask, masked=masked, masked_share=share)
        diagnosis = doubt_sides(diagnosis, len(recording.intervals))
        return diagnosis if recording.sensors is None else add_sensor_findings(diagnosis, recording, library, settings, seed)


def doubt_sides(diagnosis: Diagnosis, intervals: int) -> Diagnosis:
    """Set the side of random errors from gyro to undecided where references jump at least once for each interval.

    References that jump by more than the misfit also drift by as much between the jumps, and their random walk is the same
    model as a random error of the rates that is short against an interval.
    """
    size = diagnosis.misfit_size
    jumps = [stretch for stretch in diagnosis.mask.stretches if stretch.what == "reference jump"]
    jumps = [stretch for stretch in jumps if size and stretch.size >= size.added_deg]
    if len(jumps) < max(intervals, 1):
        return diagnosis
    causes = tuple(
        cause
        if cause.named or cause.levels is None or cause.levels.side.name != "gyro"
        else replace(cause, levels=cause.levels._replace(side=Level(UNDECIDED, cause.levels.side.probability)))
        for cause in diagnosis.causes
    )
    remainder = diagnosis.remainder
    remainder = replace(remainder, side=UNDECIDED) if remainder is not None and remainder.side == "gyro" else remainder
    return replace(diagnosis, causes=causes, remainder=remainder)


def list_clipped_gyros(mask: DataMask, effects: Sequence[Effect]) -> Iterator[SampleCause]:
    """List the gyros that the mask found clipped as causes that the samples show by themselves."""
    name = next((effect.name for effect in effects if effect.symptom == "plateau"), None)
    for axis in "xyz":
        levels = np.abs([stretch.size for stretch in mask.stretches if stretch.what == "clipped" and stretch.axis == axis])
        if levels.size:
            size, sigma = float(np.median(levels)), float(max(np.std(levels), LEVEL_SIGMA * np.median(levels)))
            text = f"{levels.size} stretches of samples read the largest rate, {size:.4g} deg/s"
            symptom = Symptom("plateau", axis, size, "deg/s", sigma, {}, IMPOSSIBLE, text)
            finding = Finding("gyro stream", None, axis, None, "clipped_samples", float(levels.size), IMPOSSIBLE, text)
            yield SampleCause(symptom, name, finding)


def list_nameable_effects(library: Sequence[str] | None) -> list[Effect]:
    """List the effects that may be identified; `InputError` for an unknown name."""
    unknown = [] if library is None else [name for name in library if name not in ALL_EFFECTS]
    if unknown:
        raise InputError(f"no such effect: {', '.join(sorted(unknown))}; there are {', '.join(ALL_EFFECTS)}")
    return [effect for name, effect in EFFECTS.items() if library is None or name in library]


def add_sensor_findings(
    diagnosis: Diagnosis, recording: Recording, library: Sequence[str] | None, settings: DiagnosisSettings, seed: int
) -> Diagnosis:
    """Add what the raw sensor tables show to an answer; parameters as of `diagnose`."""
    began = time.perf_counter()
    effects = [effect for name, effect in SENSOR_EFFECTS.items() if library is None or name in library]
    try:
        sensors = diagnose_sensors(recording, effects, settings, seed)
    except InputError as error:
        return replace(diagnosis, notes=(*diagnosis.notes, f"The raw sensor tables were not looked at: {error}"))
    return replace(merge_answers(diagnosis, sensors, settings), runtime_s=diagnosis.runtime_s + time.perf_counter() - began)


def merge_answers(attitude: Diagnosis, sensors: SensorDiagnosis, settings: DiagnosisSettings) -> Diagnosis:
    """Merge both answers: a misfit where either has one, the causes of both, and the verdict on all causes.

    Alternatives and closure are those of the gyro and the references if they show a misfit, else those of the sensors.
    """
    present, causes = attitude.present or sensors.present, (*attitude.causes, *sensors.causes)
    unknown = combine_independent(attitude.unknown_probability, sensors.unknown_probability)
    verdict = decide_verdict(
        present, causes, unknown, settings,
        has_remainder=attitude.verdict == "partial", blind="not identifiable" in (attitude.verdict, sensors.verdict),
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
