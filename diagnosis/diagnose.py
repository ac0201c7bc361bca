"""A whole diagnosis: stream, preparation, where, which, how far."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence, Set
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from diagnosis.answer import Cause, Closure, Finding, Verdict
from diagnosis.detectors.report import StreamCause, StreamReport
from diagnosis.inference import localization as where
from diagnosis.inference.amplitudes import Fitted, calibrated, fit
from diagnosis.inference.attribution import NAMED, Attribution, Slot, attribute
from diagnosis.inference.candidates import Bank, build, with_fine_steps
from diagnosis.inference.closure import closure
from diagnosis.inference.search import Member, Search, total
from diagnosis.inference.unshown import is_of_the_zone, without_unshown
from diagnosis.model.prepare import Prepared, prepare
from diagnosis.model.recording import Model
from diagnosis.result import Details, Diagnosis
from diagnosis.sensors import diagnose as diagnose_sensors
from diagnosis.sensors.merge import merged
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from simulator.effects.sensor import ALL_EFFECTS

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

FALSE_ALARMS = 0.002  # of the attitude test
DRAWS = 1000  # of M0 for the null distribution
SHOWN_EXPLANATIONS = 12
WORTH_KEEPING = 1e-6  # an explanation of less probability is left out of the details
SURE = 0.5  # probability that only unshown motion is at work, from which on nothing else is said of the attitude
MOST_CERTAIN = 0.96  # of a cause: of 573 statements surer than that in four blind runs 548 were right
LEAST_WEIGHT = 0.005  # of an explanation in the prediction of a fold
LARGEST = 2.0  # times what is plausible: a larger size is no answer


def diagnose(
    recording: Recording,
    *,
    progress: Progress | None = None,
    seed: int = 0,
    library: Sequence[str] | None = None,
) -> Diagnosis:
    """Say whether a recording departs from M0, where, by which cause, and how far the gap shrinks with the cause in.

    Parameters
    ----------
    recording : gyro stream and reference attitudes; raw tables of the sensors, if there are any, are diagnosed too
    progress : called with a text and the share done
    seed : of the null distribution
    library : names of the effects that may be named; all by default

    Raises
    ------
    InputError
        The recording cannot be used, or the library names an effect there is not.
    """
    # The matrices are small: threads of the linear algebra would wait for one another more than they work.
    with threadpool_limits(1, user_api="blas"):
        found = _diagnosed(recording, progress, seed, library)
        return found if recording.sensors is None else _with_sensors(found, recording, seed, library)


def _with_sensors(found: Diagnosis, recording: Recording, seed: int, library: Sequence[str] | None) -> Diagnosis:
    began = time.perf_counter()
    try:
        sensors = diagnose_sensors(recording, seed=seed, library=library)
    except InputError as error:
        return replace(found, notes=(*found.notes, f"The raw sensor tables were not looked at: {error}"))
    return replace(merged(found, sensors), runtime_s=found.runtime_s + time.perf_counter() - began)


def _diagnosed(recording: Recording, progress: Progress | None, seed: int, library: Sequence[str] | None) -> Diagnosis:
    began = time.perf_counter()
    tell = progress or (lambda text, share: None)
    chosen = set(EFFECTS) if library is None else set(library)
    if not chosen <= set(ALL_EFFECTS):
        raise InputError(f"no such effect: {', '.join(sorted(chosen - set(ALL_EFFECTS)))}; there are {', '.join(ALL_EFFECTS)}")
    allowed = chosen & set(EFFECTS)
    tell("gyro stream", 0.0)
    prepared = prepare(recording)
    model = prepared.model
    tell("candidates", 0.1)
    bank = build(model, sorted(allowed), dead=prepared.dead)
    search = Search(bank, model.y)
    tell("null distribution", 0.4)
    p_attitude = attitude_p_value(model, search, seed)
    seen = _certain(prepared)
    named_streams = [cause for cause in seen if cause.effect in allowed]
    unnamed_streams = [cause for cause in seen if cause.effect not in allowed]
    tell("explanations", 0.5)
    attribution = (
        _attributed(bank, search, {"xyz"[zone.stretches.axis] for zone in prepared.zones})
        if p_attitude < FALSE_ALARMS
        else None
    )
    tell("sizes and closure", 0.8)
    members = tuple(slot.member for slot in attribution.slots) if attribution is not None else ()
    fitted = fit(model, bank, model.y, members) if members else []
    if attribution is not None and (turned := _without_leads(bank, attribution, fitted)) is not attribution:
        attribution = turned
        members = tuple(slot.member for slot in attribution.slots)
    if attribution is not None and not _plausible(bank, members, fitted):
        attribution, members, fitted = replace(attribution, verdict="unknown", slots=(), unknown=1.0), (), []
    change, covariance = calibrated(model, fitted)
    closed = _closure(model, bank, members)
    named_streams = [cause for cause in named_streams if not _is_correlation(prepared, cause, bank, members)]
    return _assembled(
        recording, prepared, bank, attribution, members, fitted, named_streams, unnamed_streams, p_attitude, closed,
        change, covariance, began,
    )  # fmt: skip


def attitude_p_value(model: Model, search: Search, seed: int) -> float:
    """P-value of the attitude evidence: from draws of M0, and where those end from the bound P(B ≥ c) ≤ 1/c."""
    observed = search.null_statistic(search.correlation[:, None])[0]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"diagnosis_null")))
    draws = model.projected(rng.standard_normal((model.size, DRAWS)))
    null = search.null_statistic(search.bank.X.T @ draws)
    simulated = (1 + int(np.sum(null >= observed))) / (1 + DRAWS)
    bound = float(np.exp(-max(observed, 0.0)))
    return max(min(simulated, bound) if bound < 1 / (1 + DRAWS) else simulated, 1e-300)


def _attributed(bank: Bank, search: Search, unshown: Set[str]) -> Attribution | None:
    """The causes of a gap in the attitude; None if it is what gyros with a dead zone do not show of the motion."""
    explanations, nothing = without_unshown(bank, search.explanations(), unshown)
    return attribute(bank, explanations) if nothing < SURE else None


def _plausible(bank: Bank, members: tuple[Member, ...], fitted: list[Fitted]) -> bool:
    """Whether every effect has a size that such an effect can have."""
    effects = [EFFECTS[bank.candidates[member.candidate].effect] for member in members]
    large = any(abs(one.size) > LARGEST * effect.prior[1] for effect, one in zip(effects, fitted, strict=True))
    leads = any(effect.name == "rate_lag" and one.size < -3 * one.sigma for effect, one in zip(effects, fitted, strict=True))
    return not large and not leads


def _without_leads(bank: Bank, attribution: Attribution, fitted: list[Fitted]) -> Attribution:
    """A reading cannot lead what it shows: a negative lag is an offset of the tags, which has the same column."""
    offset = bank.find("time_offset")
    slots = []
    for slot, one in zip(attribution.slots, fitted, strict=True):
        own = {bank.candidates[slot.member.candidate].effect, *(label for label, _ in slot.group)}
        if one.size < 0 and offset is not None and own >= {"rate_lag", "time_offset"}:
            group = tuple((label, p) for label, p in slot.group if label not in ("rate_lag", "time_offset"))
            together = min(1.0, sum(p for label, p in slot.group if label in ("rate_lag", "time_offset")))
            member = Member(offset, 0, min(slot.member.scale, bank.candidates[offset].scales.size - 1))
            slots.append(Slot(member, together, (("time_offset", together), *group)))
        else:
            slots.append(slot)
    if tuple(slots) == attribution.slots:
        return attribution
    sure = all(slot.probability >= NAMED for slot in slots)
    return replace(attribution, slots=tuple(slots), verdict="named" if sure else attribution.verdict)


def _closure(model: Model, bank: Bank, members: tuple[Member, ...]) -> Closure | None:
    if not members:
        return None
    random = any(EFFECTS[bank.candidates[m.candidate].effect].is_process for m in members)
    # The evidence of a dead zone in the samples comes from all intervals; a fold may only use what it has.
    chosen = {bank.candidates[m.candidate].effect for m in members}
    listed = _listed_only(bank, {"rate_deadzone"} - chosen)

    for member in members:
        # Steps are tried finely around the time found; each fold still has to choose among all times.
        label = bank.candidates[member.candidate].label
        place = listed.find(label)
        assert place is not None
        listed = with_fine_steps(model, listed, place, member.option)

    def choose(fold: Search) -> Sequence[tuple[float, Sequence[Member]]]:
        found = fold.explanations(depth=len(members))
        top = total(found)
        weights = [float(np.exp(one.log_posterior - top)) for one in found]
        likely = [(w, one.members) for w, one in zip(weights, found, strict=True) if w > LEAST_WEIGHT]
        return [(w * share, at) for w, members in likely for share, at in fold.over_times(members)]

    return closure(model, listed, choose, random)


def _listed_only(bank: Bank, without: Set[str]) -> Bank:
    """The bank without the rivals and some effects: a fold only asks which listed effects predict."""
    candidates, places, start = [], [], 0
    for candidate in bank.candidates:
        if not candidate.listed or candidate.effect in without:
            continue
        options = []
        for option in candidate.options:
            places.append(np.arange(option.start, option.start + option.count))
            options.append(replace(option, start=start))
            start += option.count
        candidates.append(replace(candidate, options=tuple(options)))
    chosen = np.concatenate(places)
    return Bank(bank.W[:, chosen], bank.X[:, chosen], tuple(candidates))


def _assembled(
    recording: Recording,
    prepared: Prepared,
    bank: Bank,
    attribution: Attribution | None,
    members: tuple[Member, ...],
    fitted: list[Fitted],
    streams: list[StreamCause],
    unnamed: list[StreamCause],
    p_attitude: float,
    closed: Closure | None,
    change: Array,
    covariance: Array,
    began: float,
) -> Diagnosis:
    model = prepared.model
    p_stream = min((cause.p_value for cause in [*streams, *unnamed]), default=1.0)
    present = p_attitude < FALSE_ALARMS or bool(streams) or bool(unnamed)
    causes = [_stream_cause(cause) for cause in streams]
    if attribution is not None:
        for slot, numbers in zip(attribution.slots, fitted, strict=True):
            entry = bank.candidates[slot.member.candidate]
            causes.append(
                Cause(
                    entry.effect, entry.axis, numbers.size, entry.unit, numbers.sigma, numbers.parameters,
                    min(MOST_CERTAIN, slot.probability), tuple(label for label, _ in slot.group),
                    min(MOST_CERTAIN, sum(p for _, p in slot.group)),
                )
            )  # fmt: skip
    unknown = attribution.unknown if attribution is not None else 0.0
    verdict: Verdict
    if not present:
        verdict = "none"
    elif attribution is not None and attribution.verdict == "unknown":
        verdict = "unknown"
    elif unnamed:  # also beside a cause, which it may have imitated
        verdict, unknown = "unknown", 1.0
    elif attribution is not None:
        verdict = attribution.verdict
    else:
        verdict = "named"
    table = where.statistics(model, model.y)
    found: list[Finding] = [_stream_finding(prepared.stream, cause) for cause in [*streams, *unnamed]]
    if p_attitude < FALSE_ALARMS:
        found += where.findings(table)
    G = model.G + change[:9].reshape(3, 3)
    bias = model.bias + change[9:]
    sigma = np.sqrt(np.diag(covariance))
    return Diagnosis(
        recording=recording.title,
        verdict=verdict,
        present=present,
        p_value=float(min(p_attitude, p_stream)),
        false_alarm_rate=FALSE_ALARMS,
        where=tuple(found),
        causes=tuple(causes),
        alternatives=_alternatives(attribution),
        unknown_probability=float(unknown),
        closure=closed,
        G=G,
        bias=bias,
        sigma_G=sigma[:9].reshape(3, 3),
        sigma_bias=sigma[9:],
        baseline_G=model.G,
        baseline_bias=model.bias,
        notes=(*_likely(bank, attribution), *prepared.notes),
        runtime_s=time.perf_counter() - began,
        details=_details(prepared, bank, attribution, fitted, members, table),
    )


def _stream_cause(cause: StreamCause) -> Cause:
    label = cause.effect if cause.axis is None else f"{cause.effect}:{cause.axis}"
    probability = min(MOST_CERTAIN, 1.0 - min(cause.p_value * 1e3, 0.04))
    return Cause(
        cause.effect, cause.axis, cause.size, cause.unit, cause.sigma, cause.parameters, probability, (label,), probability
    )


def _is_correlation(prepared: Prepared, cause: StreamCause, bank: Bank, members: tuple[Member, ...]) -> bool:
    """Whether noise of the references beyond the stated is the correlated error that is named about the same axis.

    Second differences of an error with a short time constant are those of noise.
    """
    axes = {bank.candidates[m.candidate].axis for m in members if bank.candidates[m.candidate].effect == "reference_correlated"}
    noise = prepared.reference_noise
    if cause.effect != "reference_noise_excess" or noise is None or not axes:
        return False
    return cause.axis in axes or (cause.axis is None and "xyz"[int(np.argmax(noise.factor))] in axes)


def _certain(prepared: Prepared) -> list[StreamCause]:
    """What samples and reference noise show by themselves."""
    zones = {"xyz"[zone.stretches.axis]: zone for zone in prepared.zones}
    gyro = prepared.model.recording.gyro
    noise = float(np.rad2deg(gyro.arw / np.sqrt(gyro.sample_s)))
    found = [
        cause
        for cause in prepared.stream.causes
        if cause.axis not in zones or not is_of_the_zone(cause, zones[cause.axis].size, noise)
    ]
    for zone in prepared.zones:
        p = float(np.exp(-min(zone.log_odds, 600.0)))
        found.append(StreamCause("rate_deadzone", "xyz"[zone.stretches.axis], zone.size, "deg/s", zone.sigma, {}, p))
    return found + _reference_cause(prepared)


def _reference_cause(prepared: Prepared) -> list[StreamCause]:
    """The references' noise, where it is not what is stated."""
    noise = prepared.reference_noise
    if noise is None or not noise.departs:
        return []
    axis = None if noise.axis is None else "xyz"[noise.axis]
    place = 0 if noise.axis is None else noise.axis
    sigma = float(1 / np.sqrt(np.sum(1 / noise.sigma**2))) if noise.axis is None else float(noise.sigma[place])
    size = float(noise.factors[place])
    return [StreamCause("reference_noise_excess", axis, size, "factor", sigma, {}, noise.p_value)]


