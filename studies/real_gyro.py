"""A real gyro: what M0 lacks on recorded trials, and how far the error of predictions shrinks on trials that found nothing.

The trials are those of BROAD (`studies.broad`, docs/broad.md), a case a sensor unit; units share nothing. Every trial is
diagnosed by itself against M0 with that sensor's noise. Then each is left out in turn (of a unit with one trial each motion):

- The effects are *chosen* by the diagnoses of the others: those named by at least half of them. Their sizes, G and a common b
  are fitted to the others by least squares with M0's noise. Of the trial left out only the gyro is used: the mean of its first
  rest is taken from its rates, and samples are repaired one by one (see `repaired`).
- Its attitude is propagated from the first reference of every interval, with one more effect at each rung of the ladder, and
  compared with the references: at the end of the interval, and the mean square over all of them. Rests are not scored.
- The *floor* is what the whole procedure leaves on simulated trials: M0 with the effects found, on the recorded motion.

Then the tags are set right by the time offset so found, and the diagnosis asked again what remains.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import model_validator

from diagnosis.diagnose import diagnose
from diagnosis.result import Diagnosis
from gyrocal import Attitudes, InputError, Interval, Recording, attitude, propagate
from gyrocal.recording import reference_rows
from gyrocal.sampling import Measurements, measurements
from simulator.effects import EFFECTS, Setting, setting
from simulator.effects.recorded import stream_of
from simulator.replay import replay, replayed
from studies import broad
from studies.manifest import digest
from studies.report import Entry, Report
from studies.study import Streams, Study, StudyConfig

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Row = dict[str, Any]

ROOT = Path(__file__).parents[1]
FOLDER = "../shared/real/broad"
UNITS: dict[str, tuple[str, ...]] = {"A": ("04",), "B": ("02", "05", "07", "09", "18"), "C": ("03", "24")}

TIMING = ("time_offset", "rate_lag")  # the same to first order; which of the two it is, held-out prediction decides
LADDER = ("time_offset", "rate_truncation", "stale_samples")
SUPPORT = 0.5  # share of the other trials whose diagnosis must name an effect
NAMED = 0.95  # probability of a timing effect over all explanations, to be named
ITERATIONS = 5
SETTLED = 0.1  # sigmas
NEAR_REFERENCE = 2  # samples on either side of one, for the rate there
FIRST_ORDER = 1e-6  # size of a column's step, in its unit
GRAVITY = 9.80665  # m/s²
LAGS_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
SHOWN_BINS = 4  # counts on either side of zero
SWEEP = 4  # samples before and after one, for the rate to have swept through
SWEPT = 6  # counts in that time
TONE_BLOCK_S = 1.0


class RealConfig(StudyConfig):
    """Where the trials are and which belong together.

    Attributes
    ----------
    folder : of the trials; a relative one counts from the repository
    units : numbers that the files' names begin with, by sensor unit
    cases : units
    spacing_s : s between the references of an interval
    floor_replays : simulated repetitions of each trial
    """

    cases: int = len(UNITS)
    folder: str = FOLDER
    units: dict[str, tuple[str, ...]] = UNITS
    spacing_s: float = 1.0
    floor_replays: int = 4

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if "cases" not in self.model_fields_set:
            self.__dict__["cases"] = len(self.units)  # it is frozen for everybody else
        if self.cases != len(self.units):
            raise ValueError(f"a case is a unit, so cases must be {len(self.units)}, not {self.cases}")
        for unit, numbers in self.units.items():
            for number in numbers:
                if len(self.files(number)) != 1:
                    raise ValueError(
                        f"no trial {number} of unit {unit} in {self.path}; the BROAD trials are not part of this project "
                        "(docs/broad.md says where they come from), point folder at them"
                    )
        return self

    @property
    def path(self) -> Path:
        """The folder."""
        return (ROOT / self.folder).resolve()

    def files(self, number: str) -> list[Path]:
        """The files of a trial's number."""
        return sorted(self.path.glob(f"{number}_*.parquet"))


