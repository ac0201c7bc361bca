"""Simulate a recording of a scenario.

The noise-free motion is the costly part and the same for every case of a Monte Carlo study; `motion` computes it once and
`observe` turns it into as many recordings as wanted.

Samples lie inside the intervals only, at t_k = start + k Δt < stop. If the interval is not a whole number of samples long
the last sample is cut at its stop: it shows the mean over what is left, with the noise of that duration.

Effects (`simulator.effects`) act on top of that; without any, the recording is that of the baseline M0, bit for bit.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from gyrocal.arrays import Array
from gyrocal.recording import Attitudes, GyroStream, Interval, Orbit, Recording
from simulator.effects import REGISTRY, Setting, Stream, Surroundings
from simulator.effects.chain import prepare_effects, simulate_readings, simulate_references
from simulator.effects.housekeeping_columns import simulate_gyro_temperature, simulate_table_acceleration
from simulator.effects.recording_view import extract_references, interpolate_housekeeping, read_period
from simulator.effects.sensor import SENSOR_EFFECTS
from simulator.scenario import Scenario, build_profiles
from simulator.sensors.gyro import add_white_noise, compute_raw_rates
from simulator.sensors.raw_tables import simulate_sensor_tables
from simulator.streams import generator
from simulator.truth.maneuvers import Profile, integrate_trajectory
from simulator.truth.motion import Motion
from simulator.truth.rotation import apply_rotation_errors

TIME_TOLERANCE = 1e-6  # s; times closer than this are one


def motion(scenario: Scenario, substeps: int = 1) -> Motion:
    """Simulate the noise-free truth of a scenario; substeps: integration steps per gyro sample."""
    parts = [_simulate_interval(profile, scenario, substeps) for profile in build_profiles(scenario)]

    def join(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts])

    reference_t_s = join("reference_t_s")
    # Where two intervals touch, the reference at the end of the first serves both.
    is_new = np.diff(reference_t_s, prepend=-np.inf) > TIME_TOLERANCE
    return Motion(
        t_s=join("t_s"),
        duration_s=join("duration_s"),
        rates=join("rates"),
        intervals=_build_slices([part.t_s.size for part in parts]),
        reference_t_s=reference_t_s[is_new],
        quaternions=join("quaternions")[is_new],
        sensor_t_s=join("sensor_t_s"),
        sensor_quaternions=join("sensor_quaternions"),
        sensor_intervals=_build_slices([part.sensor_t_s.size for part in parts]),
    )


def list_reference_times(profile: Profile, every: float | None) -> Array:
    """List local times of an interval's reference attitudes, (m,) s, strictly increasing, both ends included.

    A series is spaced by ``every``, s, from the interval's start; None for the two ends only.
    """
    length = profile.stop_s - profile.start_s
    if every is None:
        return np.array([0.0, length])
    inner = every * np.arange(1, int(np.ceil(length / every)))
    inner = inner[inner < length - TIME_TOLERANCE]
    for start, stop in profile.moving_spans:
        inner = inner[(inner <= start) | (inner >= stop)]
    return np.concatenate([[0.0], inner, [length]])


def _build_slices(counts: Sequence[int]) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(b)) for a, b in pairwise(np.cumsum([0, *counts])))


def _simulate_interval(profile: Profile, scenario: Scenario, substeps: int) -> Motion:
    """Simulate the motion of one interval."""
    length, section = profile.stop_s - profile.start_s, scenario.reference
    sample_s = scenario.gyro.sample_s
    edges = np.append(sample_s * np.arange(int(np.ceil(length / sample_s - TIME_TOLERANCE))), length)
    reference_tau = list_reference_times(profile, section.every_s if section.at == "series" else None)
    knots = profile.knots[(profile.knots > 0) & (profile.knots < length)]
    # Up to the last before the end, so that intervals that touch share no tag.
    spacing = scenario.sensors.every_s if scenario.sensors else None
    sensor_tau = np.asarray(spacing * np.arange(int(np.ceil(length / spacing))), dtype=float) if spacing else np.zeros(0)
    grid = np.unique(np.concatenate([edges, reference_tau, knots, sensor_tau]))
    path = integrate_trajectory(profile, grid, substeps)
    duration = np.diff(edges)
    angles = np.add.reduceat(path.angles, np.searchsorted(grid, edges[:-1]), axis=0)
    return Motion(
        t_s=profile.start_s + edges[:-1],
        duration_s=duration,
        rates=profile.rate(edges[:-1]) if scenario.gyro.reading == "point" else angles / duration[:, None],
        intervals=(),
        reference_t_s=profile.start_s + reference_tau,
        quaternions=path.quaternions[np.searchsorted(grid, reference_tau)],
        sensor_t_s=profile.start_s + sensor_tau,
        sensor_quaternions=path.quaternions[np.searchsorted(grid, sensor_tau)],
    )


def compute_noise_free_rates(scenario: Scenario, motion: Motion, G: Array | None = None, bias: Array | None = None) -> Array:
    """Compute the noise-free readings of the uncalibrated gyros, (n, 3) rad/s; G and bias as for `observe`."""
    true_G = np.array(scenario.gyro.true_G) if G is None else G
    true_bias = np.deg2rad(scenario.gyro.true_bias_deg_s) if bias is None else bias
    return compute_raw_rates(motion.rates, true_G, true_bias)


def realise(
    scenario: Scenario,
    motion: Motion,
    rates: Array,
    gyro_rng: np.random.Generator | None,
    reference_rng: np.random.Generator | None,
    *,
    out: Array | None = None,
) -> tuple[Array, Array]:
    """Draw one case's noise on noise-free rates and on the motion's attitudes.

    Parameters
    ----------
    rates : (n, 3) as made by `compute_noise_free_rates`, rad/s
    out : (n, 3) array the noisy rates are written to; a new one by default; others as for `observe`

    Returns
    -------
    Raw rates (n, 3), rad/s, and reference quaternions (m, 4).
    """
    if gyro_rng is not None:
        rates = add_white_noise(gyro_rng, rates, float(np.deg2rad(scenario.gyro.arw_deg_per_sqrt_s)), motion.duration_s, out)
    quaternions = motion.quaternions
    if reference_rng is not None:
        errors = reference_rng.standard_normal((len(quaternions), 3)) * np.deg2rad(scenario.reference.sigma_deg)
        quaternions = apply_rotation_errors(quaternions, errors)
    return rates, quaternions


def observe(
    scenario: Scenario,
    motion: Motion,
    *,
    gyro_rng: np.random.Generator | None,
    reference_rng: np.random.Generator | None,
    G: Array | None = None,
    bias: Array | None = None,
    effects: Sequence[Setting] = (),
    seed: int = 0,
    case: int = 0,
) -> Recording:
    """Simulate one recording of a motion.

    Parameters
    ----------
    scenario : what was simulated
    motion : its noise-free truth
    gyro_rng, reference_rng : sources of the gyro's and the references' noise; None for none
    G : (3, 3) true G in place of the scenario's
    bias : (3,) true bias in place of the scenario's, rad/s
    effects : errors beyond M0; they act with and without noise
    seed, case : of the effects' own random streams
    """
    if effects:
        noise_free = observe(scenario, motion, gyro_rng=None, reference_rng=None, G=G, bias=bias)
        noise_free = _add_housekeeping(noise_free, motion, effects, seed, case)
        point = scenario.gyro.reading == "point"
        return add_effects_and_noise(noise_free, motion, effects, gyro_rng, reference_rng, seed, case, point=point)
    gyro = scenario.gyro
    rates, quaternions = realise(scenario, motion, compute_noise_free_rates(scenario, motion, G, bias), gyro_rng, reference_rng)
    sigma = np.deg2rad(scenario.reference.sigma_deg)
    attitudes = Attitudes(motion.reference_t_s, quaternions, np.tile(sigma, (len(quaternions), 1)))
    return Recording(
        title=scenario.title,
        epoch=scenario.epoch,
        time_scale=scenario.time_scale,
        gyro=GyroStream(
            t_s=motion.t_s,
            rates=rates,
            sample_s=gyro.sample_s,
            arw=float(np.deg2rad(gyro.arw_deg_per_sqrt_s)),
            apriori_G=np.array(gyro.apriori_G),
            apriori_bias=np.deg2rad(gyro.apriori_bias_deg_s),
        ),
        attitudes=attitudes,
        intervals=tuple(Interval(part.name, part.activity, part.start_s, part.stop_s) for part in scenario.interval),
        orbit=Orbit(scenario.orbit.build_circular_orbit().period, scenario.orbit.altitude_km, scenario.orbit.inclination_deg),
    )


def add_effects_and_noise(
    noise_free: Recording,
    motion: Motion,
    effects: Sequence[Setting],
    gyro_rng: np.random.Generator | None,
    reference_rng: np.random.Generator | None,
    seed: int,
    case: int,
    point: bool = False,
    around: Surroundings | None = None,
) -> Recording:
    """Add effects and noise to a noise-free recording.

    Parameters
    ----------
    noise_free : noise-free rates and true attitudes of the motion, with the stated noise, the housekeeping and all else
    point : whether a sample shows the rate at its start
    around : `build_surroundings` of these, if they are at hand; the same for every case; others as for `observe`
    """
    active = prepare_effects(effects, seed, case)
    around = build_surroundings(noise_free, motion, point) if around is None else around
    return replace(
        noise_free,
        gyro=replace(noise_free.gyro, rates=simulate_readings(around, active, gyro_rng)),
        attitudes=replace(noise_free.attitudes, quaternions=simulate_references(around, active, reference_rng)),
    )


def build_surroundings(noise_free: Recording, motion: Motion, point: bool = False) -> Surroundings:
    """Build the noise-free truth as effects see it."""
    t_s = motion.t_s if point else motion.t_s + 0.5 * motion.duration_s
    stream = Stream(
        t_s=t_s,
        duration_s=motion.duration_s,
        rates=motion.rates,
        raw=noise_free.gyro.rates,
        intervals=motion.intervals,
        orbit_period_s=read_period(noise_free),
        span_s=(
            min(part.start_s for part in noise_free.intervals),
            max(part.stop_s for part in noise_free.intervals),
        ),
        housekeeping=interpolate_housekeeping(noise_free, t_s),
    )
    references, axes = extract_references(noise_free), noise_free.attitudes.build_error_axes()
    return Surroundings(stream, references, noise_free.gyro.arw, noise_free.gyro.sample_s, noise_free.attitudes.sigma, axes)


def add_gyro_temperature(noise_free: Recording, seed: int = 0, case: int = 0) -> Recording:
    """Add the simulator's gyro temperature to the housekeeping; without an orbit the recording is unchanged."""
    if noise_free.orbit is None:
        return noise_free
    spans = [(interval.start_s, interval.stop_s) for interval in noise_free.intervals]
    table = simulate_gyro_temperature(generator(seed, case, "housekeeping"), spans, noise_free.orbit.period_s)
    return replace(noise_free, tables={**noise_free.tables, "housekeeping": table})