def _stream_finding(report: StreamReport, cause: StreamCause) -> Finding:
    if cause.effect == "reference_noise_excess":
        text = f"second differences of the references scatter {cause.size:.2f} times as much as stated"
        return Finding("attitude", None, cause.axis, None, "reference_noise", cause.size, cause.p_value, text)
    tests = [t for t in report.tests if t.effect == cause.effect and cause.axis in (None, t.axis)]
    if cause.effect == "rate_deadzone" and not any(t.p_value < 1e-5 for t in tests):
        text = "mean readings of slow rates are zero, or outside of the zone, and rates are missing from the attitude"
        return Finding("gyro stream", None, cause.axis, None, "slow_readings", cause.size, cause.p_value, text)
    tests = tests or [t for t in report.tests if t.effect == "rate_quantization"]
    test = min(tests, key=lambda t: t.p_value)
    return Finding("gyro stream", None, cause.axis, None, test.statistic, test.value, test.p_value, test.text)


def _likely(bank: Bank, attribution: Attribution | None) -> tuple[str, ...]:
    """Of an unknown gap: effects that nearly every explanation holds, though none of them is the whole story."""
    if attribution is None or attribution.verdict != "unknown":
        return ()
    shares: dict[str, float] = {}
    for labels, probability, _, _ in attribution.ranked:
        for label in labels:
            shares[label] = shares.get(label, 0.0) + probability
    listed = {candidate.label for candidate in bank.candidates if candidate.listed}
    return tuple(
        f"Whatever else is at work, {label} is part of explanations with a total probability of {share:.2f}"
        for label, share in sorted(shares.items(), key=lambda pair: -pair[1])
        if label in listed and share >= NAMED
    )


