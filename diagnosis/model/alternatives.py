"""Deterministic alternatives outside the library: broad families of errors that a cause must beat.

A cause is identified only if it explains the data better than alternatives that behave similarly. With narrow families an
unlisted effect would be mistaken for its nearest listed neighbour, and a random process explains any slow error. The families
are

- rate errors that follow the rate in other ways: products, cubes, the acceleration, scale factors that drift;
- rate errors that run with the time since an interval's start or with mission time, or that repeat with any period counted
  from an interval's start;
- *directions*: sunlight and magnetic fields come from directions that are fixed inertially, or turn with the orbit. An error
  about body axis i that follows the component of such a direction along body axis k is a_jk(t) of the attitude matrix A times
  amplitudes for the inertial axes j; times cos nu and sin nu of the orbit angle u for directions that turn with it (the field
  of a dipole has n = 2 and a constant part);
- *temperatures*: besides themselves, which a listed effect has, their square, and the delayed temperature beside the present
  one; and scale factors and misalignments that follow them;
- *the past*: hysteresis keeps the sign of the last turn, or of the last change of the rate. Heat or charge of a slew decays
  after it, so that an error follows the rate, or its size, through a low-pass filter;
- the same on the side of the references. These have star catalogues, aberration and temperatures of their own, signals that
  come by two ways (an error of twice the heading), and mounts that bend, settle after a slew and have play.

Random errors are in `diagnosis.model.processes`. Each family has columns per unit amplitude; the prior of the amplitudes spans
the sizes that the recording can show.

Periodic rivals repeat with one of the periods that `diagnosis.model.periods` has found to explain most as a sine: shapes that
are no sine, and sines that may not be named.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, combinations_with_replacement

import numpy as np

from diagnosis.arrays import AXES
from diagnosis.model.bins import (
    Bins,
    build_bins,
    build_families,
    find_reference_bins,
    find_reference_steps,
    observe_rate_errors,
    observe_reference_errors,
)
from diagnosis.model.linear import CandidateColumns, build_rival
from diagnosis.model.periods import Found, Period, make_period_columns
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array, Indices
from simulator.effects.common import recursion

DAY = 86400.0

WARM_UP_S = (200.0, 600.0, 1800.0)  # time constants of errors that decay after an interval's start
MEMORY_S = (30.0, 100.0, 300.0, 1000.0)  # time constants after which the effect of a slew decays
LAGS_S = (300.0, 1000.0, 3000.0)  # by which an error follows a temperature
PERIODS = 14  # number of periods counted from an interval's start
LARGE = 0.1  # share of the largest rate, or of its largest change, from which on its sign is kept

Options = Mapping[str, list[Array]]  # of each family by name, the values (n, k) of each option

REPEATED = 4  # best periods at which a periodic shape that is no sine is tried
SHAPE = 3  # its harmonics of any phase
HIGHEST = 7  # its highest harmonic that is locked to the fundamental
DOUBLED = 2  # best periods that may be the second harmonics of others


def list_deterministic_rivals(model: RecordingModel) -> Iterator[CandidateColumns]:
    """Build all families with a few columns."""
    bins = build_bins(model)
    sides = (
        _follow_directions(model, bins),
        _follow_temperatures(model, bins),
        _follow_past(bins),
        _follow_rates(bins),
        _run_in_time(model, bins),
    )
    for name, options in chain.from_iterable(side.items() for side in sides):
        yield from build_families(name, options, partial(observe_rate_errors, model, bins))
    for name, options in {**_follow_surroundings(model, bins), **_follow_reference_courses(model)}.items():
        yield from build_families(
            name, [option for option in options if np.ptp(option, axis=0).any()], partial(observe_reference_errors, model)
        )


def _follow_rates(bins: Bins) -> Options:
    w = bins.rates
    mission = (bins.t_s - bins.t_s.mean())[:, None] / DAY
    warm = np.exp(-bins.since_s / 1000.0)[:, None]
    products = [w[:, [i]] * w[:, [j]] for i, j in combinations_with_replacement(range(3), 2)]
    return {
        "follows a product of rates": products,
        "follows the cube of a rate": _split_columns(w**3),
        # The three axes together are a time offset or a lag; one of them alone is neither.
        "follows an angular acceleration": _split_columns(bins.acceleration),
        "scale factor or misalignment drifts": _split_columns(mission * w),
        "scale factor or misalignment settles after a start": _split_columns(warm * w),
    }


def _run_in_time(model: RecordingModel, bins: Bins) -> Options:
    since, t, count = bins.since_s[:, None], bins.t_s[:, None], len(model.blocks)
    trend = [np.exp(-since / tau) for tau in WARM_UP_S] + [since]
    span = t - t.min()
    length = max(float(span.max()), 1.0)
    longest = max(float(block.elapsed_s[-1]) for block in model.blocks)
    shortest = max(4.0 * float(np.median(np.diff(model.recording.attitudes.t_s))), longest / 60)
    periods = np.geomspace(shortest, 2.5 * longest, PERIODS) if longest > 2 * shortest else np.array([])
    waves = [_build_wave(since, period) for period in periods]
    return {
        "bias runs with the time since an interval's start": trend,
        "bias runs in each interval in its own way": [_split_intervals(course, bins.interval, count) for course in trend[1:]],
        "bias changes with mission time, not linearly": [
            (span / length) ** 2, *(np.exp(-span / (length * share)) for share in (0.02, 0.1, 0.3)),
        ],
        "bias of a period counted from each interval's start": waves,
        # The phases of a period are coherent over the gaps between intervals only if it is known to the gaps' length.
        "bias of a period, its phase another in each interval": [
            _split_intervals(wave, bins.interval, count) for wave in waves if count > 1
        ],
    }  # fmt: skip


def _split_intervals(values: Array, interval: Indices, count: int) -> Array:
    """Give columns (n, k) an amplitude of their own in each interval, (n, count k)."""
    out = np.zeros((len(values), count, values.shape[1]))
    out[np.arange(len(values)), interval] = values
    return out.reshape(len(values), -1)


def _build_wave(t: Array, period: float) -> Array:
    angle = 2 * np.pi / period * t
    return np.hstack([np.sin(angle), np.cos(angle)])


def _split_columns(values: Array) -> list[Array]:
    return [values[:, [k]] for k in range(values.shape[1])]


def _follow_directions(model: RecordingModel, bins: Bins) -> Options:
    A, orbit = (bins.turned / bins.dt[:, None, None]).transpose(0, 2, 1), model.stream.orbit_period_s
    turning = (
        [turn_with_orbit(A[:, axis], bins.t_s, orbit, n) for axis in range(3) for n in (1, 2)] if np.isfinite(orbit) else []
    )
    return {
        "bias follows the direction to something in inertial space": [A[:, axis] for axis in range(3)],
        "bias follows a direction that turns with the orbit": turning,
    }


def build_second_harmonics(components: Array) -> Array:
    """Build (n, 5) even functions of a direction (n, 3), such as twice a heading: its products without their trace."""
    x, y, z = components.T
    return np.column_stack([x * y, x * z, y * z, x**2 - y**2, 2 * z**2 - x**2 - y**2])


def turn_with_orbit(components: Array, t_s: Array, orbit: float, order: int) -> Array:
    """Turn components (n, 3) of inertial axes along a body axis at a multiple of the orbit's rate, (n, 6 or 9)."""
    angle = 2 * np.pi / orbit * order * t_s[:, None]
    waves = [components * np.cos(angle), components * np.sin(angle)]
    return np.hstack(waves if order == 1 else [components, *waves])