@dataclass(frozen=True)
class Loaded:
    """A trial, or some intervals of it.

    Attributes
    ----------
    number : of the trial
    trial : as it is on file
    recording : the same as a recording, tags and samples untouched
    """

    number: str
    trial: broad.Trial
    recording: Recording

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the intervals with motion."""
        return tuple(interval.name for interval in self.recording.intervals if interval.activity != "rest")

    @cached_property
    def first_rest(self) -> slice:
        """Samples of the first rest."""
        for first, stop in broad.runs(self.trial.still):
            if (stop - first) * self.trial.sample_s >= broad.SHORTEST_REST_S:
                return slice(first, stop)
        raise InputError(f"{self.trial.name}: no rest of {broad.SHORTEST_REST_S:g} s to take the bias from")

    def only(self, names: Sequence[str]) -> Loaded:
        """With some of the intervals."""
        kept = tuple(interval for interval in self.recording.intervals if interval.name in names)
        own = self.recording.attitudes
        rows = np.unique(np.concatenate([reference_rows(own.t_s, interval) for interval in kept]))
        attitudes = Attitudes(own.t_s[rows], own.quaternions[rows], own.sigma[rows])
        return replace(self, recording=replace(self.recording, intervals=kept, attitudes=attitudes))

    def seen(self, recording: Recording) -> Loaded:
        """With another recording of the same motion, cut to the intervals of this one."""
        times = self.recording.attitudes.t_s
        rows = np.searchsorted(recording.attitudes.t_s, times - 1e-9)
        own = recording.attitudes
        attitudes = Attitudes(times, own.quaternions[rows], self.recording.attitudes.sigma)
        return replace(self, recording=replace(self.recording, gyro=recording.gyro, attitudes=attitudes))


@dataclass(frozen=True)
class Found:
    """What the diagnoses of some trials name.

    Attributes
    ----------
    effects : of the ladder, in its order
    step : of the truncation, rad/s; 0 without it
    mean_run, fraction : of the stale samples
    """

    effects: tuple[str, ...]
    step: float = 0.0
    mean_run: float = 1.0
    fraction: float = 0.0


@dataclass(frozen=True)
class Fitted:
    """G, b (rad/s), time offset (s) and amplitudes of further columns, with the sigma of the offset."""

    G: Array
    bias: Array
    offset: float
    offset_sigma: float
    amplitudes: Array


@dataclass(frozen=True)
class Further:
    """Columns tried beside the ladder's.

    Attributes
    ----------
    name : for people
    effect : of the list, about all three axes; "" for the specific force on all axes
    """

    name: str
    effect: str


TRIED = (
    Further("scale_asymmetry", "scale_asymmetry"),
    Further("scale_quadratic", "scale_quadratic"),
    Further("bias_drift", "bias_drift"),
    Further("bias that follows specific force", ""),
)


# --- Repairs ------------------------------------------------------------------------------------------------------------------


def untruncated(rates: Array, step: float) -> Array:
    """Rates cut toward zero, put in the middle of what they stand for: half a step further from zero, but for zero itself."""
    return rates + 0.5 * step * np.sign(np.rint(rates / step))


def repeats(rates: Array) -> NDArray[np.bool_]:
    """(n,) samples that repeat the one before on all axes."""
    out = np.zeros(len(rates), dtype=bool)
    out[1:] = (rates[1:] == rates[:-1]).all(axis=1)
    return out


def filled(rates: Array, bad: NDArray[np.bool_]) -> Array:
    """Rates with the line between the neighbours in place of bad samples."""
    t = np.arange(len(rates))
    out = rates.copy()
    for axis in range(3):
        out[bad, axis] = np.interp(t[bad], t[~bad], rates[~bad, axis])
    return out


def repaired(loaded: Loaded, rung: Sequence[str], found: Found) -> Recording:
    """Samples with the rung's effects undone and the mean of the first rest taken off; tags untouched.

    A sample that repeats the one before on all axes is replaced by the line between its neighbours. At rest some do so by
    chance; the line then takes the place of noise.
    """
    recording = loaded.recording
    rates = recording.gyro.rates
    bad = repeats(rates)
    if "rate_truncation" in rung:
        rates = untruncated(rates, found.step)
    if "stale_samples" in rung:
        rates = filled(rates, bad)
    rates = rates - rates[loaded.first_rest].mean(axis=0)
    return replace(recording, gyro=replace(recording.gyro, rates=np.ascontiguousarray(rates)))


def delayed(recording: Recording, offset: float, lag: bool) -> Recording:
    """The recording with its delay undone: tags earlier by a time offset, or a first-order lag inverted, both in s."""
    gyro = recording.gyro
    if not lag:
        return replace(recording, gyro=replace(gyro, t_s=gyro.t_s - offset))
    return replace(recording, gyro=replace(gyro, rates=gyro.rates + offset * np.gradient(gyro.rates, gyro.sample_s, axis=0)))


# --- Fit and prediction -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Linear:
    """Residuals of a recording and their derivatives.

    Attributes
    ----------
    parts : the arcs
    theta : (m, 3) rotation vectors of A_obs A_propᵀ, rad
    to_inertial : (m, 3, 3) A_propᵀ
    H : (m, 3, 13 + k) derivatives by G, b, offset and further columns
    """

    parts: Measurements
    theta: Array
    to_inertial: Array
    H: Array


def _propagated(recording: Recording, G: Array, bias: Array) -> tuple[Measurements, Array, Array, Array, Array]:
    parts = measurements(recording)
    run = propagate(parts.arcs, G, bias)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    A_prop = run.R @ A[parts.start]
    return parts, attitude.residual(A[parts.row], A_prop), A_prop, run.R, run.Theta


def linearised(recording: Recording, G: Array, bias: Array, columns: Array | None = None) -> Linear:
    """Residuals at G and b, and what moves them; columns (n, 3, k) on the raw rates, rad/s."""
    parts, theta, A_prop, R, Theta = _propagated(recording, G, bias)
    gyro = recording.gyro
    at = np.searchsorted(gyro.t_s, recording.attitudes.t_s + 1e-9) - 1
    low, high = np.maximum(at - NEAR_REFERENCE, 0), np.minimum(at + NEAR_REFERENCE + 1, len(gyro.t_s))
    total = np.vstack([np.zeros(3), np.cumsum(gyro.rates, axis=0)])
    rate = (total[high] - total[low]) / (high - low)[:, None] @ G.T + bias
    shift = rate[parts.row] - np.einsum("mij,mj->mi", R, rate[parts.start])
    H = [Theta, shift[:, :, None]]
    for k in range(0 if columns is None else columns.shape[2]):
        assert columns is not None
        moved = replace(recording, gyro=replace(gyro, rates=gyro.rates + FIRST_ORDER * columns[:, :, k]))
        H.append(((_propagated(moved, G, bias)[1] - theta) / FIRST_ORDER)[:, :, None])
    return Linear(parts, theta, np.swapaxes(A_prop, 1, 2), np.concatenate(H, axis=2))


def whitened(linear: Linear, sigma: float, arw: float) -> tuple[Array, Array]:
    """Residuals (3m,) and derivatives (3m, p) with M0's noise: σ² at both ends, and the walk up to the earlier of two."""
    theta = np.einsum("mij,mj->mi", linear.to_inertial, linear.theta)
    H = linear.to_inertial @ linear.H
    z, X = [], []
    for start in np.unique(linear.parts.start):
        own = np.flatnonzero(linear.parts.start == start)
        t = linear.parts.elapsed_s[own]
        L = np.linalg.cholesky(sigma**2 * (np.eye(len(t)) + 1) + arw**2 * np.minimum.outer(t, t))
        z.append(np.linalg.solve(L, theta[own]).ravel())
        X.append(np.linalg.solve(L, H[own].reshape(len(t), -1)).reshape(3 * len(t), -1))
    return np.concatenate(z), np.concatenate(X)


