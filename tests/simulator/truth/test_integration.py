from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import simulator
from simulator.scenario import build_profiles
from simulator.truth.integration import integrate
from simulator.truth.rotation import convert_to_quaternion, separation

TRMM = simulator.load("trmm")
BUSY = simulator.override(
    TRMM,
    {
        "orbit.j2": True,
        "control_motion": {"amplitude_deg": [0.05, 0.1, 0.2], "period_s": [110.0, 70.0, 190.0]},
        "interval.1.slew.0.axis": [0.3, -0.2, 0.9],
        "interval.1.slew.0.ramp_fraction": 0.2,
        "interval.1.slew.0.start_s": 123.456,
        "interval.4.hold.offset_deg": [40.0, 0.0, 5.0],
    },
)


def wobble(t: np.ndarray) -> np.ndarray:
    """A fast rate whose direction turns, so that every commutator matters."""
    return 0.5 * np.stack([np.cos(t), np.sin(1.3 * t), 0.4 + 0.5 * np.sin(0.7 * t)], axis=-1)


def test_halving_the_step_changes_nothing():
    one, two = simulator.motion(BUSY), simulator.motion(BUSY, substeps=2)
    assert np.abs(separation(one.quaternions, two.quaternions)).max() < 1e-12
    assert np.abs(one.rates - two.rates).max() < 1e-16


@pytest.mark.parametrize("scenario", [TRMM, BUSY])
def test_closed_form(scenario):
    """At every reference outside of a hold the integrated attitude is the analytic one."""
    motion = simulator.motion(simulator.override(scenario, {"reference.at": "series", "reference.every_s": 50.0}))
    checked = 0
    for profile in build_profiles(scenario):
        inside = (motion.reference_t_s >= profile.start_s) & (motion.reference_t_s <= profile.stop_s)
        if profile.hold:
            inside &= motion.reference_t_s - profile.start_s >= profile.hold.stop
        tau = motion.reference_t_s[inside] - profile.start_s
        gap = separation(convert_to_quaternion(profile.attitude(tau)), motion.quaternions[inside])
        assert np.abs(gap).max() < 1e-12
        checked += tau.size
    assert checked > 280


@pytest.mark.parametrize("number", [1, pytest.param(4, marks=pytest.mark.long)])
def test_against_dop853(number):
    """An independent integrator on q' = ½ q ∘ (ω, 0), restarted at the knots; its own error is below 1e-12."""
    profile = build_profiles(BUSY)[number]
    length = profile.stop_s - profile.start_s

    def derivative(tau: float, q: np.ndarray) -> np.ndarray:
        a, b, c = profile.rate(np.array([tau]))[0]
        matrix = np.array([[0, c, -b, a], [-c, 0, a, b], [b, -a, 0, c], [-a, -b, -c, 0]])
        return 0.5 * matrix @ q

    q = convert_to_quaternion(profile.attitude(np.zeros(1)))[0]
    edges = [0.0, *profile.knots, length]
    for begin, end in pairwise(edges):
        q = solve_ivp(derivative, (begin, end), q, method="DOP853", rtol=1e-13, atol=1e-14, max_step=20.0).y[:, -1]
    truth = simulator.motion(BUSY).quaternions[2 * number + 1]
    assert np.abs(separation(q, truth)).max() < 1e-11


def test_convergence_is_of_sixth_order():
    """A slip in any commutator would lower the order; the factor for halving is 2^6 = 64."""
    start = np.array([0.0, 0.0, 0.0, 1.0])
    ends = [integrate(wobble, np.linspace(0, 20, n + 1), start).quaternions[-1] for n in (40, 80, 2560)]
    coarse, fine = (np.linalg.norm(separation(q, ends[2])) for q in ends[:2])
    assert 48 < coarse / fine < 84
