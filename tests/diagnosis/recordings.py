"""Small simulated recordings, each made and prepared once."""

from dataclasses import replace
from functools import lru_cache
from itertools import accumulate

import numpy as np
from scipy.spatial.transform import Rotation

from diagnosis.model.candidates import build_linear_model
from diagnosis.model.prepare import prepare
from diagnosis.settings import DiagnosisSettings
from gyrocal import Orbit
from gyrocal.recording import Recording
from simulator import scenario
from simulator.effects import EFFECTS, parse
from simulator.simulate import simulate
from tests.builders import piecewise_recording

QUICK = DiagnosisSettings(null_draws=20)  # where only the kind of an answer matters
AXES = np.vstack([np.eye(3), -np.eye(3), np.ones((1, 3)) / np.sqrt(3)])
NOISE = {"gyro.arw_deg_per_sqrt_s": 1.5e-4, "reference.sigma_deg": (0.005, 0.005, 0.008)}


def slews(seed=1):
    """Seven slews of 90 deg, about each axis and the diagonal, with rests."""
    turns = tuple(((np.zeros(3), 20.0), (np.deg2rad(1.5) * axis, 60.0), (np.zeros(3), 20.0)) for axis in AXES)
    noise = {"sigma_deg": 0.01, "arw": np.deg2rad(2e-4), "rng": np.random.default_rng(seed)}
    return replace(piecewise_recording(turns, 0.5, series_s=5.0, gap_s=50.0, **noise), orbit=Orbit(500.0, 350.0, 35.0))


@lru_cache
def plan(sample_s=2.0, every_s=120.0):
    """The six intervals of the flight with a series of references: a tenth of the data, and the same motion."""
    changes = {"gyro.sample_s": sample_s, "reference.every_s": every_s}
    return scenario.override(scenario.load("trmm_series"), NOISE | changes)


@lru_cache
def recorded(seed, *effects, sample_s=2.0, every_s=120.0):
    """A recording of it with effects as text."""
    return simulate(plan(sample_s, every_s), seed=seed, effects=[parse(text) for text in effects])


@lru_cache
def prepared(seed, *effects, sample_s=2.0, every_s=120.0):
    """The same, prepared."""
    return prepare(recorded(seed, *effects, sample_s=sample_s, every_s=every_s))


@lru_cache
def linear(seed, *effects, sample_s=2.0, every_s=120.0):
    """The linear model of the same, with all effects and rivals."""
    model = prepared(seed, *effects, sample_s=sample_s, every_s=every_s).model
    return build_linear_model(model, list(EFFECTS.values()))


def slews_between_references(gaps, each, sample_s, sway):
    """(n, 3) rad/s of a body that slews within one gap of ten between references, and hardly sways otherwise."""
    t_s = sample_s * np.arange(gaps * each)
    rates = sway * np.sin(2 * np.pi * t_s[:, None] / np.array([143.0, 217.0, 331.0]) + np.arange(3))
    low, high = each // 7, each - each // 7
    for gap in range(5, gaps, 10):
        rates[gap * each + low : gap * each + high, gap // 10 % 3] += 0.004 * (-1) ** (gap // 30)
    return rates


def of_rates(rates, each, sample_s, arw, sigma, seed, **options):
    """A recording of a body with rates (n, 3) rad/s, by a gyro without error, with a reference after every `each` samples."""
    rng, gaps = np.random.default_rng(seed), len(rates) // each
    turns = Rotation.identity(gaps)
    for k in range(each):
        turns = turns * Rotation.from_rotvec(rates[k::each][:gaps] * sample_s)
    attitudes = list(accumulate(turns.as_matrix(), np.matmul, initial=np.eye(3)))
    noisy = Rotation.from_matrix(attitudes) * Rotation.from_rotvec(sigma * rng.standard_normal((gaps + 1, 3)))
    read = rates + arw / np.sqrt(sample_s) * rng.standard_normal(rates.shape)
    tags, times = sample_s * np.arange(len(rates)), each * sample_s * np.arange(gaps + 1)
    return Recording.from_arrays(tags, read, times, noisy.as_quat(), sigma=sigma, arw=arw, **options)
