"""Draw plans of spacecraft, rate tables and hand-held sensors: motion, sampling, gyro and references.

The simulator's sixth-order method integrates an analytic body rate from sample to sample; a sample is the mean rate.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gyrocal.arrays import Array
from gyrocal.recording import Attitudes, GyroStream, Interval, Orbit, Recording
from simulator.effects.housekeeping_columns import simulate_gyro_temperature
from simulator.sensors.gyro import compute_raw_rates
from simulator.truth.integration import integrate
from simulator.truth.maneuvers import MODE_YAW, Profile, Slew, Sway, smoothstep
from simulator.truth.motion import Motion
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import convert_to_quaternion, turn_frame

MOST_SAMPLES, MOST_REFERENCES = 60_000, 2500
SAME_S = 1e-6  # times closer than this are merged
APRIORI_DEG = 3.0  # attitude error that the a-priori calibration may build up within an interval
WARM_SHARE = 0.4  # of the recordings that have a gyro temperature
REST_S = 20.0  # before and after a turn
LONGEST_TURN_S = 600.0  # s, about one axis
ARCSEC = 1 / 3600

Span = tuple[float, float]
Rate = Callable[[Array], Array]  # (n,) s → (n, 3) rad/s


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number between two, uniform in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class Grade(NamedTuple):
    """A class of gyro and of the references that go with it; each range is log-uniform."""

    arw: Span  # deg/√s
    bias: Span  # deg/s
    matrix: Span  # size of the elements of G − I
    sigma: Span  # of the references about each axis, deg


GRADES = {
    "phone": Grade((3e-3, 2e-2), (0.02, 0.5), (3e-3, 1.5e-2), (0.05, 1.0)),
    "industrial MEMS": Grade((1e-3, 5e-3), (5e-3, 0.1), (1e-3, 5e-3), (0.02, 0.3)),
    "tactical MEMS": Grade((3e-4, 1.5e-3), (5e-4, 2e-2), (5e-4, 3e-3), (0.005, 0.1)),
    "tuned rotor": Grade((3e-5, 3e-4), (1e-4, 3e-3), (3e-4, 2e-3), (0.002, 0.05)),
    "open-loop coil": Grade((2e-4, 1e-3), (1e-4, 3e-3), (2e-4, 2e-3), (0.003, 0.05)),
    "closed-loop coil": Grade((1e-5, 1e-4), (1e-5, 3e-4), (1e-4, 1e-3), (2 * ARCSEC, 60 * ARCSEC)),
    "ring laser": Grade((2e-5, 1e-4), (1e-6, 5e-5), (3e-5, 5e-4), (2 * ARCSEC, 40 * ARCSEC)),
    "resonator": Grade((2e-6, 3e-5), (1e-7, 3e-5), (2e-5, 5e-4), (1 * ARCSEC, 20 * ARCSEC)),
    "coarse sky": Grade((3e-5, 2e-4), (1e-5, 1e-3), (1e-4, 1e-3), (0.1, 0.8)),
}


class Stretch(NamedTuple):
    """Motion of an interval."""

    rate: Rate
    turns: Sequence[Slew] = ()  # included in the rate
    breaks: Sequence[float] = ()  # further times where the rate is not smooth, s
    begin: Array | None = None  # (4,) start attitude, if it points to the Earth
    mode: str | None = None  # body axis along the velocity, if it points to the Earth


class Lot(NamedTuple):
    """Random generators and ranges of an interval's motion."""

    rng: np.random.Generator  # of the interval
    craft: np.random.Generator  # restarts in every interval: its first draws are the same in all, properties of the craft
    peaks: Span  # peak rates, deg/s
    length_s: float  # of the interval
    start_s: float  # since the epoch
    frame: Array  # (3, 3) columns are the carrier's axes in the gyros' frame
    number: int  # of the interval
    orbit: CircularOrbit

    def peak(self) -> float:
        """Draw a peak rate, rad/s."""
        return float(np.deg2rad(log_uniform(self.rng, *self.peaks)))

    def draw_turns(self, most: int) -> list[Slew]:
        """Draw up to `most` turns, one after the other; the first three intervals have at least one.

        Each is about one of the frame's axes, to whose components noise of 0.2 is added. A ramp of one half makes the rate a
        triangle.
        """
        least = 0 if self.number > 2 else 1
        edges = np.linspace(0, self.length_s, int(self.rng.integers(least, most + 1)) + 1)
        out = []
        for place, (low, high) in enumerate(pairwise(edges)):
            available_s = min(high - low - 2 * min(REST_S, 0.1 * (high - low)), LONGEST_TURN_S)
            duration = float(self.rng.uniform(0.3, 0.9)) * available_s
            start_s = float(low + self.rng.uniform(0.1, 0.9) * (high - low - duration))
            ramp = float(self.rng.choice([0.5, self.rng.uniform(0.15, 0.5)]))
            axis = self.frame[:, (self.number + place) % 3] + 0.2 * self.rng.standard_normal(3)
            angle = self.peak() * self.rng.choice([-1, 1]) * duration * (1 - ramp)
            out.append(Slew(axis / np.linalg.norm(axis), float(angle), start_s, duration, ramp))
        return out