def further_columns(loaded: Loaded, recording: Recording, further: Further | None) -> Array | None:
    """(n, 3, k) columns on the raw rates, in rad/s per unit that makes them about a ten-thousandth of the rates."""
    if further is None:
        return None
    if further.effect:
        stream = stream_of(recording, np.eye(3), np.zeros(3), smooth_s=0.0)
        effect = EFFECTS[further.effect]
        parts = [effect.columns(stream, axis, {}) for axis in "xyz"]
        return np.concatenate(parts, axis=2)
    force = (loaded.trial.force - loaded.trial.force[loaded.first_rest].mean(axis=0)) / GRAVITY * np.deg2rad(0.01)
    columns = np.zeros((len(force), 3, 9))
    for k in range(9):
        columns[:, k // 3, k] = force[:, k % 3]
    return columns


def fit(
    trials: Sequence[Loaded], rung: Sequence[str], found: Found, lag: bool = False, further: Further | None = None
) -> Fitted:
    """G, common b, time offset if it is of the rung, and further columns, by least squares over some trials."""
    recordings = [repaired(one, rung, found) for one in trials]
    columns = [further_columns(one, recording, further) for one, recording in zip(trials, recordings, strict=True)]
    extra = 0 if columns[0] is None else columns[0].shape[2]
    timed = "time_offset" in rung
    free = np.array([*range(12), *([12] if timed else []), *range(13, 13 + extra)])
    x = np.concatenate([np.eye(3).ravel(), np.zeros(4 + extra)])
    sigma = np.zeros(13 + extra)
    for _ in range(ITERATIONS):
        information, right = np.zeros((free.size, free.size)), np.zeros(free.size)
        for recording, own in zip(recordings, columns, strict=True):
            linear = linearised(_moved(recording, x, own, lag), x[:9].reshape(3, 3), x[9:12], own)
            z, X = whitened(linear, _rms(recording.attitudes.sigma), recording.gyro.arw)
            information += X[:, free].T @ X[:, free]
            right += X[:, free].T @ z
        scale = 1 / np.sqrt(np.diag(information))
        covariance = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-9, hermitian=True) * np.outer(scale, scale)
        step = -covariance @ right
        x[free] += step
        sigma[free] = np.sqrt(np.diag(covariance))
        if np.abs(step / sigma[free]).max() < SETTLED:
            break
    return Fitted(x[:9].reshape(3, 3), x[9:12], float(x[12]), float(sigma[12]), x[13:])


