"""Diagnosis of the raw sensor tables: fit under M0, which effects, how large, how far the gap closes.

The linear model is made twice: about M0, and, where there is a gap, about the amplitudes found, which are taken off the
measurements before the stretches are fitted again. An error of 0.2° leaves 0.0007° of second order, a hundredth of which would
be seen in thousands of measurements; after the second round 1e-6° is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import chdtrc

from diagnosis.answer import Cause, Closure, Finding, Verdict
from diagnosis.inference.attribution import Attribution, attribute
from diagnosis.inference.search import Search
from diagnosis.model.candidates import Bank
from diagnosis.sensors.candidates import GYRO, Held, held_error
from diagnosis.sensors.reduced import Reduced, bank, reduce
from diagnosis.sensors.refine import refined, widened
from diagnosis.sensors.rejected import orthogonal
from diagnosis.sensors.result import SensorDiagnosis
from diagnosis.sensors.search import LARGEST_SET, SensorSearch
from diagnosis.sensors.sizes import Sized, absorbed, closure, sized
from diagnosis.sensors.spans import Fitted, fit, fitted_all, spans
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects.sensor import SENSOR_EFFECTS

Array = NDArray[np.float64]

FALSE_ALARMS = 0.005
DRAWS = 400
LARGEST = 2.0  # times what is plausible
SHOWN = 12
WORTH_KEEPING = 1e-6
NOISE_P = 1e-4  # below it the noise is said to be more than stated
ANGLES = {0: ("penetration 1", "penetration 2", "penetration 3", "penetration 4"), 1: ("alpha", "beta"), 2: ("alpha", "beta")}
NAMES = {0: "ESA", 1: "DSS-1", 2: "DSS-2"}
COMMON = (
    "A rotation of all sensors together is an attitude error and cannot be seen; DSS-1 and the Earth sensor's model are the "
    "reference, so a misalignment of DSS-1 shows as one of DSS-2 and as biases of the Earth sensor"
)


def diagnose(recording: Recording, *, seed: int = 0, library: Sequence[str] | None = None) -> SensorDiagnosis:
    """Say whether the raw sensor tables depart from the nominal sensors, and by which effects.

    Parameters
    ----------
    recording : with raw sensor tables and an ephemeris
    seed : of the null distribution
    library : names of the sensor effects that may be named; all by default, others are passed over

    Raises
    ------
    InputError
        The tables cannot be used.
    """
    seen = examine(recording, seed=seed, library=library)
    model, attribution = seen.model, seen.attribution
    found = seen.found
    verdict, present, unknown = verdict_of(seen)
    closed: Closure | None = closure(seen.about_m0, model, LARGEST_SET) if found else None
    causes = tuple(
        Cause(
            one.effect, one.axis, one.size, one.unit, one.sigma, one.parameters, min(1.0, slot.probability),
            tuple(label for label, _ in slot.group), min(1.0, sum(p for _, p in slot.group)),
        )
        for one, slot in zip(found, attribution.slots if attribution is not None else (), strict=False)
    )  # fmt: skip
    rejected = orthogonal(seen.about_m0, model, seen.search, attribution.best, found) if attribution is not None else None
    held = {one.label: one.held for one in found}
    residuals = residual_table(seen.fits, held)
    return SensorDiagnosis(
        verdict=verdict,
        present=present,
        p_value=seen.p_value,
        false_alarm_rate=FALSE_ALARMS,
        mean_square=seen.about_m0.chi2 / seen.about_m0.dof,
        dof=seen.about_m0.dof,
        where=_where(seen.about_m0) if present else (),
        causes=causes,
        alternatives=_alternatives(attribution),
        unknown_probability=unknown,
        closure=closed,
        rejected=() if rejected is None else (rejected,),
        notes=(*_identifiable(model, found), COMMON, *_gyro_note(attribution), *seen.notes),
        residuals=residuals,
        explanations=_explanations(attribution),
    )


@dataclass(frozen=True)
class Examined:
    """What a diagnosis rests on.

    Attributes
    ----------
    fits : the stretches under M0
    about_m0, model : the linear model about M0, and about the amplitudes found
    search : with the candidates and observations of the model
    p_value, present : of a gap
    attribution : None without a gap
    found : effects of the best explanation with their sizes; none if it is none or not plausible
    notes : on what was left out
    """

    fits: list[Fitted]
    about_m0: Reduced
    model: Reduced
    search: SensorSearch
    p_value: float
    present: bool
    attribution: Attribution | None
    found: tuple[Sized, ...]
    notes: tuple[str, ...]


def examine(recording: Recording, *, seed: int = 0, library: Sequence[str] | None = None) -> Examined:
    """Fit, test and attribute; parameters and errors of `diagnose`."""
    usable, notes = spans(recording)
    fits, more = fitted_all(usable)
    allowed = tuple(SENSOR_EFFECTS) if library is None else tuple(name for name in SENSOR_EFFECTS if name in library)
    if not allowed:
        raise InputError("no sensor effect may be named")
    about_m0 = model = reduce(fits, allowed)
    search, scatter = searched(about_m0)
    p_value = p_of_gap(search, seed)
    attribution = attribute(search.bank, search.explanations()) if p_value < FALSE_ALARMS else None
    # Also for an unknown: the second order of what is listed must not look like another effect.
    listed = _listed_part(search, attribution) if attribution is not None else {}
    if listed:
        model = relinearised(fits, allowed, listed, model)
        search, scatter = searched(model)
        attribution = attribute(search.bank, search.explanations())
    found: tuple[Sized, ...] = ()
    if attribution is not None and attribution.slots:
        members = [slot.member for slot in attribution.slots]
        found = sized(model, {search.bank.candidates[one.candidate].label: one.option for one in members})
        found = tuple(_scaled(one, scatter) for one in widened(fits, found))
        if any(abs(one.size) > LARGEST * SENSOR_EFFECTS[one.effect].prior[1] for one in found):
            found = ()
    present = p_value < FALSE_ALARMS or scatter > 1
    if scatter > 1:
        more.append(f"The noise of the sensors is {scatter:.3f} times what is stated; evidence and sigmas are for the larger")
        p_value = min(p_value, NOISE_P)
    return Examined(fits, about_m0, model, search, p_value, present, attribution, found, (*notes, *more))


def searched(model: Reduced) -> tuple[SensorSearch, float]:
    """A search, and how many times the sensors' noise is what is stated; 1 unless it is surely more.

    The scatter is that of what all columns together, of effects and rivals, leave. Where it is more than stated, observations
    and columns are divided by it, or chance would pass for evidence.
    """
    candidates, y = bank(model)
    solved, _, rank, _ = np.linalg.lstsq(candidates.X, y, rcond=1e-9)
    chi2, dof = float(np.sum((y - candidates.X @ solved) ** 2)), model.dof - int(rank)
    if dof <= 0 or chdtrc(dof, chi2) >= NOISE_P:
        return SensorSearch(candidates, y), 1.0
    scatter = float(np.sqrt(chi2 / dof))
    X = candidates.X / scatter
    return SensorSearch(Bank(X, X, candidates.candidates), y / scatter), scatter


def _scaled(one: Sized, scatter: float) -> Sized:
    return replace(one, sigma=one.sigma * scatter, sigmas=one.sigmas * scatter)


def p_of_gap(search: Search, seed: int) -> float:
    """P-value of the evidence against M0: from draws, and where those end from the bound P(B ≥ c) ≤ 1/c."""
    observed = search.null_statistic(search.correlation[:, None])[0]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"sensor_diagnosis_null")))
    null = search.null_statistic(search.bank.X.T @ rng.standard_normal((len(search.bank.X), DRAWS)))
    simulated = (1 + int(np.sum(null >= observed))) / (1 + DRAWS)
    bound = float(np.exp(-max(observed, 0.0)))
    return max(min(simulated, bound) if bound < 1 / (1 + DRAWS) else simulated, 1e-300)


def relinearised(fits: Sequence[Fitted], library: Sequence[str], chosen: dict[str, int], model: Reduced) -> Reduced:
    """The model about the amplitudes of some effects (option by label) that a first model finds."""
    held = {one.label: one.held for one in sized(model, chosen)}
    limits = {label: LARGEST * SENSOR_EFFECTS[label.partition(":")[0]].prior[1] for label in held}
    held = {label: one for label, one in held.items() if np.linalg.norm(one.amplitudes) < limits[label]}
    held = refined(fits, held)
    again = [fit(one.span, *held_error(one.span.sightings, held)) for one in fits]
    return reduce(again, library, about=held)


def _listed_part(search: Search, attribution: Attribution) -> dict[str, int]:
    """Options of the listed effects of the likeliest explanation, by label."""
    entries = search.bank.candidates
    members = [(entries[member.candidate], member.option) for member in attribution.best.members]
    return {entry.label: option for entry, option in members if entry.listed}


def verdict_of(seen: Examined) -> tuple[Verdict, bool, float]:
    """Verdict, whether there is a gap, and the probability that something unlisted is at work."""
    attribution, found = seen.attribution, seen.found
    if attribution is None:
        return ("unknown", True, 1.0) if seen.present else ("none", False, 0.0)
    if attribution.ranked[0][0] == (GYRO,):  # no matter of the sensors
        return "none", False, 0.0
    if attribution.slots and not found:
        return "unknown", True, 1.0
    return attribution.verdict, True, float(attribution.unknown)


def _gyro_note(attribution: Attribution | None) -> tuple[str, ...]:
    if attribution is None or GYRO not in attribution.ranked[0][0]:
        return ()
    return ("The sensors' residuals look like a rate error of the gyro at orbit rate, which is no matter of the sensors",)


def _identifiable(model: Reduced, found: Sequence[Sized]) -> tuple[str, ...]:
    """What an orthogonal misalignment of the same sensor takes of a head's angles."""
    if not any(one.effect == "dss_head" and one.axis == "2" for one in found):
        return ()
    if "dss_misalignment" not in model.nameable:
        return ()
    shares = absorbed(model, "dss_head:2", ["dss_misalignment"])
    text = ", ".join(f"{100 * share:.0f} % of e{k}" for k, share in enumerate(shares, start=1))
    return (f"In these data an orthogonal misalignment of DSS-2 takes, in square, {text} of its β head; the rest it cannot",)


