"""Reference attitudes by several star trackers: when each sees, how it is truly mounted, and its noise about its own axes.

A tracker with the stated mounting M (body to tracker) is truly mounted by exp([m×]) M, and measures

    A_s = exp([ν×]) exp([m×]) M A,    ν ~ N(0, diag(σ²)) about its own axes

of which the recording makes the body attitude Mᵀ A_s. It sees nothing while the body turns too fast, and nothing while the Sun
is too near to its boresight, its z axis: both only leave gaps, and are a property of the scenario.
"""

import numpy as np

from gyrocal.recording import Attitudes, Orbit
from simulator.arrays import Flags
from simulator.scenario import Scenario, TrackerSection
from simulator.truth.motion import Motion
from simulator.truth.rotation import apply_rotation_errors, convert_to_matrix
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector


def simulate_tracker_references(scenario: Scenario, motion: Motion, rng: np.random.Generator | None) -> Attitudes:
    """References of all trackers in the order of time; without a source of randomness, free of noise."""
    sections = scenario.reference.tracker
    sensors = tuple(section.build_header().sensor for section in sections)
    seen = [np.flatnonzero(has_tracker_attitude(section, scenario, motion)) for section in sections]
    place, sensor = np.concatenate(seen), np.repeat(np.arange(len(seen)), [rows.size for rows in seen])
    order = np.lexsort((sensor, place))
    place, sensor = place[order], sensor[order]
    to_body = np.array([one.M.T for one in sensors])[sensor]
    sigma = np.deg2rad([section.sigma_deg for section in sections])[sensor]
    turned = np.deg2rad([section.misalignment_deg for section in sections])[sensor]
    quaternions = motion.quaternions[place]
    if turned.any():
        quaternions = apply_rotation_errors(quaternions, np.einsum("mij,mj->mi", to_body, turned))
    if rng is not None:
        noise = rng.standard_normal(sigma.shape) * sigma
        quaternions = apply_rotation_errors(quaternions, np.einsum("mij,mj->mi", to_body, noise))
    return Attitudes(motion.reference_t_s[place], quaternions, sigma, sensor, sensors)


def has_tracker_attitude(section: TrackerSection, scenario: Scenario, motion: Motion) -> Flags:
    """(m,) whether a tracker has an attitude at each reference time."""
    out = np.ones(motion.reference_t_s.size, dtype=bool)
    if section.max_rate_deg_s is not None:
        sample = np.clip(np.searchsorted(motion.t_s, motion.reference_t_s, side="right") - 1, 0, None)
        out &= np.linalg.norm(motion.rates[sample], axis=1) <= np.deg2rad(section.max_rate_deg_s)
    if section.sun_exclusion_deg is not None:
        boresight = np.einsum("mji,j->mi", convert_to_matrix(motion.quaternions), section.build_header().sensor.M[2])
        sun = compute_sun_vector(compute_julian_date(scenario.epoch) + motion.reference_t_s / DAY)
        out &= np.einsum("mi,mi->m", boresight, sun) < np.cos(np.deg2rad(section.sun_exclusion_deg))
    return out


def build_recorded_orbit(scenario: Scenario) -> Orbit:
    """The orbit as the recording states it; with trackers also where on it the epoch is, by which aberration is known."""
    orbit = scenario.orbit
    elements = (orbit.raan_deg, orbit.argument_of_latitude_deg) if scenario.reference.tracker else (None, None)
    return Orbit(orbit.build_circular_orbit().period, orbit.altitude_km, orbit.inclination_deg, *elements)