def _moved(recording: Recording, x: Array, columns: Array | None, lag: bool) -> Recording:
    if columns is not None:
        rates = recording.gyro.rates + columns @ x[13:]
        recording = replace(recording, gyro=replace(recording.gyro, rates=rates))
    return delayed(recording, float(x[12]), lag) if x[12] else recording


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True)
class Prediction:
    """Errors of the predicted attitude of one interval: times (m,) s and rotation vectors (m, 3) deg in body axes."""

    interval: str
    t_s: Array
    error: Array

    @property
    def squares(self) -> tuple[float, float]:
        """Squared error at the interval's end and mean square over its references, deg²."""
        squares = np.square(self.error).sum(axis=1)
        return float(squares[-1]), float(squares.mean())


def predicted(
    loaded: Loaded, fitted: Fitted, rung: Sequence[str], found: Found, lag: bool = False, further: Further | None = None
) -> list[Prediction]:
    """The attitude over every interval with motion, from its first reference with parameters from elsewhere."""
    recording = repaired(loaded, rung, found)
    columns = further_columns(loaded, recording, further)
    x = np.concatenate([fitted.G.ravel(), fitted.bias, [fitted.offset], fitted.amplitudes])
    parts, theta, *_ = _propagated(_moved(recording, x, columns, lag), fitted.G, fitted.bias)
    out = []
    for interval in loaded.recording.intervals:
        if interval.activity == "rest":
            continue
        rows = reference_rows(loaded.recording.attitudes.t_s, interval)
        own = np.flatnonzero(parts.start == rows[0])
        times = loaded.recording.attitudes.t_s[parts.row[own]]
        inside = own[(times > interval.start_s) & (times <= interval.stop_s + 1e-9)]
        times = loaded.recording.attitudes.t_s[parts.row[inside]]
        out.append(Prediction(interval.name, times, np.rad2deg(theta[inside])))
    return out


# --- Diagnoses and folds ------------------------------------------------------------------------------------------------------


def timing_probability(diagnosis: Diagnosis) -> float:
    """Probability that the gyro is late in one way or the other, over all explanations, unlisted ones included."""
    table = diagnosis.details.explanations
    own = [any(label in TIMING for label in effects.split(" + ")) for effects in table["effects"]]
    return float(table["probability"].to_numpy()[own].sum()) if len(table) else 0.0


def supported(diagnosis: Diagnosis) -> set[str]:
    """Effects of the ladder that a diagnosis names."""
    out = {cause.effect for cause in diagnosis.causes} & set(LADDER)
    if timing_probability(diagnosis) >= NAMED:
        out.add("time_offset")
    return out


def found_by(diagnoses: Sequence[Diagnosis]) -> Found:
    """The effects that enough of the diagnoses name."""
    names = [supported(one) for one in diagnoses]
    effects = tuple(effect for effect in LADDER if sum(effect in own for own in names) >= SUPPORT * len(diagnoses))
    causes = [cause for one in diagnoses for cause in one.causes]
    steps = [cause.size for cause in causes if cause.effect == "rate_truncation"]
    stale = [cause for cause in causes if cause.effect == "stale_samples"]
    return Found(
        effects,
        step=float(np.deg2rad(np.median(steps))) if "rate_truncation" in effects else 0.0,
        mean_run=float(np.mean([cause.size for cause in stale])) if stale else 1.0,
        fraction=float(np.mean([float(cause.parameters["fraction"]) for cause in stale])) if stale else 0.0,
    )


