"""From a recording to the linear model about its own calibration under M0."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.deadzone import DeadStretches, dead_stretches, half_width, missing
from diagnosis.detectors.reference_noise import ReferenceNoise, reference_noise
from diagnosis.detectors.report import StreamReport
from diagnosis.detectors.samples import examine
from diagnosis.inference.evidence import averaged, log_bayes, scales_of
from diagnosis.inference.unshown import HARMONICS_HZ
from diagnosis.model.recording import Model, linearised
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.errors import InputError
from gyrocal.recording import Interval, Recording, reference_rows
from simulator.effects import EFFECTS

Array = NDArray[np.float64]

ITERATIONS = 10
SETTLED = 1e-3  # sigmas
CLEARLY = 12.0  # of χ², by which the attitude decides how readings came onto a lattice
LIKELY = 6.0  # log odds of the samples from which a dead zone is certain if the attitude shows that rates are missing
PLAIN = 20.0  # the same, if the attitude only shows that something is wrong, or the samples have harmonics of slow motion
MISFIT = 5.0  # sigmas of χ² that show it
UNSHOWN_S = 60.0  # s for which a rate inside a dead zone may stay the same
FELT = 12.0  # log evidence of the attitude that rates are missing
UNSEEN = 0.5  # of its plausible range: a parameter less certain than that is not observed


@dataclass(frozen=True)
class DeadZone:
    """A dead zone: what the samples show, half width and sigma in deg/s, log odds of samples and attitude together."""

    stretches: DeadStretches
    size: float
    sigma: float
    log_odds: float


@dataclass(frozen=True)
class Prepared:
    """A recording ready for the attitude tests.

    Attributes
    ----------
    model : linearised about the calibration, on the repaired stream
    stream : what the samples showed
    sigma : (12,) of the calibration under M0: G_xx … G_zz, b_x … b_z (rad/s)
    reference_noise : test of the references' noise, None without a series of them
    dead : gyros that read zero for long, and may have a dead zone
    zones : dead zones that are certain; what they swallow is free in the model
    notes : limits of this recording
    """

    model: Model
    stream: StreamReport
    sigma: Array
    reference_noise: ReferenceNoise | None
    dead: tuple[DeadStretches, ...]
    zones: tuple[DeadZone, ...]
    notes: tuple[str, ...]


def prepare(recording: Recording) -> Prepared:
    """Examine the stream, calibrate under M0 by Gauss–Newton on the linear model, and linearise there.

    Noise that is not as stated is an effect of its own; it is found here, and the model then has the actual noise.

    Raises
    ------
    InputError
        The stream does not cover the intervals, or nothing is left of them.
    """
    report = examine(recording)
    first = _first(recording, report)
    if report.undecided:
        cut = examine(recording, lattice="cut")
        other = _first(recording, cut)
        if _misfit(other) < _misfit(first) - CLEARLY:
            report, first = cut, other
    model, sigma, pieces = first
    dead = () if any(cause.effect == "rate_deadzone" for cause in report.causes) else _dead(recording, report)
    noise = _reference_noise(model, report, dead)
    zones = [zone for one in dead if (zone := _zone(model, one, _has_harmonics(report, one.axis))) is not None]
    if zones:
        _forget_motion(report, zones)
        model, sigma = _calibrated(recording, report, pieces, recording.attitudes.sigma)
        free = np.hstack([missing(model, zone.stretches) for zone in zones])
        model = replace(model, free=free)
        dead = tuple(one for one in dead if one.axis not in {zone.stretches.axis for zone in zones})
        noise = _reference_noise(model, report, [zone.stretches for zone in zones])
    # What a gyro does not show between two references looks like noise of theirs about its axis.
    blind = {zone.stretches.axis for zone in zones} | set(np.flatnonzero(report.hidden | report.lattice).tolist())
    if noise is not None and (noise.axis in blind or len(blind) == 3):
        noise = None
    if noise is not None and noise.departs:
        free = model.free
        model, sigma = _calibrated(recording, report, pieces, recording.attitudes.sigma * noise.factors)
        model = replace(model, free=free)
    return Prepared(model, report, sigma, noise, dead, tuple(zones), _notes(recording, pieces, sigma))


def _reference_noise(model: Model, report: StreamReport, dead: Iterable[DeadStretches]) -> ReferenceNoise | None:
    """The test of the references' noise beside what the samples show of the gyros."""
    nothing = np.zeros(len(report.rates), dtype=bool)
    return reference_noise(
        model, np.median(report.density, axis=0), np.any([nothing, *(one.stretch >= 0 for one in dead)], axis=0)
    )


def _has_harmonics(report: StreamReport, axis: int) -> bool:
    """Whether a gyro shows a line just above the body's own motion, as the edges of a dead zone make."""
    lines = [cause for cause in report.causes if cause.effect == "vibration" and cause.axis == "xyz"[axis]]
    return any(float(line.parameters["apparent_hz"]) < HARMONICS_HZ for line in lines)


