"""From a recording to its linearisation about its own calibration under M0.

The samples are examined first, since a clipped or repeated sample spoils every test of the attitude. White noise that is not
as stated, of the samples or of the references, is an effect of its own; it is found here, and the model then has the actual
noise. Whether a line in the samples is a vibration or a motion of the body is decided by the attitude
(`diagnosis.model.lines`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.deadzone import DeadZoneEvidence, dead_zone_evidence, of_zero_samples, usual_slow_rate
from diagnosis.detectors.reference_noise import ReferenceNoise, ReferenceSeries, reference_noise
from diagnosis.detectors.report import SampleReport, inside
from diagnosis.detectors.samples import examine, smoothed_rates
from diagnosis.model.gate import check_residuals
from diagnosis.model.linearise import linearised
from diagnosis.model.lines import judged_lines
from diagnosis.model.recording import RecordingModel
from diagnosis.model.tones.fast import fast_tone
from diagnosis.model.tones.tone import UNLISTED, without
from diagnosis.model.tracker_noise import alike, series_of
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.calibration.gate import LargeResidualError
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.sampling import measurements
from gyrocal.errors import InputError
from gyrocal.recording import Interval, Recording, reference_rows
from simulator.effects.timing import delay_columns

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

AXES = "xyz"
ITERATIONS = 10
MOST_TONES = 3  # of the references, beyond their averages
SETTLED = 1e-3  # sigmas of the last correction
CLEARLY = 12.0  # of χ², by which the attitude decides how readings came onto a lattice
LIKELY = 1.0  # log odds of a dead zone from the samples, from which on its axis is left out of tests that it would mislead
MOST_SHORT = 200  # stretches between two references that a calibration starts from, where whole intervals lead too far astray
FEWEST_SHORT = 6
SETTLED_SHORT = 1e-6  # of G
IMPLAUSIBLE = np.array([0.2] * 9 + [np.deg2rad(0.1)] * 3)  # changes of G and b, rad/s
UNSEEN = 0.5  # of its plausible range: a parameter less certain than that is not observed


@dataclass(frozen=True)
class Prepared:
    """A recording ready for the attitude tests.

    Attributes
    ----------
    model : linearised about the calibration, on the repaired stream
    samples : what the samples showed
    sigma : (12,) of the calibration under M0: G_xx … G_zz, b_x … b_z (rad/s)
    reference_noise : test of the references' noise, None without a series of them
    dead : gyros that read zero for long, and may have a dead zone
    notes : limits of this recording
    tracker_noise : the test of the references' noise for each of several sensors, by name
    """

    model: RecordingModel
    samples: SampleReport
    sigma: Array
    reference_noise: ReferenceNoise | None
    dead: tuple[DeadZoneEvidence, ...]
    notes: tuple[str, ...]
    tracker_noise: tuple[tuple[str, ReferenceNoise], ...] = ()

    @property
    def is_white(self) -> bool:
        """Whether the readings have white noise; those on a lattice coarser than it have errors that are not."""
        return not (self.samples.lattice | self.samples.hidden).any()


def prepare(recording: Recording, settings: DiagnosisSettings = DEFAULT, tell: Progress = lambda text, share: None) -> Prepared:
    """Examine the samples, calibrate under M0 by Gauss–Newton on the linear model, and linearise there.

    Parameters
    ----------
    recording : what was recorded
    settings : thresholds
    tell : called with a text and the share done of a whole diagnosis

    Raises
    ------
    InputError
        The stream does not cover the intervals, or nothing is left of them.
    """
    _check_samples(recording)
    report, (model, sigma, pieces) = _readable(recording, settings, tell)
    if report.undecided:
        cut = examine(recording, lattice="cut", settings=settings, tell=_examined(tell, "once more, cut", 0.06, 0.08))
        try:
            other = _first(recording, cut)
            gain = _misfit(model) - _misfit(other[0])
        except LargeResidualError:
            other, gain = None, -np.inf
        if other is not None and gain > CLEARLY:
            report, (model, sigma, pieces) = cut, other
        elif gain > -CLEARLY:
            report.symptoms = [
                replace(one, rivals=(("lattice_cut", 0.5),)) if one.kind == "lattice_rounded" else one
                for one in report.symptoms
            ]
    dead = _dead(recording, report, model.bias)
    likely = {one.axis for one in dead if one.log_odds > LIKELY}
    count = max(len(report.lines), 1)
    if judged_lines(report, model, likely, lambda done: tell("gyro samples: lines and references", 0.08 + 0.01 * done / count)):
        report.smooth = smoothed_rates(report.rates, recording)
        model, sigma = _calibrated(recording, report, pieces, recording.attitudes.sigma)
    tell("gyro samples: fast tones of the references", 0.09)
    recording, model, sigma = _without_tones(recording, report, pieces, model, sigma, settings)
    tell("gyro samples: noise of the references", 0.095)
    found = [
        (name, _reference_noise(model, report, dead, settings, number))
        for number, name in ([(None, None)] if recording.attitudes.sensor is None else _named(recording))
    ]
    factors = np.ones(recording.attitudes.sigma.shape)
    owner = np.zeros(len(factors), dtype=np.intp) if recording.attitudes.sensor is None else recording.attitudes.sensor
    for number, (_, noise) in enumerate(found):
        if noise is not None and noise.departs:
            factors[owner == number] = noise.factors
    if (factors != 1.0).any():
        model, sigma = _calibrated(recording, report, pieces, recording.attitudes.sigma * factors)
    of_all = next((noise for name, noise in found if name is None), None)
    of_each = tuple((name, noise) for name, noise in found if name is not None and noise is not None)
    return Prepared(model, report, sigma, of_all, dead, _notes(recording, pieces, sigma), of_each)


def _without_tones(
    recording: Recording,
    report: SampleReport,
    pieces: tuple[Interval, ...],
    model: RecordingModel,
    sigma: Array,
    settings: DiagnosisSettings,
) -> tuple[Recording, RecordingModel, Array]:
    """The recording without the tones that only all references show, its model and the sigma of that; they are symptoms."""
    if (report.lattice | report.hidden).any():
        return recording, model, sigma
    for _ in range(MOST_TONES):
        tone = fast_tone(model, report.rates, settings.sample_event, settings.unlisted_share)
        if tone is None:
            break
        report.symptoms.append(tone.symptom(settings.group_share, settings.unknown))
        if report.symptoms[-1].kind == UNLISTED:
            break
        recording, report.rates = without(recording, report.rates, tone.listed[0][0])
        model, sigma = _calibrated(recording, report, pieces, recording.attitudes.sigma)
    return recording, model, sigma


def check_usable(recording: Recording, settings: DiagnosisSettings = DEFAULT) -> None:
    """Raise an `InputError` where `prepare` would, without its tests of lines and noise, which take most of its time."""
    _check_samples(recording)
    _readable(recording, settings, lambda text, share: None)


def _check_samples(recording: Recording) -> None:
    if inside(recording).sum() < 2 * len(recording.intervals):
        measurements(recording)  # says which interval lacks samples
    if not inside(recording).any():
        raise InputError("no gyro sample starts inside any interval")


def _named(recording: Recording) -> list[tuple[int | None, str | None]]:
    return [(number, one.name) for number, one in enumerate(recording.attitudes.sensors)]


def _reference_noise(
    model: RecordingModel,
    report: SampleReport,
    dead: tuple[DeadZoneEvidence, ...],
    settings: DiagnosisSettings,
    sensor: int | None = None,
) -> ReferenceNoise | None:
    """The test of the references' noise, where no gyro hides motion between two references, which would look like it.

    Of one of several sensors it is made about its own axes.
    """
    blind = set(np.flatnonzero(report.hidden | report.lattice).tolist())
    silent = np.zeros(report.rates.shape, dtype=bool)
    for one in dead:
        silent[:, one.axis] |= (one.part >= 0) & (one.log_odds > LIKELY)
    recording, density = model.recording, np.median(report.density, axis=0)
    if sensor is not None:
        axes = recording.attitudes.sensors[sensor].M
        hidden = np.repeat(np.asarray(silent).any(axis=1).reshape(-1, 1), 3, axis=1)
        found = reference_noise(series_of(model, sensor), axes**2 @ density, recording.gyro.t_s, hidden, settings)
        return found if found is not None and not blind and alike(found) else None
    times = model.references.t_s
    series = ReferenceSeries(
        t_s=times,
        interval=model.interval_of_reference,
        sigma=recording.attitudes.sigma[model.reference_rows],
        to_inertial=model.at_reference,
        residuals=model.residuals,
        rates=model.rates[np.clip(np.searchsorted(model.t_s, times), 0, model.t_s.size - 1)],
    )
    noise = reference_noise(series, density, recording.gyro.t_s, silent, settings)
    if noise is not None and noise.odd:
        noise = reference_noise(series, density, recording.gyro.t_s, silent, settings, model.turned_by(_with_motion(model)))
    return None if noise is not None and (noise.axis in blind or len(blind) == 3) else noise


def _with_motion(model: RecordingModel) -> Array:
    """(n, 3, k) errors of readings that follow the motion: each rate on each axis, its size and its square, and its change."""
    raw = model.raw
    own = np.zeros((len(raw), 3, 15))
    for axis in range(3):
        own[:, axis, 3 * axis : 3 * axis + 3] = raw
        own[:, axis, 9 + axis] = np.abs(raw[:, axis])
        own[:, axis, 12 + axis] = raw[:, axis] ** 2
    return np.concatenate([own, delay_columns(model.stream)], axis=2)


def _readable(
    recording: Recording, settings: DiagnosisSettings, tell: Progress
) -> tuple[SampleReport, tuple[RecordingModel, Array, tuple[Interval, ...]]]:
    """What the samples show and the first model, with readings on a lattice taken in the way in which they fit at all."""
    tell("gyro samples: noise, lines, outliers", 0.01)
    report = examine(recording, settings=settings, tell=_examined(tell, "", 0.01, 0.06))
    tell("gyro samples: first calibration", 0.06)
    try:
        return report, _first(recording, report)
    except LargeResidualError:
        kinds = {symptom.kind for symptom in report.symptoms if symptom.kind.startswith("lattice")}
        if not kinds:
            raise
        way: Literal["rounded", "cut"] = "rounded" if "lattice_cut" in kinds else "cut"
        other = examine(recording, lattice=way, settings=settings, tell=_examined(tell, f"once more, {way}", 0.06, 0.07))
        return other, _first(recording, other)


def _examined(tell: Progress, way: str, begin: float, stop: float) -> Progress:
    """Progress of a look at the samples, as a part of all."""
    before = f"gyro samples: {way}: " if way else "gyro samples: "
    return lambda text, share: tell(before + text, begin + (stop - begin) * share)


def _first(recording: Recording, report: SampleReport) -> tuple[RecordingModel, Array, tuple[Interval, ...]]:
    """The model with the references as stated, its sigma, and the intervals it is propagated over."""
    pieces = unclipped(recording, report)
    if not pieces:
        raise InputError("no two reference attitudes are left with unclipped gyro samples between them")
    return *_calibrated(recording, report, pieces, recording.attitudes.sigma), pieces


def _misfit(model: RecordingModel) -> float:
    return float(model.y @ model.y)


def _dead(recording: Recording, report: SampleReport, bias: Array) -> tuple[DeadZoneEvidence, ...]:
    """Gyros that may have a dead zone; a lattice makes zeros of its own."""
    coarse = {symptom.axis for symptom in report.symptoms if symptom.kind.startswith("lattice")}
    if None in coarse:
        return ()
    exact = {symptom.axis: symptom for symptom in report.symptoms if symptom.kind == "dead_zone"}
    biases = np.maximum(np.abs(bias), np.abs(recording.gyro.apriori_bias))
    usual = usual_slow_rate(recording, report.rates, biases)
    found = [
        one
        for one in dead_zone_evidence(recording, report.rates, report.noise, usual, biases, report.zones)
        if AXES[one.axis] not in {*coarse, *exact}
    ]
    for axis, symptom in exact.items():
        one = of_zero_samples(recording, AXES.index(str(axis)), float(np.deg2rad(symptom.size)), usual)
        if one is not None:
            found.append(one)
    return tuple(found)


def _calibrated(
    recording: Recording, report: SampleReport, pieces: tuple[Interval, ...], reference_sigma: Array
) -> tuple[RecordingModel, Array]:
    """The model about its own calibration, and the (12,) sigma of that.

    Raises
    ------
    InputError
        Rates and references do not fit each other, before the calibration or after it.
    """
    G, bias = recording.gyro.apriori_G.copy(), recording.gyro.apriori_bias.copy()
    sigma, short = PLAUSIBLE_RANGE, False
    for _ in range(ITERATIONS):
        model = linearised(recording, G, bias, report.rates, report.smooth, report.density, pieces, reference_sigma)
        try:
            check_residuals(model, report.rates)
        except LargeResidualError:
            better = None if short else _over_short_pieces(recording, report, pieces, reference_sigma)
            if better is None:
                raise
            (G, bias), short = better, True
            continue
        change, covariance = _step(model)
        sigma = np.sqrt(np.diag(covariance))
        if np.abs(change / sigma).max() < SETTLED:
            break
        G, bias = G + change[:9].reshape(3, 3), bias + change[9:]
    return model, sigma


def _over_short_pieces(
    recording: Recording, report: SampleReport, pieces: tuple[Interval, ...], reference_sigma: Array
) -> tuple[Array, Array] | None:
    """G and b from references next to each other, between which a coarse a-priori calibration does not lead far astray.

    None where they are not plausible, as with rates in another unit, or where even those are too far off.
    """
    gaps = [
        Interval(f"{piece.name}/{number}", piece.activity, float(low), float(high))
        for piece in pieces
        for number, (low, high) in enumerate(pairwise(recording.attitudes.t_s[reference_rows(recording.attitudes.t_s, piece)]))
        if high - low > recording.gyro.sample_s
    ]
    some = tuple(gaps[k] for k in np.unique(np.linspace(0, len(gaps) - 1, MOST_SHORT).astype(np.intp))) if gaps else ()
    if len(some) < FEWEST_SHORT or not report.rates.any():
        return None
    G, bias = recording.gyro.apriori_G.copy(), recording.gyro.apriori_bias.copy()
    for _ in range(ITERATIONS):
        model = linearised(recording, G, bias, report.rates, report.smooth, report.density, some, reference_sigma)
        try:
            check_residuals(model, report.rates)
        except LargeResidualError:
            return None
        change, _ = _step(model)
        G, bias = G + change[:9].reshape(3, 3), bias + change[9:]
        if np.abs(change[:9]).max() < SETTLED_SHORT:
            break
    moved = np.append((G - recording.gyro.apriori_G).ravel(), bias - recording.gyro.apriori_bias)
    return None if (np.abs(moved) > IMPLAUSIBLE).any() else (G, bias)


def _step(model: RecordingModel) -> tuple[Array, Array]:
    """Least-squares correction of G and b with the start attitudes as nuisance parameters, (12,), and its covariance (12, 12).

    A broad prior, ten plausible ranges wide, keeps what cannot be observed where it is.
    """
    Q = np.linalg.qr(model.attitude_nuisance)[0]
    scaled = (model.calibration - Q @ (Q.T @ model.calibration)) * PLAUSIBLE_RANGE
    observed = model.whitened(model.zeta)
    observed = observed - Q @ (Q.T @ observed)
    information = scaled.T @ scaled + 1e-2 * np.eye(12)
    covariance = np.linalg.inv(information) * np.outer(PLAUSIBLE_RANGE, PLAUSIBLE_RANGE)
    return np.asarray(np.linalg.solve(information, scaled.T @ observed) * PLAUSIBLE_RANGE), np.asarray(covariance)


def unclipped(recording: Recording, report: SampleReport) -> tuple[Interval, ...]:
    """The parts of the intervals between clipped samples that have two references or more.

    What a clipped gyro missed in a slew may be many degrees, far outside the linear model; the propagation starts afresh at
    the first reference after it.
    """
    if not report.clipped.any():
        return recording.intervals
    clipped_times = recording.gyro.t_s[report.clipped]
    out = []
    for interval in recording.intervals:
        times = recording.attitudes.t_s[reference_rows(recording.attitudes.t_s, interval)]
        part = np.searchsorted(clipped_times, times)
        for number in np.unique(part):
            chosen = times[part == number]
            if chosen.size >= 2 and chosen[-1] > chosen[0]:
                name = interval.name if number == part[0] == part[-1] else f"{interval.name}/{number}"
                out.append(Interval(name, interval.activity, float(chosen[0]), float(chosen[-1])))
    return tuple(out)


def _notes(recording: Recording, pieces: tuple[Interval, ...], sigma: Array) -> tuple[str, ...]:
    notes = []
    counts = [reference_rows(recording.attitudes.t_s, interval).size for interval in recording.intervals]
    if max(counts) <= 2:
        left = 3 * len(counts) - 12
        notes.append(
            f"References only at the ends of {len(counts)} intervals: {max(left, 0)} degrees of freedom are left beside the 12 "
            "of the calibration, so most effects cannot be told from one another or from a change of G and b"
        )
    names = [f"G_{a}{b}" for a in "xyz" for b in "xyz"] + ["b_x", "b_y", "b_z"]
    unseen = [name for name, value, plausible in zip(names, sigma, PLAUSIBLE_RANGE, strict=True) if value > UNSEEN * plausible]
    if unseen:
        notes.append(f"Not observed by these motions: {', '.join(unseen)}; effects that act like them cannot be seen either")
    if len(pieces) != len(recording.intervals) or any(a != b for a, b in zip(pieces, recording.intervals, strict=False)):
        notes.append("The attitude was not propagated over clipped gyro samples; the parts before and after them were used")
    notes.append(
        "A constant offset of the references acts like a rotation of G and of the start attitudes: no recording of gyro and "
        "reference attitudes can show it"
    )
    return tuple(notes)