@dataclass(frozen=True)
class Fold:
    """What is left out, what is fitted, and what the others' diagnoses found."""

    tested: Loaded
    others: tuple[Loaded, ...]
    found: Found


def folds(trials: Sequence[Loaded], diagnoses: Mapping[str, Diagnosis]) -> list[Fold]:
    """Each trial left out; of a single trial each motion, which takes a diagnosis of the other motions alone."""
    if len(trials) > 1:
        return [
            Fold(
                one,
                tuple(other for other in trials if other.number != one.number),
                found_by([diagnoses[other.number] for other in trials if other.number != one.number]),
            )
            for one in trials
        ]
    (single,) = trials
    if len(single.motions) < 2:
        raise InputError(f"{single.trial.name}: a unit of one trial needs two motions or more, to leave one out")
    out = []
    for name in single.motions:
        rest = single.only([interval.name for interval in single.recording.intervals if interval.name != name])
        out.append(Fold(single.only([name]), (rest,), found_by([diagnose(rest.recording)])))
    return out


def rungs(found: Found) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Name of each rung and the effects in it; one that was not found adds nothing."""
    yield "M0", ()
    so_far: tuple[str, ...] = ()
    for effect in LADDER:
        so_far = (*so_far, effect) if effect in found.effects else so_far
        yield f"+ {effect}", so_far


# --- Rows ---------------------------------------------------------------------------------------------------------------------


def case(config: RealConfig, number: int, streams: Streams) -> list[Row]:
    """All that is said of one unit, a row a number; the column `kind` says of what kind."""
    unit = sorted(config.units)[number]
    trials = [load(config, name) for name in config.units[unit]]
    diagnoses = {one.number: diagnose(one.recording, seed=config.entropy) for one in trials}
    rows: list[Row] = []
    for one in trials:
        rows.append(_file_row(config, one))
        rows += _diagnosis_rows(one, diagnoses[one.number], 1)
        found = found_by([diagnoses[one.number]])
        rows += [*_zero_rows(one, found), *_repeat_rows(one), *_tone_rows(one, diagnoses[one.number])]
        rows += _own_rows(one, found)
    parted = folds(trials, diagnoses)
    last: dict[str, list[tuple[Fold, Fitted]]] = {}
    for fold in parted:
        rows += _fold_rows(fold, last)
    for name, done in last.items():
        one = next(trial for trial in trials if trial.number == name)
        offset = float(np.mean([fitted.offset for _, fitted in done]))
        again = delayed(one.recording, offset, lag=False)
        rows += _diagnosis_rows(one, diagnose(again, seed=config.entropy), 2)
        for fold, fitted in done:
            rows += _increment_rows(fold, fitted)
    rows += _floor_rows(config, trials, parted, last)
    return [{"unit": unit, **row} for row in rows]


def load(config: RealConfig, number: str) -> Loaded:
    """A trial by its number."""
    trial = broad.read(config.files(number)[0])
    return Loaded(number, trial, broad.to_recording(trial, spacing_s=config.spacing_s).recording)


def _file_row(config: RealConfig, one: Loaded) -> Row:
    moving = one.trial.rates[one.trial.moving]
    return {
        "kind": "trial",
        "trial": one.number,
        "name": one.trial.name,
        "text": digest(config.files(one.number)[0].read_bytes()),
        "samples": float(len(one.trial.rates)),
        "arw": float(np.rad2deg(one.recording.gyro.arw)),
        "sigma": float(np.rad2deg(_rms(one.recording.attitudes.sigma))),
        "rate": float(np.rad2deg(np.sqrt(np.square(moving).sum(axis=1).mean()))),
    }


def _diagnosis_rows(one: Loaded, found: Diagnosis, turn: int) -> list[Row]:
    base = {"trial": one.number, "turn": float(turn)}
    best = found.details.explanations
    rows: list[Row] = [
        {
            "kind": "diagnosis",
            **base,
            "text": found.verdict,
            "p_value": found.p_value,
            "unknown": found.unknown_probability,
            "timing": timing_probability(found),
            "name": str(best["effects"].iloc[0]) if len(best) else "",
            "probability": float(best["probability"].iloc[0]) if len(best) else 0.0,
        }
    ]
    for cause in found.causes:
        parameters = ", ".join(f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in cause.parameters.items())
        rows.append(
            {
                "kind": "cause",
                **base,
                "name": cause.label,
                "text": "/".join(cause.group),
                "size": cause.size,
                "size_sigma": cause.sigma,
                "size_unit": cause.unit,
                "parameters": parameters,
                "probability": cause.probability,
            }
        )
    return rows


def _own_rows(one: Loaded, found: Found) -> list[Row]:
    """The time offset fitted to the trial alone, with what its own diagnosis found undone, to compare within the unit."""
    rung = tuple(effect for effect in LADDER if effect == "time_offset" or effect in found.effects)
    fitted = fit([one], rung, found)
    return [{"kind": "own", "trial": one.number, "size": fitted.offset, "size_sigma": fitted.offset_sigma}]


def _zero_rows(one: Loaded, found: Found) -> list[Row]:
    """Counts of the readings next to zero while the rate sweeps through it, all axes together."""
    if found.step <= 0:
        return []
    counts = np.rint(one.trial.rates / found.step)
    sweeping = np.abs(np.roll(counts, -SWEEP, axis=0) - np.roll(counts, SWEEP, axis=0)) > SWEPT
    sweeping &= one.trial.moving[:, None]
    return [
        {"kind": "zero", "trial": one.number, "bin": float(k), "count": float(np.count_nonzero(sweeping & (counts == k)))}
        for k in range(-SHOWN_BINS, SHOWN_BINS + 1)
    ]


def _repeat_rows(one: Loaded) -> list[Row]:
    """Repeats on all axes, those that chance makes of how often each axis repeats around there, and the runs of two or more."""
    rates = one.trial.rates
    equal = np.zeros(rates.shape)
    equal[1:] = rates[1:] == rates[:-1]
    together = repeats(rates)
    width = one.trial.samples(0.5)
    kernel = np.ones(width) / width
    # Without those where all repeat at once: they are what is asked about.
    single = np.where(together[:, None], 0.0, equal)
    around = np.column_stack([np.convolve(single[:, k], kernel, mode="same") for k in range(3)])
    lengths = np.array([stop - first for first, stop in broad.runs(together)])
    return [
        {
            "kind": "repeats",
            "trial": one.number,
            "count": float(together.sum()),
            "expected": float(np.prod(around, axis=1).sum()),
            "moving_count": float(np.count_nonzero(together & one.trial.moving)),
            "moving_expected": float(np.prod(around, axis=1)[one.trial.moving].sum()),
            "long_runs": float(np.count_nonzero(lengths >= 2)),
            "size": float(lengths[lengths >= 2].mean()) if (lengths >= 2).any() else 0.0,
        }
    ]


def _tone_rows(one: Loaded, found: Diagnosis) -> list[Row]:
    """Whether the cameras see a tone that the gyro sees: coherence of both at rest, and how much of it the cameras see."""
    rows: list[Row] = []
    block = one.trial.samples(TONE_BLOCK_S)
    t = one.trial.t_s
    A = attitude.matrix_from_quaternion(np.where(one.trial.tracked[:, None], one.trial.quaternions, [0.0, 0.0, 0.0, 1.0]))
    # A_{k+1} = exp(−[ω×]Δt) A_k
    optical = attitude.residual(A[:-1], A[1:]) / one.trial.sample_s
    good = one.trial.tracked[:-1] & one.trial.tracked[1:] & ~one.trial.moving[:-1]
    for cause in found.causes:
        if cause.effect != "vibration" or cause.axis is None:
            continue
        axis, f = "xyz".index(cause.axis), float(cause.parameters["apparent_hz"])
        window = np.hanning(block) * np.exp(-2j * np.pi * f * t[:block])
        pairs = [
            (window @ one.trial.rates[k : k + block, axis], window @ optical[k : k + block, axis])
            for first, stop in broad.runs(good)
            for k in range(first, stop - block, block)
        ]
        if len(pairs) < 4:
            continue
        g, o = np.array(pairs).T
        power = float(np.sum(np.abs(g) ** 2) * np.sum(np.abs(o) ** 2))
        rows.append(
            {
                "kind": "tone",
                "trial": one.number,
                "name": cause.label,
                "frequency": f,
                "coherence": float(np.abs(np.vdot(o, g)) ** 2 / power),
                "gain": float(np.vdot(g, o).real / np.sum(np.abs(g) ** 2)),
                "count": float(len(pairs)),
            }
        )
    return rows


def _fold_rows(fold: Fold, last: dict[str, list[tuple[Fold, Fitted]]]) -> list[Row]:
    """Predictions of one trial left out, rung by rung, and with more in the model; the last fit is added to `last`."""
    rows: list[Row] = []
    number = fold.tested.number
    for order, (name, rung) in enumerate(rungs(fold.found)):
        fitted = fit(fold.others, rung, fold.found)
        predictions = predicted(fold.tested, fitted, rung, fold.found)
        rows += _held_rows(number, "held", name, predictions, order)
        rows += [row for row in _series_rows(number, name, predictions) if order in (0, len(LADDER))]
        added = name.removeprefix("+ ")
        rows.append(
            {
                "kind": "fit",
                "trial": number,
                "name": name,
                "chosen": order == 0 or added in fold.found.effects,
                "size": fitted.offset,
                "size_sigma": fitted.offset_sigma,
                "determinant": float(np.linalg.det(fitted.G)),
            }
        )
    last.setdefault(number, []).append((fold, fitted))
    if "time_offset" in fold.found.effects:
        other = fit(fold.others, rung, fold.found, lag=True)
        rows += _held_rows(
            number, "tried", "rate_lag for time_offset", predicted(fold.tested, other, rung, fold.found, lag=True)
        )
    for further in TRIED:
        other = fit(fold.others, rung, fold.found, further=further)
        rows += _held_rows(number, "tried", further.name, predicted(fold.tested, other, rung, fold.found, further=further))
    return rows


def _held_rows(number: str, kind: str, name: str, predictions: Sequence[Prediction], order: int = 0) -> list[Row]:
    return [
        {
            "kind": kind,
            "trial": number,
            "name": name,
            "order": float(order),
            "interval": one.interval,
            "end_deg2": one.squares[0],
            "series_deg2": one.squares[1],
        }
        for one in predictions
    ]


def _series_rows(number: str, name: str, predictions: Sequence[Prediction]) -> list[Row]:
    return [
        {
            "kind": "series",
            "trial": number,
            "name": name,
            "interval": one.interval,
            "t_s": float(t),
            **{f"error_{axis}": float(value) for axis, value in zip("xyz", error, strict=True)},
        }
        for one in predictions
        for t, error in zip(one.t_s, one.error, strict=True)
    ]


def _increment_rows(fold: Fold, fitted: Fitted) -> list[Row]:
    """Mean squares of what is left of the turns over different times, in motion, for the slower and the faster half."""
    trial = fold.tested.trial
    rung = tuple(rungs(fold.found))[-1][1]
    recording = delayed(repaired(fold.tested, rung, fold.found), fitted.offset, lag=False)
    tracked, phases, t = trial.tracked, trial.phases, trial.t_s
    angle = np.linalg.norm(trial.rates - trial.rates[fold.tested.first_rest].mean(axis=0), axis=1)
    total = np.append(0.0, np.cumsum(angle))
    spans = [(interval.start_s, interval.stop_s) for interval in fold.tested.recording.intervals if interval.activity != "rest"]
    rows: list[Row] = []
    for lag in LAGS_S:
        ends = [
            (int(a), int(b))
            for first, stop in phases
            if any(low <= t[first] and t[stop - 1] <= high for low, high in _joined(spans))
            for a, b in pairwise(np.arange(first, stop, trial.samples(lag)))
            if tracked[a] and tracked[b]
        ]
        if len(ends) < 8:
            continue
        used = np.unique(np.array(ends))
        turns = replace(
            recording,
            attitudes=Attitudes(t[used], trial.quaternions[used], np.full((used.size, 3), 1e-3)),
            intervals=tuple(Interval(str(k), "", float(t[a]), float(t[b])) for k, (a, b) in enumerate(ends)),
        )
        parts, theta, _, R, _ = _propagated(turns, fitted.G, fitted.bias)
        rate = np.rad2deg((total[used[parts.row]] - total[used[parts.start]]) / (used[parts.row] - used[parts.start]))
        turned = attitude.residual(R, np.broadcast_to(np.eye(3), R.shape))
        along = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)
        squares = np.square(np.rad2deg(theta)).sum(axis=1)
        parallel = np.square(np.rad2deg(np.einsum("mi,mi->m", theta, along)))
        slow = rate < np.median(rate)
        for which, own in (("slower", slow), ("faster", ~slow)):
            rows.append(
                {
                    "kind": "increments",
                    "trial": fold.tested.number,
                    "name": which,
                    "lag_s": lag,
                    "count": float(np.count_nonzero(own)),
                    "rate": float(rate[own].mean()),
                    "series_deg2": float(squares[own].mean()),
                    "parallel_deg2": float(parallel[own].mean()),
                }
            )
    return rows


def _joined(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Touching stretches as one."""
    out: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if out and low <= out[-1][1] + 1e-6:
            out[-1] = (out[-1][0], high)
        else:
            out.append((low, high))
    return out


