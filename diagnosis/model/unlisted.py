"""Deterministic discrepancies that are on no list: the rivals for which the answer is "unknown".

A cause may be named only if it explains the data better than anything that behaves alike but is something else. The rivals
are therefore broad: rate errors that follow the rate in other ways (products, cubes, cross axes), that run with the time
since an interval's start or with mission time, which time tags may do as well, that repeat with any period
(`diagnosis.model.repeating`), that are locked to the orbit's harmonics, that differ from interval to interval, plain random
ones at several time scales, and the same on the side of the references. Narrow rivals let an unlisted effect pass as its
nearest listed neighbour.

Each family gives columns per unit amplitude; amplitudes are taken in terms of what the recording can show, since nothing is
known of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import unlisted_physics
from diagnosis.model.bins import AXES, Bins, Family, binned, observed, on_references, several, unit
from diagnosis.model.in_progress import steps_at_references
from diagnosis.model.recording import RecordingModel

Array = NDArray[np.float64]

DAY = 86400.0
WARM_UP = (200.0, 600.0, 1800.0)  # s
SEEN = 1e-6  # of the largest column, that one must have to be seen
PERIODS = 14  # counted from the start of each interval


def families(model: RecordingModel) -> Iterator[Family]:
    """All families with a few columns; the random ones are in `diagnosis.model.processes`."""
    bins = binned(model)
    yield from unlisted_physics.families(model, bins)
    yield from _rate_following(model, bins)
    yield from _in_time(model, bins)
    tags = of_tags(model, bins)
    if tags.columns:
        yield tags
    yield from _on_references(model)


def _rate_following(model: RecordingModel, bins: Bins) -> Iterator[Family]:
    w, a = bins.rates, bins.acceleration
    speed = np.abs(w)
    products = [w[:, [i]] * w[:, [j]] for i, j in combinations_with_replacement(range(3), 2)]
    yield from several(model, bins, "follows a product of rates", products)
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        across = np.column_stack([speed[:, others], (w * speed)[:, others], np.linalg.norm(w, axis=1)])
        columns = observed(model, bins, axis, unit(across))
        yield Family("follows the size of another axis' rate", AXES[axis], [columns[:, [k]] for k in range(columns.shape[1])])
    yield from several(model, bins, "follows the cube of a rate", [w[:, [k]] ** 3 for k in range(3)])
    for axis in range(3):
        columns = observed(model, bins, axis, unit(a))
        # The three axes together are a time offset or a lag; one of them alone is neither.
        yield Family("follows an angular acceleration", AXES[axis], [columns[:, [k]] for k in range(3)])
    mission = (bins.t_s - bins.t_s.mean())[:, None] / DAY
    yield from several(model, bins, "scale factor or misalignment drifts", [mission * w[:, [k]] for k in range(3)])
    warm = np.exp(-bins.since_s / 1000.0)[:, None]
    yield from several(model, bins, "scale factor or misalignment settles after a start", [warm * w[:, [k]] for k in range(3)])
    orbit = model.stream.orbit_period_s
    if np.isfinite(orbit):
        angle = 2 * np.pi / orbit * bins.t_s
        wave = np.column_stack([np.sin(angle), np.cos(angle)])
        yield from several(model, bins, "scale factor or misalignment at orbit rate", [wave * w[:, [k]] for k in range(3)])


def of_tags(model: RecordingModel, bins: Bins) -> Family:
    """Compute the columns of time tags that run late: the longer an interval lasts, or by a delay of each interval.

    Readings that are late by τ show −d(τ ω)/dt more. One delay for all, one that grows with mission time and one that steps
    once are listed effects. A single interval therefore has no rival here, and of two intervals a delay of each is no rival.
    """
    blocks = len(model.blocks)
    own = (bins.interval[:, None] == np.arange(blocks)).astype(float)
    late, faster = np.column_stack([bins.since_s, own]), np.append(1.0, np.zeros(blocks))
    errors = late[:, None, :] * bins.acceleration[:, :, None] + faster * bins.rates[:, :, None]
    columns = sum(observed(model, bins, axis, errors[:, axis]) for axis in range(3)) / np.maximum(late.max(axis=0), 1.0)
    seen = np.linalg.norm(columns, axis=0) > SEEN * np.linalg.norm(columns, axis=0).max()
    options = [columns[:, [0]]] * (blocks > 1) + [columns[:, 1:][:, seen[1:]]] * (blocks > 2)
    return Family("time tags run late", None, [one for one in options if one.any()])


def _in_time(model: RecordingModel, bins: Bins) -> Iterator[Family]:
    since, t = bins.since_s[:, None], bins.t_s[:, None]
    trend = [np.exp(-since / tau) for tau in WARM_UP] + [since]
    yield from several(model, bins, "bias runs with the time since an interval's start", trend)
    own = []
    for values in trend[1:]:
        each = np.zeros((len(values), len(model.blocks)))
        each[np.arange(len(values)), bins.interval] = values[:, 0]
        own.append(each)
    yield from several(model, bins, "bias runs in each interval in its own way", own)
    span = t - t.min()
    length = max(float(span.max()), 1.0)
    mission = [(span / length) ** 2, *(np.exp(-span / (length * f)) for f in (0.02, 0.1, 0.3))]
    yield from several(model, bins, "bias changes with mission time, not linearly", mission)
    longest = max(float(block.elapsed_s[-1]) for block in model.blocks)
    shortest = max(4.0 * float(np.median(np.diff(model.recording.attitudes.t_s))), longest / 60)
    orbit = model.stream.orbit_period_s
    if np.isfinite(orbit):
        waves = [_wave(t, orbit / k) for k in (2, 3, 4)]
        yield from several(model, bins, "bias at a harmonic of the orbit rate", waves)
    if longest > 2 * shortest:
        waves = [_wave(since, period) for period in np.geomspace(shortest, 2.5 * longest, PERIODS)]
        yield from several(model, bins, "bias of a period counted from each interval's start", waves)
        # The phases of a period are coherent over the gaps between intervals only if it is known to the gaps' length.
        if len(model.blocks) > 1:
            apart = [_per_interval(wave, bins.interval, len(model.blocks)) for wave in waves]
            yield from several(model, bins, "bias of a period, its phase another in each interval", apart)


def _per_interval(values: Array, interval: NDArray[np.intp], count: int) -> Array:
    """Columns (n, k) with an amplitude of their own in each interval, (n, k count)."""
    out = np.zeros((len(values), count, values.shape[1]))
    out[np.arange(len(values)), interval] = values
    return out.reshape(len(values), -1)


def _wave(t: Array, period: float) -> Array:
    angle = 2 * np.pi / period * t
    return np.hstack([np.sin(angle), np.cos(angle)])


def _on_references(model: RecordingModel) -> Iterator[Family]:
    references = model.references
    t = references.t_s[:, None]
    begin = np.array([model.t_s[block.steps.start] for block in model.blocks])
    since = t - begin[model.interval_of_reference][:, None]
    orbit = model.stream.orbit_period_s
    w = model.rates[steps_at_references(model)]
    groups: list[tuple[str, list[Array]]] = [
        ("references run with the time since an interval's start", [since, *(np.exp(-since / tau) for tau in WARM_UP[1:])]),
        ("references drift with mission time", [t - t.mean()]),
        ("references follow a rate", [w[:, [k]] for k in range(3)] + [np.abs(w[:, [k]]) for k in range(3)]),
        ("references differ between flight directions", _directions(references.forward)),
        ("references step at a time", _steps(model, t)),
    ]
    if np.isfinite(orbit):
        groups.append(("references at a higher harmonic of the orbit rate", [_wave(t, orbit / k) for k in (3, 4, 6)]))
    for name, options in groups:
        yield from on_references(model, name, options)


def _directions(forward: NDArray[np.str_]) -> list[Array]:
    """Indicator of each flight direction but those a listed effect covers."""
    return [(forward == name)[:, None].astype(float) for name in sorted(set(forward)) if name not in ("-x", "+x")]


def _steps(model: RecordingModel, t: Array) -> list[Array]:
    """Steps of the references inside each interval; between intervals they cannot be seen."""
    own = [t[model.interval_of_reference == number, 0] for number in range(len(model.blocks))]
    times = np.concatenate([np.linspace(one[0], one[-1], 7)[1:-1] for one in own])
    return [(t > time).astype(float) for time in times]
