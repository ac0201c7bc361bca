"""Waves against the innovations of all references: how much of them each way of a tone explains.

References that are h apart cannot tell a frequency f from |j/h ± f|: a reading may be wrong at any of these, up to half the
gyro's sampling rate, and the phases between the intervals and the samples tell which. Frequencies of a vibration are even up to
half the sampling rate beforehand, periods of a swing even in their logarithm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.inference.evidence import averaged, log_bayes
from diagnosis.model.linear import VISIBLE, spaced
from diagnosis.model.lines import PERIODS
from diagnosis.model.misfit import basis, whitened
from diagnosis.model.recording import RecordingModel, parameter_errors
from diagnosis.model.tones.peak import Peak, powers
from diagnosis.model.tones.samples import sample_log_ratio
from diagnosis.model.tones.tone import BIAS, PICKUP, REFERENCE, UNLISTED, Array, Way, effect_of, waves
from simulator.effects.timing import delay_columns

AXES = range(3)
NEAR = 25  # frequencies around a peak, from one neighbour to the other
PHASE = 0.1  # cycles over the whole recording, between frequencies that its intervals are to tell apart
MOST_FINE, TOPS = 4000, 6  # of them, and of those that are tried as they are
MOST_ALIASES, MOST_SHOWN = 60, 3  # frequencies of a reading that are tried, and whose waves are whitened
REGULAR = 1e-3  # relative scatter of the references' spacing, with which frequencies have aliases
SEGMENTS = 4  # parts of the recording in which an amplitude may be another
TINY = 1e-300


@dataclass(frozen=True)
class Fit:
    """Waves against the innovations of all references.

    Attributes
    ----------
    model : of the recording
    y : (N,) innovations without what G and b take up
    taken, motion : (N, q) orthonormal bases of that, and of it and what follows the motion
    """

    model: RecordingModel
    y: Array
    taken: Array
    motion: Array

    @classmethod
    def of(cls, model: RecordingModel) -> Fit:
        """Of a recording."""
        rows = [model.residuals[:, :, None], model.turned_by(parameter_errors(model.raw)), model.turned_by(_follows(model))]
        white, _ = whitened(model, np.concatenate(rows, axis=2))
        taken = basis(white[:, 1:13])
        return cls(model, white[:, 0] - taken @ (taken.T @ white[:, 0]), taken, basis(white[:, 1:]))

    def centred(self, peak: Peak) -> float:
        """The frequency near a peak at which waves with a phase of their own in each interval explain most, Hz."""
        model = self.model
        later = np.diff(model.interval_of_reference, prepend=-1) == 0
        t_s, owner, e = model.references.t_s[later], model.interval_of_reference[later], self.y.reshape(-1, 3)
        near = peak.frequency_hz + peak.step_hz * np.linspace(-1, 1, NEAR)
        power = np.sum([powers(e[owner == k], t_s[owner == k], near) for k in np.unique(owner)], axis=0)
        return float(near[int(np.argmax(power.max(axis=1)))])

    def coherent(self, frequencies: Array, axis: int, reach: float) -> Array:
        """Each frequency moved, by at most a reach, to where one wave explains most over all intervals, Hz.

        A wave of the readings has the same phases as one of the references, but for a quarter of a turn.
        """
        near = [frequency + self._moves(frequency, axis, reach) for frequency in frequencies]
        columns = self._columns(np.concatenate(near), True, [axis])
        chi2 = np.array([self._chi2(columns[:, k : k + 2], self.taken) for k in range(0, columns.shape[1], 2)])
        starts = np.cumsum([0, *(len(one) for one in near)])
        return np.array([one[int(np.argmax(chi2[k : k + len(one)]))] for one, k in zip(near, starts[:-1], strict=True)])

    def _moves(self, frequency: float, axis: int, reach: float) -> Array:
        """The likeliest moves of a frequency, if the phase of a wave between the intervals were all that they turn."""
        model = self.model
        if len(model.blocks) == 1:
            return np.linspace(-reach, reach, 2 * NEAR + 1)
        width = max(PHASE / float(np.ptp(model.references.t_s)), 2 * reach / MOST_FINE)
        later = np.diff(model.interval_of_reference, prepend=-1) == 0
        owner = np.repeat(model.interval_of_reference[later], 3)
        columns = self._columns(np.array([frequency]), True, [axis])
        S, C = (columns - self.taken @ (self.taken.T @ columns)).T
        starts = np.flatnonzero(np.diff(owner, prepend=-1))
        t_s = np.array([model.references.t_s[model.interval_of_reference == k].mean() for k in owner[starts]])
        moves = width * np.arange(-np.floor(reach / width), np.floor(reach / width) + 1)
        turn = 2 * np.pi * np.outer(moves, t_s - t_s.mean())
        zs, zc, ss, cc, sc = (np.add.reduceat(one, starts) for one in (S * self.y, C * self.y, S * S, C * C, S * C))
        # sin(x + φ) = sin x cos φ + cos x sin φ, cos(x + φ) = cos x cos φ − sin x sin φ.
        c, s = np.cos(turn), np.sin(turn)
        z1, z2 = c @ zs + s @ zc, c @ zc - s @ zs
        g11 = (c * c) @ ss + (s * s) @ cc + 2 * (c * s) @ sc
        g22 = (c * c) @ cc + (s * s) @ ss - 2 * (c * s) @ sc
        g12 = (c * c - s * s) @ sc + (c * s) @ (cc - ss)
        chi2 = (g22 * z1**2 - 2 * g12 * z1 * z2 + g11 * z2**2) / np.maximum(g11 * g22 - g12**2, TINY)
        around = np.pad(chi2, 1, constant_values=-np.inf)
        tops = np.flatnonzero((chi2 >= around[:-2]) & (chi2 >= around[2:]))
        return np.asarray(moves[tops[np.argsort(-chi2[tops])[:TOPS]]])

    def strongest(self, frequency: float) -> tuple[int, float]:
        """The axis about which a wave of the references explains most, and the share of χ² it keeps beside the motion."""
        columns = self._columns(np.array([frequency]), True, AXES)
        chi2 = [self._chi2(columns[:, self._places(0, axis)], self.taken) for axis in AXES]
        axis = int(np.argmax(chi2))
        return axis, self._chi2(columns[:, self._places(0, axis)], self.motion) / chi2[axis]

    def listed(self, frequency: float, centre: float, axis: int, reach: float, rates: Array) -> Iterator[Way]:
        """The ways of listed effects: a swing of the references or of a bias, or a vibration at one of the aliases."""
        level, at = self._level(frequency, axis), np.array([frequency])
        swing = -float(np.log(PERIODS * frequency))
        for kind, on_references in ((REFERENCE, True), (BIAS, False)):
            columns = self._columns(at, on_references, AXES)
            for one in AXES:
                way, chi2 = self._way(kind, one, frequency, columns[:, self._places(0, one)], level, swing)
                if way is not None:
                    yield way if on_references else self._by_samples(way, rates, chi2)
        aliases = self._shown(self.coherent(aliases_of(self.model, centre), axis, reach), axis, level, rates)
        sample_s = self.model.recording.gyro.sample_s
        columns = self._columns(aliases, False, [axis]) / np.repeat(np.sinc(aliases * sample_s), 2)
        tone = float(np.log(2 * sample_s))
        for k, alias in enumerate(aliases):
            way, chi2 = self._way(PICKUP, axis, float(alias), columns[:, 2 * k : 2 * k + 2], level, tone)
            if way is not None:
                yield self._by_samples(way, rates, chi2)

    def _shown(self, aliases: Array, axis: int, level: float, rates: Array) -> Array:
        """The frequencies of a reading at which the samples show it best.

        A reading that is high by A sin(2π f t + φ) turns what is propagated as references do that are off by its integral.
        """
        columns, factor = self._columns(aliases, True, [axis]), 2 * np.pi / self.model.G[axis, axis]
        log_ratio = []
        for k, alias in enumerate(aliases):
            own = columns[:, 2 * k : 2 * k + 2]
            own = own - self.taken @ (self.taken.T @ own)
            p, q = np.linalg.solve(own.T @ own, own.T @ self.y)
            way = Way(PICKUP, axis, float(alias), factor * alias * np.array([-q, p]), 0.0, 0.0)
            log_ratio.append(sample_log_ratio(self.model.recording, rates, way, self._chi2(own, self.taken) / level))
        return np.asarray(aliases[np.argsort(-np.array(log_ratio))[:MOST_SHOWN]])

    def rivals(self, frequency: float, axis: int) -> Iterator[Way]:
        """A wave about no single axis, and one whose amplitude changes."""
        level, at = self._level(frequency, axis), np.array([frequency])
        prior = -float(np.log(PERIODS * frequency)) - float(np.log(2.0))
        for columns in (self._columns(at, True, AXES), self._columns(at, True, [axis], _segments(self.model))):
            yield Way(UNLISTED, axis, frequency, np.zeros(2), 0.0, self._evidence(columns, level, None) + prior)

    def _way(
        self, kind: str, axis: int, frequency: float, columns: Array, level: float, log_prior: float
    ) -> tuple[Way | None, float]:
        """A wave in terms of a listed effect, and the χ² it explains; None where no plausible size could be seen."""
        unit = np.deg2rad(1 / 3600 if kind == BIAS else 1.0)
        evidence = self._evidence(columns, level, tuple(unit * one for one in effect_of(kind).prior))
        if not np.isfinite(evidence):
            return None, 0.0
        own = columns - self.taken @ (self.taken.T @ columns)
        gram = own.T @ own
        amplitudes: Array = np.asarray(np.linalg.solve(gram, own.T @ self.y), dtype=float)
        sigma = float(np.sqrt(level * np.trace(np.linalg.inv(gram)) / 2))
        chi2 = float(amplitudes @ gram @ amplitudes) / level
        return Way(kind, axis, frequency, amplitudes, sigma, evidence + log_prior), chi2

    def _by_samples(self, way: Way, rates: Array, chi2: float) -> Way:
        """With what the samples say of it."""
        return replace(way, log_weight=way.log_weight + sample_log_ratio(self.model.recording, rates, way, chi2))

    def _level(self, frequency: float, axis: int) -> float:
        """Variance of the innovations beside the tone."""
        columns = self._columns(np.array([frequency]), True, [axis])
        return float((self.y @ self.y - self._chi2(columns, self.taken)) / max(self.y.size - self.taken.shape[1] - 2, 1))

    def _evidence(self, columns: Array, level: float, limits: tuple[float, ...] | None) -> float:
        """Log evidence of columns with amplitudes of any size that is plausible and could be seen."""
        own = (columns - self.taken @ (self.taken.T @ columns)) / np.sqrt(level)
        norms = np.linalg.norm(own, axis=0)
        low, high = VISIBLE[0] / norms.max(), VISIBLE[1] / norms.max()
        scales = spaced(low, high) if limits is None else spaced(max(low, limits[0]), min(high, limits[1]))
        if not scales.size:
            return -np.inf
        table = log_bayes((own.T @ own)[None], (own.T @ self.y)[None] / np.sqrt(level), scales)
        return averaged(table, np.zeros(1))

    def _chi2(self, columns: Array, beside: Array) -> float:
        U = basis(columns - beside @ (beside.T @ columns))
        return float(np.sum((U.T @ self.y) ** 2))

    @staticmethod
    def _places(frequency: int, axis: int) -> slice:
        """Of a frequency's columns about an axis, among those about all."""
        return slice(6 * frequency + 2 * axis, 6 * frequency + 2 * axis + 2)

    def _columns(self, frequencies: Array, on_references: bool, axes: Sequence[int], parts: Array | None = None) -> Array:
        """(N, 2 f a p) innovations of sine and cosine at each frequency about each axis, in each of some parts (m, p)."""
        model = self.model
        t_s, duration = (model.references.t_s, 0.0) if on_references else (model.t_s, model.dt)
        own = waves(frequencies, t_s, duration)
        if parts is not None:
            own = (own[:, :, None] * parts[:, None, :]).reshape(len(own), -1)
        made = np.zeros((len(own), 3, own.shape[1] // 2, len(axes), 2))
        for place, axis in enumerate(axes):
            made[:, axis, :, place] = own.reshape(len(own), -1, 2)
        made = made.reshape(len(own), 3, -1)
        errors = -np.matmul(model.at_reference, made) if on_references else model.turned_by(made)
        return whitened(model, errors)[0]


def _follows(model: RecordingModel) -> Array:
    """(n, 3, k) errors of readings that follow the motion: products of rates, their sizes and their changes."""
    raw = model.raw
    products = [raw[:, i] * raw[:, j] for i in AXES for j in range(i, 3)]
    change = delay_columns(model.stream)[:, :, 0]
    own = np.column_stack([*products, *np.abs(raw).T, *change.T])
    out = np.zeros((len(raw), 3, 3 * own.shape[1]))
    for axis in AXES:
        out[:, axis, axis * own.shape[1] : (axis + 1) * own.shape[1]] = own
    return out


def _segments(model: RecordingModel) -> Array:
    """(m, p) parts of the recording: some of the intervals, or of the time of the only one."""
    number = model.interval_of_reference if len(model.blocks) > 1 else model.references.t_s
    cuts = np.quantile(number, np.linspace(0, 1, SEGMENTS + 1)[1:-1])
    part = np.searchsorted(np.unique(cuts), number, side="right")
    return np.asarray(part[:, None] == np.unique(part), dtype=float)


def aliases_of(model: RecordingModel, frequency: float) -> Array:
    """Frequencies of a reading that the references cannot tell from one, up to half the sampling rate, Hz."""
    apart = np.concatenate([np.diff(block.elapsed_s) for block in model.blocks])
    spacing, half_rate = float(np.median(apart)), 0.5 / model.recording.gyro.sample_s
    if np.median(np.abs(apart - spacing)) > REGULAR * spacing or np.mean(np.abs(apart - spacing) > REGULAR * spacing) > 0.1:
        return np.array([frequency])
    multiples = np.arange(1, int(half_rate * spacing) + 2) / spacing
    found = np.sort(np.concatenate([[frequency], multiples - frequency, multiples + frequency]))
    return np.asarray(found[(found > 0) & (found < half_rate)][:MOST_ALIASES])
