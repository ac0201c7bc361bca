"""Plans unlike TRMM's: what the craft does, how it is sampled, what its gyro and its references are worth.

An interval's body rate is a sum of analytic pieces about axes of the body: a constant, turns with ramps of any share, a scan
that swings to and fro, sway at several frequencies, and a tumble ω = R(e, λt) w + λ e, whose attitude has the closed form A(t)
= R(e, λt) exp(−[w×]t) A(0). With an orbit the rate is that of an Earth-pointing `Profile` of the simulator. The attitude is
integrated by the simulator's sixth-order method from sample to sample, and a sample shows the integral of the rate over it.

A plan counts as one only where the baseline describes it (`studies.validation.wide.evidence`): the samples' mean rates must
lead from reference to reference, and the references must determine G. What fails that is drawn again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from gyrocal.recording import Attitudes, GyroStream, Interval, Orbit, Recording
from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.effects.housekeeping import COLUMN
from simulator.sensors.gyro import raw_rates
from simulator.truth.integration import integrate
from simulator.truth.maneuvers import MODE_YAW, Profile, Slew, Sway
from simulator.truth.motion import Motion
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import quaternion, turned

MOST_SAMPLES, MOST_REFERENCES = 200_000, 4000
SAME_S = 1e-6  # times closer than this are one
APRIORI_DEG = 3.0  # attitude error that the a-priori calibration may build up within an interval
QUIET_S = 20.0  # before and after a slew of an orbiting craft

Span = tuple[float, float]
Rate = Callable[[Array], Array]


@dataclass(frozen=True)
class Grade:
    """A class of gyro and the references that go with it; each a range, log-uniform.

    Attributes
    ----------
    arw : angle random walk, deg/√s
    bias : deg/s
    matrix : size of the elements of G − I
    sigma : of the references about each axis, deg
    """

    arw: Span
    bias: Span
    matrix: Span
    sigma: Span


ARCSEC = 1 / 3600
GRADES = {
    "mems_consumer": Grade((3e-3, 2e-2), (0.02, 0.5), (3e-3, 1.5e-2), (0.05, 1.0)),
    "mems_industrial": Grade((1e-3, 5e-3), (5e-3, 0.1), (1e-3, 5e-3), (0.02, 0.3)),
    "mems_tactical": Grade((3e-4, 1.5e-3), (5e-4, 2e-2), (5e-4, 3e-3), (0.005, 0.1)),
    "tuned_rotor": Grade((3e-5, 3e-4), (1e-4, 3e-3), (3e-4, 2e-3), (0.002, 0.05)),
    "fog_tactical": Grade((2e-4, 1e-3), (1e-4, 3e-3), (2e-4, 2e-3), (0.003, 0.05)),
    "fog_fine": Grade((1e-5, 1e-4), (1e-5, 3e-4), (1e-4, 1e-3), (2 * ARCSEC, 60 * ARCSEC)),
    "ring_laser": Grade((2e-5, 1e-4), (1e-6, 5e-5), (3e-5, 5e-4), (2 * ARCSEC, 40 * ARCSEC)),
    "resonator": Grade((2e-6, 3e-5), (1e-7, 3e-5), (2e-5, 5e-4), (1 * ARCSEC, 20 * ARCSEC)),
}


@dataclass(frozen=True)
class Kind:
    """A kind of plan; spans are log-uniform.

    Attributes
    ----------
    hz : sample rates to choose from
    intervals : fewest and most
    length_s : of an interval
    spacing_s : between references
    turn_deg_s : peak rates of turns
    turns : most in an interval
    sway_deg_s, sway_hz : of the real sway; None for none
    scan, tumble : whether the intervals swing to and fro, or tumble
    orbit : whether it orbits the Earth, and points to it between the slews
    """

    hz: tuple[float, ...]
    intervals: tuple[int, int]
    length_s: Span
    spacing_s: Span
    turn_deg_s: Span
    turns: int = 3
    sway_deg_s: Span | None = None
    sway_hz: Span = (0.05, 2.0)
    scan: bool = False
    tumble: bool = False
    orbit: bool = False


KINDS = {
    "slews_and_rests": Kind((1, 2, 5, 10), (4, 14), (300, 7200), (5, 300), (0.05, 1.5)),
    "hand_motion": Kind((50, 100), (1, 6), (60, 400), (0.1, 2), (2, 30), 8, (0.05, 5)),
    "earth_with_offsets": Kind((1, 2, 4), (4, 10), (1500, 9000), (20, 600), (0.05, 0.6), orbit=True),
    "bench": Kind((20, 50, 100, 200), (3, 30), (10, 120), (0.05, 2), (1, 20), 3),
    "scan": Kind((2, 5, 10), (3, 10), (600, 5400), (5, 120), (0.05, 1.0), 2, scan=True),
    "tumble": Kind((4, 10, 20, 50), (2, 8), (60, 1500), (0.5, 20), (0.1, 2.0), 2, tumble=True),
    "swaying_craft": Kind((20, 50, 100, 200), (2, 10), (60, 900), (0.1, 5), (0.5, 6), 4, (0.05, 2)),
    "slow_drift": Kind((1, 2, 5), (6, 40), (600, 21600), (30, 600), (0.02, 0.3), 2),
    "agile": Kind((5, 10, 20), (6, 40), (60, 900), (1, 30), (0.5, 4), 5),
    "earth_agile": Kind((2, 5, 10), (4, 12), (600, 4000), (5, 120), (0.1, 1.5), 3, (0.001, 0.02), (0.002, 0.05), orbit=True),
}


@dataclass(frozen=True)
class Plan:
    """The noise-free truth of a case.

    Attributes
    ----------
    motion : true rates and attitudes
    plain : noise-free recording
    G, bias : (3, 3), (3,) rad/s, true
    """

    motion: Motion
    plain: Recording
    G: Array
    bias: Array


@dataclass(frozen=True)
class Path:
    """The rate of an interval at local times from 0 to its length, its turns, and the attitude (4,) that it begins in."""

    rate: Rate
    length_s: float
    turns: tuple[Slew, ...]
    begin: Array

    @property
    def knots(self) -> Array:
        """Where the rate is not smooth, s."""
        return np.unique(np.concatenate([[0.0, self.length_s], *(turn.knots for turn in self.turns)]))


def tumbling(axis: Array, spin: float, w: Array) -> Rate:
    """ω = R(e, λt) w + λ e; (3,) unit vector, rad/s, (3,) rad/s."""
    return lambda tau: turned(axis, spin * tau, w) + spin * axis


def drawn_plan(rng: np.random.Generator, kind: Kind, grade: Grade, title: str, warm: float = 0.4) -> Plan:
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
    orbit = _orbit(rng) if kind.orbit else None
    through = rng.random() < 0.5  # references go on through slews
    paths, starts, modes = [], [], []
    start, begin, frame = 0.0, _attitude(rng), np.linalg.qr(rng.standard_normal((3, 3)))[0]
    for number, length in enumerate(lengths):
        modes.append(str(rng.choice(list(MODE_YAW))) if orbit else None)
        turns = _turns(rng, kind, length, frame, number)
        if orbit:
            paths.append(_pointing(rng, kind, orbit, start, length, turns, MODE_YAW[str(modes[-1])]))
        else:
            paths.append(_free(rng, kind, length, turns, begin, frame))
        starts.append(start)
        begin = _attitude(rng)
        start += float(np.ceil(length + log_uniform(rng, 0.2 * length, 30 * length)))
    motion = _motion(paths, np.array(starts), sample_s, spacing, through)
    return _recorded(rng, motion, grade, orbit, starts, paths, modes, sample_s, title, warm)


def _attitude(rng: np.random.Generator) -> Array:
    found = rng.standard_normal(4)
    return np.asarray(found / np.linalg.norm(found))


def _orbit(rng: np.random.Generator) -> CircularOrbit:
    node, latitude = (float(angle) for angle in rng.uniform(0, 2 * np.pi, 2))
    return CircularOrbit(log_uniform(rng, 3e5, 3e6), float(np.deg2rad(rng.uniform(0, 110))), node, latitude)


def _turns(rng: np.random.Generator, kind: Kind, length: float, frame: Array, number: int) -> list[Slew]:
    """Turns of an interval, one after another, about near the axes of a frame in their order, so that all of them come."""
    count = int(rng.integers(0 if number > 2 else 1, kind.turns + 1))
    edges = np.linspace(0, length, count + 1)
    out = []
    for place, (low, high) in enumerate(pairwise(edges)):
        room = min(high - low - 2 * min(QUIET_S, 0.1 * (high - low)), 600.0)
        duration = float(rng.uniform(0.3, 0.9)) * room
        first = float(low + rng.uniform(0.1, 0.9) * (high - low - duration))
        ramp = float(rng.choice([0.5, rng.uniform(0.15, 0.5)]))
        peak = np.deg2rad(log_uniform(rng, *kind.turn_deg_s)) * rng.choice([-1, 1])
        axis = frame[:, (number + place) % 3] + 0.2 * rng.standard_normal(3)
        out.append(Slew(axis / np.linalg.norm(axis), float(peak * duration * (1 - ramp)), first, duration, ramp))
    return out


def _sines(rng: np.random.Generator, amplitude: Span, hz: Span, most_hz: float) -> Rate:
    """Sway at three frequencies about each axis, rad/s."""
    size = np.deg2rad(log_uniform(rng, *amplitude)) * rng.uniform(0.2, 1, (3, 3)) / np.sqrt(3)
    turn = 2 * np.pi * np.array([[min(log_uniform(rng, *hz), most_hz) for _ in range(3)] for _ in range(3)])
    phase = rng.uniform(0, 2 * np.pi, (3, 3))
    return lambda tau: np.asarray((size * np.sin(tau[:, None, None] * turn + phase)).sum(axis=2))


def _free(rng: np.random.Generator, kind: Kind, length: float, turns: list[Slew], begin: Array, frame: Array) -> Path:
    """A craft, or a hand, without an orbit."""
    rest = np.deg2rad(log_uniform(rng, 1e-4, 2e-2)) * frame @ rng.standard_normal(3) * (rng.random() < 0.6)
    pieces: list[Rate] = [lambda tau: np.tile(rest, (len(tau), 1))]
    peak = np.deg2rad(log_uniform(rng, *kind.turn_deg_s))
    if kind.tumble:
        axis = frame[:, int(rng.integers(3))]
        pieces = [tumbling(axis, float(peak * rng.uniform(-1, 1)), peak * rng.standard_normal(3))]
    elif kind.scan:
        axis, period = frame[:, int(rng.integers(3))], length / rng.uniform(2, 12)
        pieces.append(lambda tau: peak * np.tanh(2 * np.sin(2 * np.pi / period * tau))[:, None] * axis)
    if kind.sway_deg_s:
        pieces.append(_sines(rng, kind.sway_deg_s, kind.sway_hz, np.inf))
    pieces += [lambda tau, turn=turn: turn.rates(tau)[:, None] * turn.axis for turn in turns]  # type: ignore[misc]
    return Path(lambda tau: np.asarray(sum(piece(tau) for piece in pieces)), length, tuple(turns), begin)


def _pointing(
    rng: np.random.Generator, kind: Kind, orbit: CircularOrbit, start: float, length: float, turns: list[Slew], yaw: float
) -> Path:
    """A craft that points to the Earth between its slews."""
    sway = None
    if kind.sway_deg_s:
        period = 1 / np.array([log_uniform(rng, *kind.sway_hz) for _ in range(3)])
        amplitude = np.deg2rad(log_uniform(rng, *kind.sway_deg_s)) * period / (2 * np.pi)
        sway = Sway(amplitude, period, rng.uniform(0, 2 * np.pi, 3))
    profile = Profile(orbit, start, start + length, yaw, tuple(turns), None, sway)
    return Path(profile.rate, length, tuple(turns), quaternion(profile.attitude(np.zeros(1)))[0])


def _motion(paths: list[Path], starts: Array, sample_s: float, spacing: float, through: bool) -> Motion:
    parts = []
    for path in paths:
        edges = np.asarray(sample_s * np.arange(round(path.length_s / sample_s) + 1), dtype=float)
        at = np.append(np.arange(0.0, path.length_s - max(0.3 * spacing, SAME_S), spacing), path.length_s)
        if not through and path.turns:
            at = at[~np.any([(at > turn.start) & (at < turn.stop) for turn in path.turns], axis=0)]
        grid = _joined(edges, at, path.knots)
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


def _joined(edges: Array, *more: Array) -> Array:
    """Sorted times; of those that are one, the edge of a sample stays."""
    others = np.concatenate(more)
    near = np.abs(others - edges[np.clip(np.searchsorted(edges, others - SAME_S), 0, len(edges) - 1)]) < 2 * SAME_S
    grid = np.unique(np.concatenate([edges, others[~near & (others > 0) & (others < edges[-1])]]))
    return grid[np.append(True, np.diff(grid) > SAME_S)]


def _recorded(
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
        rates=raw_rates(motion.rates, G, bias),
        sample_s=sample_s,
        arw=float(np.deg2rad(log_uniform(rng, *grade.arw))),
        apriori_G=apriori_G,
        apriori_bias=apriori_bias,
    )
    spans = [(start, start + path.length_s) for start, path in zip(starts, paths, strict=True)]
    rows = zip(spans, modes, strict=True)
    still = [not path.turns for path in paths]
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
    table = _temperature(rng, spans, orbit)
    if rng.random() < warm:
        plain = replace(plain, tables={"housekeeping": table})
    return Plan(motion, plain, G, bias)


def _temperature(rng: np.random.Generator, spans: list[Span], orbit: CircularOrbit | None) -> Any:
    """A gyro temperature: slow swings, warming after each switching on, a thermistor's noise."""
    typical = float(np.median([stop - start for start, stop in spans]))
    step = max(typical / 200, 1.0)
    t = np.unique(np.concatenate([np.append(np.arange(start, stop, step), stop) for start, stop in spans]))
    since = t - np.array([start for start, _ in spans])[np.searchsorted([start for start, _ in spans], t, side="right") - 1]
    periods = [typical * log_uniform(rng, 0.4, 3), typical * log_uniform(rng, 3, 30), orbit.period if orbit else 86400.0]
    swings = sum(rng.uniform(0.3, 2) * np.sin(2 * np.pi * t / period + rng.uniform(0, 6.28)) for period in periods)
    warming = rng.uniform(-3, 3) * (1 - np.exp(-since / (typical * rng.uniform(0.1, 0.5))))
    return pd.DataFrame({"t_s": t, COLUMN: rng.uniform(5, 40) + swings + warming + 0.01 * rng.standard_normal(t.size)})