def add_turns(turns: Sequence[Slew], tau: Array) -> Array:
    """Add up the body rates of turns about their axes, (n, 3) rad/s."""
    return np.asarray(sum((turn.rates(tau)[:, None] * turn.axis for turn in turns), np.zeros((len(tau), 3))))


# ---- spacecraft ------------------------------------------------------------------------------------------------------------


def draw_slews(lot: Lot, most: int = 3) -> Stretch:
    """Draw rests at a small constant rate, and turns."""
    turns = lot.draw_turns(most)
    drift = np.deg2rad(log_uniform(lot.rng, 1e-4, 2e-2)) * lot.rng.standard_normal(3) * (lot.rng.random() < 0.6)
    return Stretch(lambda tau: drift + add_turns(turns, tau), turns)


def draw_earth_pointing(lot: Lot) -> Stretch:
    """Draw pointing to the Earth in one of four modes between turns, with the sway of the attitude control."""
    period = np.array([log_uniform(lot.rng, 100.0, 500.0) for _ in range(3)])
    sway = Sway(np.deg2rad(lot.rng.uniform(0.002, 0.05, 3)), period, lot.rng.uniform(0, 2 * np.pi, 3))
    mode, turns = str(lot.rng.choice(list(MODE_YAW))), tuple(lot.draw_turns(3))
    profile = Profile(lot.orbit, lot.start_s, lot.start_s + lot.length_s, MODE_YAW[mode], turns, None, sway)
    return Stretch(profile.rate, turns, (), convert_to_quaternion(profile.attitude(np.zeros(1)))[0], mode)


def draw_tumble(lot: Lot) -> Stretch:
    """Draw a tumble ω = R(e, λt) w + λ e."""
    axis, peak = lot.frame[:, int(lot.rng.integers(3))], lot.peak()
    spin, w = float(peak * lot.rng.uniform(-1, 1)), peak * lot.rng.standard_normal(3)
    return Stretch(lambda tau: turn_frame(axis, spin * tau, w) + spin * axis)


def draw_spinner(lot: Lot) -> Stretch:
    """Draw a spin with a damped nutation, which a pulse of a thruster excites again and which may also change the spin."""
    ratio = lot.craft.choice([lot.craft.uniform(0.3, 0.8), lot.craft.uniform(1.2, 1.9)])
    spin, cone = np.deg2rad(log_uniform(lot.craft, *lot.peaks)), np.deg2rad(log_uniform(lot.craft, 2.0, 15.0))
    fire_s, phases, damping = lot.rng.uniform(0.3, 0.7) * lot.length_s, lot.rng.uniform(0, 6.28, 2), lot.rng.uniform(0.3, 3)
    pulse_s, change = 1.5 / spin, float(lot.rng.uniform(-0.5, 0.5)) * (lot.rng.random() < 0.5)
    e, u, v = lot.frame.T

    def rate(tau: Array) -> Array:
        s = spin * (1 + change * smoothstep((tau - fire_s) / (0.2 * lot.length_s)))
        nutation = np.exp(1j * phases[0] - tau / (damping * lot.length_s))
        excited = np.exp(1j * phases[1] - np.maximum(tau - fire_s, 0) / (damping * lot.length_s))
        nutation = nutation + smoothstep((tau - fire_s) / pulse_s) * excited
        nutation *= 0.5 * spin * ratio * np.tan(cone) * np.exp(1j * (ratio - 1) * spin * tau)
        return np.asarray(s[:, None] * e + nutation.real[:, None] * u + nutation.imag[:, None] * v)

    return Stretch(rate, (), (fire_s, fire_s + pulse_s, fire_s + 0.2 * lot.length_s))


# ---- rate tables and hands --------------------------------------------------------------------------------------------------


def draw_rate_table(lot: Lot) -> Stretch:
    """Draw a rate table's staircase of constant rates, up and down, about one axis of the gyros."""
    axis = lot.frame[:, lot.number % 3] + 0.02 * lot.craft.standard_normal(3)
    up = float(lot.rng.choice([-1.0, 1.0])) * lot.peak() * np.linspace(0, 1, int(lot.rng.integers(3, 7)))
    levels = np.concatenate([up, up[-2::-1], *([-up[1:], -up[-2::-1]] if lot.rng.random() < 0.5 else [])])
    step_times_s = np.linspace(0, lot.length_s, len(levels) + 1)[1:-1]
    ramp = float(lot.rng.uniform(0.1, 0.6)) * step_times_s[0]
    steps = list(zip(step_times_s, np.diff(levels), strict=True))
    return Stretch(
        lambda tau: np.asarray(sum(step * smoothstep((tau - time) / ramp) for time, step in steps))[:, None] * axis,
        (),
        [*step_times_s, *(step_times_s + ramp)],
    )