def residual_table(fits: Sequence[Fitted], held: dict[str, Held]) -> pd.DataFrame:
    """Residuals of all measurements under M0, and of a fit with some effects taken off the measurements."""
    parts = []
    for before in fits:
        span = before.span
        after = fit(span, *held_error(span.sightings, held)) if held else before
        for series, number, old, new in zip(span.series, span.numbers, before.residuals, after.residuals, strict=True):
            looked = span.sightings.sun_angles[span.sightings.sun_sensor == number] if number else None
            for k, angle in enumerate(ANGLES[number]):
                columns = {
                    "sensor": NAMES[number],
                    "angle": angle,
                    "interval": span.name,
                    "t_s": series.t,
                    "alpha_deg": np.nan if looked is None else np.rad2deg(looked[:, 0]),
                    "beta_deg": np.nan if looked is None else np.rad2deg(looked[:, 1]),
                    "before_deg": np.rad2deg(old[:, k]),
                    "after_deg": np.rad2deg(new[:, k]),
                }
                parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def _where(model: Reduced) -> tuple[Finding, ...]:
    """Tests of each sensor by itself: chi-square of the columns that a sensor's error may have, all else of M0 free."""
    gram = sum((part.gram for part in model.parts), np.zeros_like(model.parts[0].gram))
    findings = []
    for sensor, text, columns in _tested(model):
        inner, along = gram[np.ix_(columns, columns)], gram[columns, -1]
        values, vectors = np.linalg.eigh(inner)
        good = values > 1e-10 * values[-1]
        chi2 = float(np.sum((vectors[:, good].T @ along) ** 2 / values[good]))
        p = float(max(chdtrc(int(good.sum()), chi2), 1e-300))
        if p < FALSE_ALARMS:
            sentence = f"{text} (chi-square {chi2:.4g} of {int(good.sum())})"
            findings.append(Finding(sensor, None, None, None, "chi2", chi2, p, sentence))
    return tuple(sorted(findings, key=lambda one: -one.value))