def _alternatives(attribution: Attribution | None) -> tuple[tuple[tuple[str, ...], float], ...]:
    if attribution is None:
        return ()
    chosen = set()
    if attribution.slots:
        chosen = {tuple(slot.group[0][0] for slot in attribution.slots)}
    return tuple(
        (labels, p) for labels, p, _, _ in attribution.ranked[:SHOWN_EXPLANATIONS] if labels not in chosen and p > 1e-4
    )


def _details(
    prepared: Prepared,
    bank: Bank,
    attribution: Attribution | None,
    fitted: list[Fitted],
    members: tuple[Member, ...],
    table: pd.DataFrame,
) -> Details:
    model = prepared.model
    explained = sum((model.projected(f.contribution) for f in fitted), np.zeros(model.size))
    before, band = where.body_residuals(model, model.y)
    after, _ = where.body_residuals(model, model.y - explained)
    names = np.array([model.recording.intervals[block.interval].name for block in model.blocks])
    interval = names[model.interval_of_reference]
    residuals = pd.DataFrame({"interval": interval, "t_s": model.references.t_s})
    for label, values in (("before", before), ("band", band), ("after", after)):
        for k, axis in enumerate("xyz"):
            residuals[f"{label}_{axis}"] = np.rad2deg(values[:, k])
    regressors = []
    for member, numbers in zip(members, fitted, strict=True):
        own = model.projected(numbers.contribution)
        others = explained - own
        effect, _ = where.body_residuals(model, own)
        left, _ = where.body_residuals(model, model.y - others)
        for k, axis in enumerate("xyz"):
            regressors.append(
                pd.DataFrame(
                    {
                        "cause": bank.candidates[member.candidate].label,
                        "interval": interval,
                        "axis": axis,
                        "t_s": model.references.t_s,
                        "regressor_deg": np.rad2deg(effect[:, k]),
                        "residual_deg": np.rad2deg(left[:, k]),
                    }
                )
            )
    columns = ["cause", "interval", "axis", "t_s", "regressor_deg", "residual_deg"]
    ranked = [one for one in attribution.ranked if one[1] >= WORTH_KEEPING] if attribution is not None else []
    explanations = pd.DataFrame.from_records(
        [(" + ".join(labels), p, evidence, unlisted) for labels, p, evidence, unlisted in ranked],
        columns=["effects", "probability", "log_evidence", "unlisted"],
    )
    stream = pd.DataFrame.from_records(
        [(t.statistic, t.axis, t.value, t.expected, t.p_value, t.text) for t in prepared.stream.tests],
        columns=["statistic", "axis", "value", "expected", "p_value", "text"],
    )
    return Details(
        residuals=residuals,
        statistics=table,
        regressors=pd.concat(regressors, ignore_index=True) if regressors else pd.DataFrame(columns=columns),
        explanations=explanations,
        stream=stream,
    )