def draw_hand_motion(lot: Lot) -> Stretch:
    """Draw the motion of a hand that turns the gyros about all axes in sequence and always trembles."""
    turns, pace = lot.draw_turns(8), 2 * np.pi * np.exp(lot.rng.uniform(np.log(0.1), np.log(3.0), (3, 4)))
    tremble = np.deg2rad(log_uniform(lot.rng, 0.05, 2)) * lot.rng.uniform(0.3, 1.0, (3, 4)) * pace
    phase = lot.rng.uniform(0, 2 * np.pi, (3, 4))
    return Stretch(lambda tau: (tremble * np.cos(tau[:, None, None] * pace + phase)).sum(axis=2) + add_turns(turns, tau), turns)


class PlanKind(NamedTuple):
    """A kind of plan; ranges are log-uniform."""

    law: Callable[[Lot], Stretch]
    hz: tuple[float, ...]  # sample rates to choose from
    intervals: tuple[int, int]  # fewest and most
    length_s: Span  # of an interval
    spacing_s: Span  # between references
    peaks: Span  # peak rates, deg/s
    orbit: bool = False  # whether the recording states an orbit


PLANS = {
    "earth_pointing": PlanKind(draw_earth_pointing, (0.5, 1, 2, 4), (4, 10), (900, 7000), (20, 300), (0.05, 0.6), True),
    "earth_agile": PlanKind(draw_earth_pointing, (2, 5, 10), (4, 12), (600, 4000), (5, 120), (0.1, 1.5), True),
    "slews_and_rests": PlanKind(draw_slews, (1, 2, 5, 10), (4, 14), (300, 7200), (5, 300), (0.05, 1.5)),
    "slews_in_orbit": PlanKind(draw_slews, (1, 2, 5), (5, 14), (600, 5400), (10, 200), (0.05, 0.8), True),
    "agile": PlanKind(partial(draw_slews, most=6), (5, 10, 20), (6, 30), (60, 900), (1, 30), (0.5, 4)),
    "tumble": PlanKind(draw_tumble, (4, 10, 20, 50), (2, 8), (60, 1500), (0.5, 20), (0.1, 2.0)),
    "spinner": PlanKind(draw_spinner, (4, 10, 20), (3, 10), (120, 1800), (0.25, 20), (1, 20)),
    "rate_table": PlanKind(draw_rate_table, (20, 50, 100), (3, 18), (40, 400), (0.05, 2), (2, 40)),
    "hand_motion": PlanKind(draw_hand_motion, (50, 100), (1, 6), (60, 400), (0.1, 2), (2, 30)),
}


class Plan(NamedTuple):
    """The noise-free truth of a case."""

    kind: str
    grade: str
    motion: Motion
    plain: Recording  # without noise
    G: Array  # (3, 3), true


def draw_plan(rng: np.random.Generator, title: str) -> Plan:
    """Draw a kind of plan and a grade, and the noise-free recording of both."""
    name, grade_name = str(rng.choice(sorted(PLANS))), str(rng.choice(sorted(GRADES)))
    kind = PLANS[name]
    sample_s = 1 / float(rng.choice(kind.hz))
    lengths = np.array([log_uniform(rng, *kind.length_s) for _ in range(round(log_uniform(rng, *kind.intervals)))])
    lengths *= min(1.0, MOST_SAMPLES * sample_s / lengths.sum())
    lengths = np.maximum(np.round(lengths / sample_s), round(10 / sample_s)) * sample_s
    spacing = max(log_uniform(rng, *kind.spacing_s), sample_s, lengths.sum() / (MOST_REFERENCES - 2 * len(lengths)))
    spacing = sample_s * np.ceil(spacing / sample_s) if rng.random() < 0.75 else spacing
    node, latitude = (float(angle) for angle in rng.uniform(0, 2 * np.pi, 2))
    orbit = CircularOrbit(log_uniform(rng, 3e5, 3e6), float(np.deg2rad(rng.uniform(0, 110))), node, latitude)
    frame, craft, start, parts = np.linalg.qr(rng.standard_normal((3, 3)))[0], int(rng.integers(2**63)), 0.0, []
    through = rng.random() < 0.5  # whether there are references also during turns
    for number, length in enumerate(lengths):
        lot = Lot(rng, np.random.default_rng(craft), kind.peaks, float(length), start, frame, number, orbit)
        parts.append((start, float(length), kind.law(lot)))
        start += float(np.ceil(length + log_uniform(rng, 0.2 * length, 30 * length)))
    motion = _integrate_motion(rng, parts, sample_s, spacing, through)
    plain, G = _build_recording(rng, motion, GRADES[grade_name], parts, sample_s, title)
    if kind.orbit:
        plain = replace(plain, orbit=Orbit(orbit.period, orbit.altitude / 1e3, float(np.rad2deg(orbit.inclination))))
    if rng.random() < WARM_SHARE:
        period = orbit.period if kind.orbit else float(np.median(lengths)) * log_uniform(rng, 0.5, 5.0)
        spans = [(interval.start_s, interval.stop_s) for interval in plain.intervals]
        plain = replace(plain, tables={"housekeeping": simulate_gyro_temperature(rng, spans, period)})
    return Plan(name, grade_name, motion, plain, G)