def add_acceleration(noise_free: Recording, seed: int = 0, case: int = 0) -> Recording:
    """Add the accelerations of a body on a rate table to the housekeeping."""
    attitudes, table = noise_free.attitudes, noise_free.tables.get("housekeeping")
    accelerations = simulate_table_acceleration(generator(seed, case, "acceleration"), attitudes.t_s, attitudes.quaternions)
    merged = accelerations if table is None else table.merge(accelerations, on="t_s", how="outer")
    return replace(noise_free, tables={**noise_free.tables, "housekeeping": merged})


def _add_housekeeping(noise_free: Recording, motion: Motion, effects: Sequence[Setting], seed: int, case: int) -> Recording:
    """Add a gyro temperature or accelerations if an effect needs them."""

    def find_lacking(recording: Recording) -> set[str]:
        around = build_surroundings(recording, motion)
        return {effect.effect for effect in effects if REGISTRY[effect.effect].missing(around) is not None}

    recording = noise_free
    for add in (add_gyro_temperature, add_acceleration):
        lacking = find_lacking(recording)
        if not lacking:
            break
        extended = add(recording, seed, case)
        recording = extended if lacking - find_lacking(extended) else recording
    return recording


def make_noise_streams(seed: int, case: int, noise: bool) -> tuple[np.random.Generator | None, np.random.Generator | None]:
    """Make the streams of the gyro's and the references' noise of a case; None without noise."""
    if not noise:
        return None, None
    return generator(seed, case, "gyro_noise"), generator(seed, case, "reference_noise")


def simulate(
    scenario: Scenario, seed: int = 0, case: int = 0, noise: bool = True, effects: Sequence[Setting] = ()
) -> Recording:
    """Simulate a recording of a scenario; an `InputError` if there is an effect on the sensors and it has none.

    Parameters
    ----------
    scenario : what to simulate
    seed : entropy of the random streams
    case : number of the case within a study; cases with the same seed are independent
    noise : whether gyro and references have their white noise
    effects : errors beyond M0, see `simulator.effects.parse`
    """
    truth, (gyro_rng, reference_rng) = motion(scenario), make_noise_streams(seed, case, noise)
    on_sensors = [setting for setting in effects if setting.effect in SENSOR_EFFECTS]
    others = [setting for setting in effects if setting.effect not in SENSOR_EFFECTS]
    recording = observe(scenario, truth, gyro_rng=gyro_rng, reference_rng=reference_rng, effects=others, seed=seed, case=case)
    return replace(recording, sensors=simulate_sensor_tables(scenario, truth, on_sensors, seed, case, noise))