def _follow_temperatures(model: RecordingModel, bins: Bins) -> Options:
    rates, errors = [], []
    for values in model.stream.housekeeping.values():
        known = np.interp(bins.t_s, model.t_s, values)
        centred = (known - known.mean())[:, None]
        if centred.any():
            lagging = [centred - filter_low_pass(centred, bins, lag) for lag in LAGS_S]
            errors += [centred**2, *lagging]
            rates += [centred * bins.rates[:, [k]] for k in range(3)]
    usable = [error for error in errors if np.isfinite(error).all() and error.any()]
    return {
        "bias follows the square of a housekeeping value, or its delayed value": usable,
        "scale factor or misalignment follows a housekeeping value": rates if usable else [],
    }


def _follow_past(bins: Bins) -> Options:
    signs = [keep_last_sign(values[:, axis], bins) for values in (bins.rates, bins.acceleration) for axis in range(3)]
    both = np.hstack([bins.rates, np.abs(bins.rates)])
    slow = [course for memory in MEMORY_S for course in _split_columns(filter_low_pass(both, bins, memory))]
    return {
        "bias keeps the sign of the last turn, or of the last change of a rate": [sign for sign in signs if np.ptp(sign) > 0],
        "bias follows the rates of the past": [course for course in slow if course.any()],
    }


