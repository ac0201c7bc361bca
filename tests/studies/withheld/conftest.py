"""Plans by hand, whose numbers are known."""

import numpy as np
import pytest

from gyrocal.recording import Attitudes, GyroStream, Interval, Recording
from simulator.truth.motion import Motion
from simulator.truth.rotation import apply_rotation_errors
from studies.withheld.drawing import DrawnCase
from studies.withheld.plans import Plan
from studies.withheld.snr import ResidualModel
from studies.withheld.world import World

SAMPLE_S, SPACING = 1.0, 20
SIGMA, ARW = 1e-4, 1e-6


def build_plan(rates: np.ndarray, arw: float = ARW) -> Plan:
    """One interval with these mean rates of the samples, (n, 3) rad/s; G = I, b = 0."""
    count = len(rates)
    path = [np.array([0.0, 0.0, 0.0, 1.0])]
    for rate in rates:
        path.append(apply_rotation_errors(path[-1][None], -rate[None] * SAMPLE_S)[0])
    at = np.arange(0, count + 1, SPACING)
    t_s, quaternions = SAMPLE_S * np.arange(count), np.array(path)[at]
    motion = Motion(t_s, np.full(count, SAMPLE_S), rates, (slice(0, count),), SAMPLE_S * at, quaternions)
    gyro = GyroStream(t_s=t_s, rates=rates, sample_s=SAMPLE_S, arw=arw, apriori_G=np.eye(3), apriori_bias=np.zeros(3))
    attitudes = Attitudes(SAMPLE_S * at, quaternions, np.full((len(at), 3), SIGMA))
    interval = Interval("i01", "turns", 0.0, SAMPLE_S * count, None)
    plain = Recording(title="by hand", epoch="2020-01-01T00:00:00Z", gyro=gyro, attitudes=attitudes, intervals=(interval,))
    return Plan("hand", "none", motion, plain, np.eye(3))


@pytest.fixture(scope="session")
def resting() -> World:
    plan = build_plan(np.zeros((4000, 3)), 1e-8)
    return World(1, 0, 0, plan, ResidualModel(plan))


@pytest.fixture(scope="session")
def turning() -> World:
    t = np.arange(4000)[:, None]
    plan = build_plan(np.deg2rad(0.3) * np.sin(2 * np.pi * t / np.array([900.0, 700.0, 500.0]) + np.arange(3)))
    return World(1, 0, 0, plan, ResidualModel(plan))


def make_case(world: World, kind: str, *placed) -> DrawnCase:
    """A case of a plan by hand."""
    return DrawnCase(kind, world, placed)
