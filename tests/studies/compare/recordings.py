"""Small recordings to compare: TRMM's six activities at 4 s with references every two minutes."""

from simulator import scenario
from simulator.effects import parse
from simulator.simulate import simulate

OVERRIDES = {
    "gyro.sample_s": 4.0,
    "reference.every_s": 120.0,
    "gyro.arw_deg_per_sqrt_s": 1.5e-4,
    "reference.sigma_deg.0": 0.005,
    "reference.sigma_deg.1": 0.005,
    "reference.sigma_deg.2": 0.008,
}


def plan():
    return scenario.override(scenario.load("trmm_series"), OVERRIDES)


def recorded(seed, *effects):
    return simulate(plan(), seed=seed, effects=[parse(text) for text in effects])