def keep_last_sign(values: Array, bins: Bins) -> Array:
    """Hold the sign (n, 1) of the last of values (n,) that is large; zero before the first one of each interval."""
    large = np.abs(values) > LARGE * np.abs(values).max(initial=0.0)
    begins = np.diff(bins.interval, prepend=-1) != 0
    last = np.maximum.accumulate(np.where(large | begins, np.arange(values.size), 0))
    return np.where(large[last], np.sign(values[last]), 0.0)[:, None]


def filter_low_pass(values: Array, bins: Bins, memory: float) -> Array:
    """Pass values (n, k) through a first-order filter that is at rest when each interval begins."""
    out = np.zeros_like(values)
    for number in np.unique(bins.interval):
        members = np.flatnonzero(bins.interval == number)
        share = 1 - np.exp(-float(np.median(bins.dt[members])) / memory)
        decay = np.full(members.size, 1 - share)
        out[members] = np.column_stack([recursion(decay, share * course) for course in values[members].T])
    return out


def _follow_surroundings(model: RecordingModel, bins: Bins) -> Options:
    """List errors that follow a direction, a temperature or a load: of a star, of optics, of a mount that bends or has play."""
    A = model.at_reference.transpose(0, 2, 1)
    t_s, orbit = model.references.t_s, model.stream.orbit_period_s
    directions = [A[:, axis] for axis in range(3)]
    directions += [build_second_harmonics(A[:, axis]) for axis in range(3)]
    if np.isfinite(orbit):  # as the velocity, whose aberration it is
        directions += [turn_with_orbit(A[:, axis], t_s, orbit, 1) for axis in range(3)]
    step_indices, bin_indices = find_reference_steps(model), find_reference_bins(model, bins)
    loads = [
        course[bin_indices]
        for axis in range(3)
        for course in (keep_last_sign(bins.rates[:, axis], bins), bins.acceleration[:, [axis]])
    ]
    both = np.hstack([bins.rates, np.abs(bins.rates)])
    past = [course[bin_indices] for memory in MEMORY_S for course in _split_columns(filter_low_pass(both, bins, memory))]
    return {
        "references follow a direction": directions,
        "references follow a housekeeping value": [
            (values - values.mean())[step_indices, None] for values in model.stream.housekeeping.values()
        ],
        "references follow the torque or the sign of the last turn": loads,
        "references follow the rates of the past": past,
    }