def _tested(model: Reduced) -> list[tuple[str, str, NDArray[np.intp]]]:
    def columns(name: str) -> NDArray[np.intp]:
        own = [group for group in model.groups if group.effect == name]
        return np.unique(np.concatenate([np.arange(one.start, one.start + one.count) for one in own]))

    return [
        ("DSS-1", "residuals of DSS-1 follow where the Sun is in its field of view", columns("smooth error of DSS-1")),
        ("DSS-2", "residuals of DSS-2 follow where the Sun is in its field of view", columns("smooth error of DSS-2")),
        ("ESA", "quadrants of the Earth sensor are off by constants", model.sources["Earth sensor"]),
        ("ESA", "quadrants of the Earth sensor are off at the orbit's harmonics", columns("Earth sensor at orbit harmonics")),
        ("ESA", "quadrants of the Earth sensor are off near the Sun", columns("Earth sensor near the Sun")),
    ]


def _alternatives(attribution: Attribution | None) -> tuple[tuple[tuple[str, ...], float], ...]:
    if attribution is None:
        return ()
    chosen = {tuple(slot.group[0][0] for slot in attribution.slots)} if attribution.slots else set()
    return tuple((labels, p) for labels, p, _, _ in attribution.ranked[:SHOWN] if labels not in chosen and p > 1e-4)


def _explanations(attribution: Attribution | None) -> pd.DataFrame:
    ranked = [one for one in attribution.ranked if one[1] >= WORTH_KEEPING] if attribution is not None else []
    return pd.DataFrame.from_records(
        [(" + ".join(labels), p, evidence, unlisted) for labels, p, evidence, unlisted in ranked],
        columns=["effects", "probability", "log_evidence", "unlisted"],
    )
