"""Plans unlike TRMM's: what the craft does, how it is sampled, what its gyro and its references are worth.

The attitude is integrated by the simulator's sixth-order method from sample to sample, and a sample shows the integral of the
rate (`studies.validation.world.paths`) over it.

A plan counts as one only where the baseline describes it (`studies.validation.world.evidence`): the samples' mean rates must
lead from reference to reference, and the references must determine G. What fails that is drawn again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from gyrocal.recording import Attitudes, GyroStream, Interval, Orbit, Recording
from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.effects.housekeeping_columns import TEMPERATURE_COLUMN
from simulator.sensors.gyro import compute_raw_rates
from simulator.truth.integration import integrate
from simulator.truth.maneuvers import MODE_YAW
from simulator.truth.motion import Motion
from simulator.truth.orbit import CircularOrbit
from studies.validation.world.kinds import Grade, Kind, Span
from studies.validation.world.paths import Path, draw_free_path, draw_law_path, draw_pointing_path, draw_turns

MOST_SAMPLES, MOST_REFERENCES = 200_000, 4000
SAME_S = 1e-6  # times closer than this are one
APRIORI_DEG = 3.0  # attitude error that the a-priori calibration may build up within an interval


@dataclass(frozen=True)
class Plan:
    """The noise-free truth of a case.

    Attributes
    ----------
    motion : true rates and attitudes
    plain : noise-free recording
    G, bias : (3, 3), (3,) rad/s, true
    noise_axes : (m, 3, 3) from the body to the axes that sigma of each reference is about; None for the body's
    """

    motion: Motion
    plain: Recording
    G: Array
    bias: Array
    noise_axes: Array | None = None


def draw_generic_plan(rng: np.random.Generator, kind: Kind, grade: Grade, title: str, warm: float = 0.4) -> Plan:
    """A plan with its gyro, references and noise-free recording.

    Parameters
    ----------
    rng : source of all that is drawn
    kind, grade : what from
    title : of the recording
    warm : share of the recordings that have a gyro temperature
    """
    sample_s = 1 / float(rng.choice(kind.hz))
    count = round(log_uniform(rng, *kind.intervals))
    lengths = np.array([log_uniform(rng, *kind.length_s) for _ in range(count)])
    lengths *= min(1.0, MOST_SAMPLES * sample_s / lengths.sum())
    lengths = np.maximum(np.round(lengths / sample_s), round(10 / sample_s)) * sample_s
    spacing = max(log_uniform(rng, *kind.spacing_s), sample_s, lengths.sum() / (MOST_REFERENCES - 2 * count))
    on_edges = rng.random() < 0.75
    spacing = sample_s * max(1, np.ceil(spacing / sample_s)) if on_edges else spacing
    orbit = _draw_orbit(rng) if kind.orbit else None
    through = rng.random() < 0.5  # references go on through slews
    paths, starts, modes = [], [], []
    start, begin, frame = 0.0, _draw_attitude(rng), np.linalg.qr(rng.standard_normal((3, 3)))[0]
    craft = int(rng.integers(2**63)) if kind.motion else 0
    for number, length in enumerate(lengths):
        modes.append(str(rng.choice(list(MODE_YAW))) if orbit and not kind.motion else None)
        turns = [] if kind.motion else draw_turns(rng, kind, length, frame, number)
        if kind.motion:
            paths.append(draw_law_path(rng, craft, kind, orbit, start, length, begin, frame, number))
        elif orbit:
            paths.append(draw_pointing_path(rng, kind, orbit, start, length, turns, MODE_YAW[str(modes[-1])]))
        else:
            paths.append(draw_free_path(rng, kind, length, turns, begin, frame))
        starts.append(start)
        begin = _draw_attitude(rng)
        start += float(np.ceil(length + log_uniform(rng, 0.2 * length, 30 * length)))
    motion = _integrate_motion(paths, np.array(starts), sample_s, spacing, through)
    return _build_noise_free_plan(rng, motion, grade, orbit, starts, paths, modes, sample_s, title, warm)


def _draw_attitude(rng: np.random.Generator) -> Array:
    found = rng.standard_normal(4)
    return np.asarray(found / np.linalg.norm(found))


def _draw_orbit(rng: np.random.Generator) -> CircularOrbit:
    node, latitude = (float(angle) for angle in rng.uniform(0, 2 * np.pi, 2))
    return CircularOrbit(log_uniform(rng, 3e5, 3e6), float(np.deg2rad(rng.uniform(0, 110))), node, latitude)


def _integrate_motion(paths: list[Path], starts: Array, sample_s: float, spacing: float, through: bool) -> Motion:
    parts = []
    for path in paths:
        edges = np.asarray(sample_s * np.arange(round(path.length_s / sample_s) + 1), dtype=float)
        at = np.append(np.arange(0.0, path.length_s - max(0.3 * spacing, SAME_S), spacing), path.length_s)
        if not through and path.turns:
            at = at[~np.any([(at > turn.start) & (at < turn.stop) for turn in path.turns], axis=0)]
        grid = _merge_times(edges, at, path.knots)
        flown = integrate(path.rate, grid, path.begin)
        first = np.searchsorted(grid, edges[:-1] - SAME_S)
        rates = np.add.reduceat(flown.angles, first, axis=0) / sample_s
        parts.append((edges[:-1], rates, at, flown.quaternions[np.searchsorted(grid, at - SAME_S)]))
    ends = np.cumsum([0] + [len(part[0]) for part in parts])
    return Motion(
        t_s=np.concatenate([start + part[0] for start, part in zip(starts, parts, strict=True)]),
        duration_s=np.full(int(ends[-1]), sample_s),
        rates=np.concatenate([part[1] for part in parts]),
        intervals=tuple(slice(int(a), int(b)) for a, b in pairwise(ends)),
        reference_t_s=np.concatenate([start + part[2] for start, part in zip(starts, parts, strict=True)]),
        quaternions=np.concatenate([part[3] for part in parts]),
    )


def _merge_times(edges: Array, *more: Array) -> Array:
    """Sorted times; of those that are one, the edge of a sample stays."""
    others = np.concatenate(more)
    near = np.abs(others - edges[np.clip(np.searchsorted(edges, others - SAME_S), 0, len(edges) - 1)]) < 2 * SAME_S
    grid = np.unique(np.concatenate([edges, others[~near & (others > 0) & (others < edges[-1])]]))
    return grid[np.append(True, np.diff(grid) > SAME_S)]


def _build_noise_free_plan(
    rng: np.random.Generator, motion: Motion, grade: Grade, orbit: CircularOrbit | None, starts: list[float], paths: list[Path],
    modes: list[str | None], sample_s: float, title: str, warm: float,
) -> Plan:  # fmt: skip
    """Gyro and references of the plan; the a-priori calibration is near the truth, and not it."""
    size = log_uniform(rng, *grade.matrix)
    G = np.eye(3) + size * rng.standard_normal((3, 3))
    bias = np.deg2rad(log_uniform(rng, *grade.bias)) * rng.standard_normal(3)
    turned_rad = max(float(np.abs(motion.rates[part]).sum(axis=0).max()) * sample_s for part in motion.intervals)
    longest = max(path.length_s for path in paths)
    allowed = np.deg2rad(APRIORI_DEG)
    apriori_G = G + min(0.3 * size, allowed / max(turned_rad, 1e-9)) * rng.standard_normal((3, 3))
    apriori_bias = bias + min(0.3 * float(np.abs(bias).max()), allowed / longest) * rng.standard_normal(3)
    sigma = np.deg2rad(log_uniform(rng, *grade.sigma)) * rng.choice([1.0, 1.0, 1.5, 3.0], 3)
    gyro = GyroStream(
        t_s=motion.t_s,
        rates=compute_raw_rates(motion.rates, G, bias),
        sample_s=sample_s,
        arw=float(np.deg2rad(log_uniform(rng, *grade.arw))),
        apriori_G=apriori_G,
        apriori_bias=apriori_bias,
    )
    spans = [(start, start + path.length_s) for start, path in zip(starts, paths, strict=True)]
    rows = zip(spans, modes, strict=True)
    still = [path.still for path in paths]
    plain = Recording(
        title=title,
        epoch="2020-01-01T00:00:00Z",
        gyro=gyro,
        attitudes=Attitudes(motion.reference_t_s, motion.quaternions, np.tile(sigma, (len(motion.quaternions), 1))),
        intervals=tuple(
            Interval(f"i{k + 1:02d}", "rest" if still[k] else "turns", *span, mode if still[k] else None)
            for k, (span, mode) in enumerate(rows)
        ),
        orbit=Orbit(orbit.period, orbit.altitude / 1e3, float(np.rad2deg(orbit.inclination))) if orbit else None,
    )
    table = _draw_temperature(rng, spans, orbit)
    if rng.random() < warm:
        plain = replace(plain, tables={"housekeeping": table})
    return Plan(motion, plain, G, bias)


def _draw_temperature(rng: np.random.Generator, spans: list[Span], orbit: CircularOrbit | None) -> Any:
    """A gyro temperature: slow swings, warming after each switching on, a thermistor's noise."""
    typical = float(np.median([stop - start for start, stop in spans]))
    step = max(typical / 200, 1.0)
    t = np.unique(np.concatenate([np.append(np.arange(start, stop, step), stop) for start, stop in spans]))
    since = t - np.array([start for start, _ in spans])[np.searchsorted([start for start, _ in spans], t, side="right") - 1]
    periods = [typical * log_uniform(rng, 0.4, 3), typical * log_uniform(rng, 3, 30), orbit.period if orbit else 86400.0]
    swings = sum(rng.uniform(0.3, 2) * np.sin(2 * np.pi * t / period + rng.uniform(0, 6.28)) for period in periods)
    warming = rng.uniform(-3, 3) * (1 - np.exp(-since / (typical * rng.uniform(0.1, 0.5))))
    return pd.DataFrame(
        {"t_s": t, TEMPERATURE_COLUMN: rng.uniform(5, 40) + swings + warming + 0.01 * rng.standard_normal(t.size)}
    )