def _follow_reference_courses(model: RecordingModel) -> Options:
    """List errors that follow time or a rate, differ between flight directions, or step inside an interval."""
    references = model.references
    t = references.t_s[:, None]
    begin = np.array([model.t_s[block.steps.start] for block in model.blocks])
    since = t - begin[model.interval_of_reference][:, None]
    orbit, w = model.stream.orbit_period_s, model.rates[find_reference_steps(model)]
    others = sorted(set(references.forward) - {"-x", "+x"})  # which a listed effect covers
    inside = [t[model.interval_of_reference == number, 0] for number in range(len(model.blocks))]
    times = np.concatenate([np.linspace(interval_times[0], interval_times[-1], 7)[1:-1] for interval_times in inside])
    return {
        "references run with the time since an interval's start": [
            since, *(np.exp(-since / tau) for tau in WARM_UP_S[1:]),
        ],
        "references drift with mission time": [t - t.mean()],
        "references follow a rate": _split_columns(np.hstack([w, np.abs(w)])),
        "references differ between flight directions": [(references.forward == name)[:, None].astype(float) for name in others],
        "references step at a time": [(t > time).astype(float) for time in times],
        "references at a higher harmonic of the orbit rate": [
            _build_wave(t, orbit / k) for k in (3, 4, 6) if np.isfinite(orbit)
        ],
    }  # fmt: skip


def list_periodic_rivals(model: RecordingModel, periods_by_axis: Found, listed: Collection[bool]) -> Iterator[CandidateColumns]:
    """List unlisted rivals that repeat with any period: not as a sine, and as a sine where no listed effect does.

    The k-th harmonic of a shape with jumps falls as 1/k. Either the second and the third one have any phase; or those of a
    square wave, sin kθ/k of odd k, or these and those of even k, as in a sawtooth, are locked to the phase θ of the
    fundamental. With fewer parameters, a weak harmonic has more evidence. A period whose fundamental is weak is found at its
    second harmonic. `listed` holds the kinds of error, of the references or not, of which a listed effect is a sinusoid.
    """
    for (on_references, axis), periods in periods_by_axis.items():
        behaviour = "references repeat" if on_references else "bias repeats"
        doubled = [replace(period, frequency=0.5 * period.frequency) for period in periods[:DOUBLED]]
        options: list[Array] = []
        option_periods: list[Period] = []
        for period in [*periods[:REPEATED], *doubled]:
            orders = period.frequency * np.arange(1.0, HIGHEST + 1)
            shapes = make_shapes(model, make_period_columns(model, axis, on_references, orders))
            options += shapes
            option_periods += [replace(period, log_weight=period.log_weight - float(np.log(len(shapes))))] * len(shapes)
        yield _build_periodic_rival(model, f"{behaviour} with a period, not as a sine", axis, options, option_periods)
        if on_references not in listed:
            sines = make_period_columns(model, axis, on_references, np.array([period.frequency for period in periods]))
            yield _build_periodic_rival(model, f"{behaviour} with another period", axis, sines, periods)


def make_shapes(model: RecordingModel, waves: Sequence[Array]) -> list[Array]:
    """Make shapes that repeat from sine and cosine (N, 2) of each order, the fundamental first.

    Each is (N, k) columns of which the first two are sine and cosine of the fundamental.
    """
    falling = [wave / order for order, wave in enumerate(waves, 1)]
    X = model.project_out_nuisance(waves[0])
    sine, cosine = np.linalg.lstsq(X, model.y, rcond=None)[0]
    theta = np.arctan2(cosine, sine)
    # sin k(ωt + φ) of sine and cosine of kωt
    locked = [wave @ [np.cos(k * theta), np.sin(k * theta)] for k, wave in enumerate(falling, 1)]
    odd, even = (sum(harmonics, np.zeros(len(X))) for harmonics in (locked[2::2], locked[1::2]))
    return [np.hstack(falling[:SHAPE]), np.column_stack([waves[0], odd]), np.column_stack([waves[0], odd, even])]


def _build_periodic_rival(
    model: RecordingModel, name: str, axis: int, options: list[Array], periods: Sequence[Period]
) -> CandidateColumns:
    """Build a rival whose options are scaled so that their first two columns have unit size: amplitudes then compare."""
    sizes = [float(np.linalg.norm(model.project_out_nuisance(part[:, :2]))) for part in options]
    scaled = [part / max(size, 1e-300) for part, size in zip(options, sizes, strict=True)]
    weights = np.exp([period.log_weight for period in periods])
    return replace(build_rival(name, AXES[axis], scaled, weights=weights), scanned=True)