# --- Floor --------------------------------------------------------------------------------------------------------------------


def simulated(one: Loaded, rung: Sequence[str], found: Found, fitted: Fitted, seed: int, counts: Sequence[int]) -> list[Loaded]:
    """A trial simulated again on its motion: M0 with the effects found, from other draws of the noise.

    The motion is that of the repaired rates over the whole trial. It is flown with the tags that are right, and the late ones
    are put back afterwards, which is exactly what a time offset does.
    """
    trial, own = one.trial, one.recording
    t = trial.t_s
    inside = trial.tracked & (t > t[0] + broad.SHORTEST_REST_S / 10) & (t < t[-1] - broad.SHORTEST_REST_S / 10)
    evenly = np.flatnonzero(inside)[:: trial.samples(1.0)]
    used = np.union1d(evenly, np.searchsorted(t, own.attitudes.t_s - 1e-9))
    sigma = np.full((used.size, 3), own.attitudes.sigma.mean(axis=0))
    places = np.searchsorted(t[used], own.attitudes.t_s - 1e-9)
    sigma[places] = own.attitudes.sigma
    rest = repaired(one, rung, found).gyro.rates
    level = _level(one, rung, found)
    whole = replace(
        own,
        gyro=replace(own.gyro, t_s=t - fitted.offset, rates=rest + level),
        attitudes=Attitudes(t[used], trial.quaternions[used], sigma),
        intervals=(Interval("whole", "", float(t[used[0]]), float(t[used[-1]])),),
    )
    bias = fitted.bias - fitted.G @ level
    motion = replayed(whole, fitted.G, bias)
    effects = _effects(rung, found)
    out = []
    for count in counts:
        flown = replay(whole, fitted.G, bias, effects, seed=seed, case=count, motion=motion)
        out.append(one.seen(replace(flown, gyro=replace(flown.gyro, t_s=t))))
    return out