def _zone(model: Model, one: DeadStretches, harmonics: bool) -> DeadZone | None:
    """A dead zone that samples and attitude, or the samples in two ways, show together; None if they do not."""
    if one.log_odds < LIKELY:
        return None
    X = model.prepared(missing(model, one))
    scales = scales_of(float(np.linalg.norm(X, axis=0).max()), EFFECTS["rate_deadzone"].prior)
    if not scales.size:
        return None
    evidence = averaged(log_bayes((X.T @ X)[None], (X.T @ model.y)[None], scales), np.zeros(1))
    # Slow motion about zero is swallowed as well, and leaves no mean that would be missing.
    wrong = float(model.y @ model.y) - model.y.size > MISFIT * np.sqrt(2.0 * model.y.size)
    if evidence < FELT and not (one.log_odds > PLAIN and (wrong or harmonics)):
        return None
    scale = 1.0 / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    inverse = np.linalg.pinv((X * scale).T @ (X * scale), rcond=1e-10, hermitian=True)
    amplitudes = scale * (inverse @ ((X * scale).T @ model.y))
    size, sigma = half_width(one, float(amplitudes[0]), amplitudes[1:], (scale * np.sqrt(np.diag(inverse)))[1:])
    return DeadZone(one, size, sigma, float(evidence + one.log_odds))


def _forget_motion(report: StreamReport, zones: list[DeadZone]) -> None:
    """Allow for the motion that a gyro does not show inside its dead zone: some rate of that size, afresh every minute."""
    for zone in zones:
        own = zone.stretches
        report.density[own.stretch >= 0, own.axis] += (0.5 * np.deg2rad(zone.size)) ** 2 * UNSHOWN_S


def _first(recording: Recording, report: StreamReport) -> tuple[Model, Array, tuple[Interval, ...]]:
    """The model with the references as stated, its sigma, and what it is propagated over."""
    pieces = unclipped(recording, report)
    if not pieces:
        raise InputError("no two reference attitudes are left with an unclipped stretch of gyro samples between them")
    return *_calibrated(recording, report, pieces, recording.attitudes.sigma), pieces


def _misfit(first: tuple[Model, Array, tuple[Interval, ...]]) -> float:
    return float(first[0].y @ first[0].y)


def _dead(recording: Recording, report: StreamReport) -> tuple[DeadStretches, ...]:
    lattice = {cause.axis for cause in report.causes if cause.effect in ("rate_quantization", "rate_truncation")}
    found = dead_stretches(recording, report.rates, report.noise)
    return tuple(one for one in found if None not in lattice and "xyz"[one.axis] not in lattice)


def _calibrated(
    recording: Recording, report: StreamReport, pieces: tuple[Interval, ...], reference_sigma: Array
) -> tuple[Model, Array]:
    """The model about its own calibration, and the (12,) sigma of that."""
    G, bias = recording.gyro.apriori_G.copy(), recording.gyro.apriori_bias.copy()
    shrink = 1.0 / PLAUSIBLE_RANGE
    sigma = PLAUSIBLE_RANGE
    for _ in range(ITERATIONS):
        model = linearised(recording, G, bias, report.rates, report.smooth, report.density, pieces, reference_sigma)
        change, covariance = _step(model, shrink)
        sigma = np.sqrt(np.diag(covariance))
        if np.abs(change / sigma).max() < SETTLED:
            break
        G, bias = G + change[:9].reshape(3, 3), bias + change[9:]
    return model, sigma


def _step(model: Model, shrink: Array) -> tuple[Array, Array]:
    """Least-squares correction of G and b with the start attitudes free, (12,), and its covariance (12, 12).

    A broad prior, ten plausible ranges wide, keeps what cannot be observed where it is.
    """
    starts, columns = model.starts, model.calibration
    Q = np.linalg.qr(starts)[0]
    scaled = (columns - Q @ (Q.T @ columns)) / shrink
    observed = model.whitened(model.zeta)
    observed = observed - Q @ (Q.T @ observed)
    information = scaled.T @ scaled + 1e-2 * np.eye(12)
    covariance = np.linalg.inv(information) / np.outer(shrink, shrink)
    return np.asarray(np.linalg.solve(information, scaled.T @ observed) / shrink), np.asarray(covariance)


def unclipped(recording: Recording, report: StreamReport) -> tuple[Interval, ...]:
    """The parts of the intervals between clipped stretches that have two references or more.

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
            if chosen.size >= 2:
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
        notes.append("Where the gyro was clipped the attitude was not propagated; the parts on either side were used")
    notes.append(
        "A constant offset of the references, the same at all times, is the same as a turn of G and a start attitude: "
        "not identifiable from any recording"
    )
    return tuple(notes)