def _integrate_motion(
    rng: np.random.Generator, parts: list[tuple[float, float, Stretch]], sample_s: float, spacing: float, through: bool
) -> Motion:
    """Integrate the drawn rates to mean rates of the samples and attitudes at the references."""
    columns = []
    for start, length, stretch in parts:
        edges = np.asarray(sample_s * np.arange(round(length / sample_s) + 1), dtype=float)
        times = np.append(np.arange(0.0, length - max(0.3 * spacing, SAME_S), spacing), edges[-1])
        if not through:
            for turn in stretch.turns:
                times = times[(times <= turn.start) | (times >= turn.stop)]
        knots = [knot for turn in stretch.turns for knot in turn.knots]
        grid = _merge_times(edges, times, np.array([*stretch.breaks, *knots]))
        begin = rng.standard_normal(4) if stretch.begin is None else stretch.begin
        path = integrate(stretch.rate, grid, begin / np.linalg.norm(begin))
        rates = np.add.reduceat(path.angles, np.searchsorted(grid, edges[:-1] - SAME_S), axis=0) / sample_s
        columns.append((start + edges[:-1], rates, start + times, path.quaternions[np.searchsorted(grid, times - SAME_S)]))
    ends = np.cumsum([0] + [len(part[0]) for part in columns])
    t_s, rates, reference_t_s, quaternions = (np.concatenate(column) for column in zip(*columns, strict=True))
    intervals = tuple(slice(int(a), int(b)) for a, b in pairwise(ends))
    return Motion(t_s, np.full(len(t_s), sample_s), rates, intervals, reference_t_s, quaternions)


def _merge_times(edges: Array, *further: Array) -> Array:
    """Merge and sort times; of times closer than `SAME_S`, the edge of a sample is kept."""
    others = np.concatenate(further)
    is_at_edge = np.abs(others - edges[np.clip(np.searchsorted(edges, others - SAME_S), 0, len(edges) - 1)]) < 2 * SAME_S
    grid = np.unique(np.concatenate([edges, others[~is_at_edge & (others > 0) & (others < edges[-1])]]))
    return grid[np.append(True, np.diff(grid) > SAME_S)]


def _build_recording(
    rng: np.random.Generator,
    motion: Motion,
    grade: Grade,
    parts: list[tuple[float, float, Stretch]],
    sample_s: float,
    title: str,
) -> tuple[Recording, Array]:
    """Build the noise-free recording and the true G; the a-priori calibration is near the truth but differs from it."""
    size = log_uniform(rng, *grade.matrix)
    G = np.eye(3) + size * rng.standard_normal((3, 3))
    bias = np.deg2rad(log_uniform(rng, *grade.bias)) * rng.standard_normal(3)
    turned_rad = max(float(np.abs(motion.rates[part]).sum(axis=0).max()) * sample_s for part in motion.intervals)
    allowed, longest = np.deg2rad(APRIORI_DEG), max(length for _, length, _ in parts)
    sigma = np.deg2rad(log_uniform(rng, *grade.sigma)) * rng.choice([1.0, 1.0, 1.5, 3.0], 3)
    gyro = GyroStream(
        t_s=motion.t_s,
        rates=compute_raw_rates(motion.rates, G, bias),
        sample_s=sample_s,
        arw=float(np.deg2rad(log_uniform(rng, *grade.arw))),
        apriori_G=G + min(0.3 * size, allowed / max(turned_rad, 1e-9)) * rng.standard_normal((3, 3)),
        apriori_bias=bias + min(0.3 * float(np.abs(bias).max()), allowed / longest) * rng.standard_normal(3),
    )
    intervals = tuple(
        Interval(f"i{k + 1:02d}", "turns" if part.turns else "rest", start, start + length, None if part.turns else part.mode)
        for k, (start, length, part) in enumerate(parts)
    )
    attitudes = Attitudes(motion.reference_t_s, motion.quaternions, np.tile(sigma, (len(motion.quaternions), 1)))
    return Recording(title=title, epoch="2020-01-01T00:00:00Z", gyro=gyro, attitudes=attitudes, intervals=intervals), G