def _level(one: Loaded, rung: Sequence[str], found: Found) -> Array:
    """Mean repaired rate of the first rest, (3,) rad/s."""
    rates = one.recording.gyro.rates[one.first_rest]
    return np.asarray((untruncated(rates, found.step) if "rate_truncation" in rung else rates).mean(axis=0))


def _effects(rung: Sequence[str], found: Found) -> list[Setting]:
    """The stream effects of a rung, for the simulator; the time offset is in the tags."""
    out = []
    if "rate_truncation" in rung:
        out.append(setting("rate_truncation", None, float(np.rad2deg(found.step))))
    if "stale_samples" in rung and found.fraction > 0:
        out.append(setting("stale_samples", None, max(found.mean_run, 1.0), {"fraction": found.fraction}))
    return out


def _floor_rows(
    config: RealConfig, trials: Sequence[Loaded], parted: Sequence[Fold], last: Mapping[str, list[tuple[Fold, Fitted]]]
) -> list[Row]:
    """What the last rung leaves on simulated trials, fitted on simulated others."""
    rows: list[Row] = []
    counts = range(config.floor_replays)
    flown: dict[str, list[Loaded]] = {}
    for one in trials:
        fold, fitted = last[one.number][0]
        rung = tuple(rungs(fold.found))[-1][1]
        # Streams are named by effect: the number keeps those of one trial from those of another.
        flown[one.number] = simulated(one, rung, fold.found, fitted, config.entropy + int(one.number), counts)
    for count in counts:
        for fold in parted:
            rung = tuple(rungs(fold.found))[-1][1]
            others = [_like(flown[other.number][count], other) for other in fold.others]
            fitted = fit(others, rung, fold.found)
            predictions = predicted(_like(flown[fold.tested.number][count], fold.tested), fitted, rung, fold.found)
            rows += _held_rows(fold.tested.number, "floor", str(count), predictions)
    return rows


def _like(flown: Loaded, part: Loaded) -> Loaded:
    """The intervals of a simulated trial that a fold has."""
    names = [interval.name for interval in part.recording.intervals]
    return flown if len(names) == len(flown.recording.intervals) else flown.only(names)


STUDY = Study("studies.real_gyro:STUDY", RealConfig, case)


def _report(config: RealConfig, rows: pd.DataFrame) -> Report:
    from studies import real_gyro_report  # it draws what is made here

    return real_gyro_report.report(rows)


ENTRY = Entry(STUDY, "what M0 lacks on recorded gyros, and how far held-out prediction improves (BROAD)", _report)
