from dataclasses import replace

import numpy as np
import pytest

from gyrocal.errors import InputError
from simulator.truth.integration import integrate
from simulator.truth.maneuvers import Slew
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import build_turn_matrix, convert_to_matrix, convert_to_quaternion, separation
from studies.validation.world.motions.base import Lot, headed, stepped, together, waves
from studies.validation.world.motions.spacecraft import build_free_rotation
from studies.validation.world.sources import find_source

ORBIT = CircularOrbit(5e5, 1.0)
SOURCES = ("known", "fresh", "exam/001", "exam/002")
KINDS = {name: kind for source in SOURCES for name, kind in find_source(source).plans.items()}
LAWFUL = [name for name, kind in KINDS.items() if kind.motion]


def lot(name: str, number: int = 0, length: float = 400.0) -> Lot:
    kind = KINDS[name]
    rng, frame = np.random.default_rng([number, 7]), np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    return Lot(rng, np.random.default_rng(11), kind, length, 100.0, frame, number, ORBIT if kind.orbit else None)


def slope(values, t):
    """Fourth-order differences inside a series; the same times."""
    step = t[1] - t[0]
    return t[2:-2], (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / (12 * step)


@pytest.mark.parametrize("name", LAWFUL)
def test_a_law_turns_and_is_smooth_between_its_breaks(name):
    for number in range(2):
        length = 3000.0 if KINDS[name].orbit else 200.0
        moved = KINDS[name].motion(lot(name, number, length))
        marks = np.unique([0.0, length, *moved.breaks, *(knot for turn in moved.turns for knot in turn.knots)])
        assert marks[0] >= 0
        t = np.linspace(0, length, 40001)
        rates = moved.rate(t)
        assert rates.shape == (t.size, 3)
        assert np.isfinite(rates).all()
        assert np.abs(rates).max() > np.deg2rad(1e-3)
        # No jump within a step that holds no mark: the largest change shrinks with the step.
        clear = np.diff(np.searchsorted(marks, t)) == 0
        fine = np.linspace(0, length, 160001)
        coarse_change = np.abs(np.diff(rates, axis=0))[clear].max()
        clear = np.diff(np.searchsorted(marks, fine)) == 0
        assert np.abs(np.diff(moved.rate(fine), axis=0))[clear].max() < 0.35 * coarse_change


@pytest.mark.parametrize("name", LAWFUL)
def test_what_is_the_craft_s_own_stays_from_interval_to_interval(name):
    one, again = KINDS[name].motion(lot(name, 1)), KINDS[name].motion(lot(name, 1))
    t = np.linspace(0, 400, 50)
    assert np.array_equal(one.rate(t), again.rate(t))
    assert not np.array_equal(one.rate(t), KINDS[name].motion(lot(name, 2)).rate(t))


@pytest.mark.parametrize("inertia", [(1.0, 1.3, 1.8), (1.8, 1.3, 1.0)])
def test_a_free_body_obeys_eulers_equations_and_loses_its_rate(inertia):
    moments, decay = np.array(inertia), 2e-3
    t = np.linspace(0, 300, 60001)
    rates = build_free_rotation(moments, 0.02, -0.05, decay, 5.0)(t)
    at, change = slope(rates, t)
    inside = rates[2:-2]
    wanted = -np.cross(inside, moments * inside) / moments  # the sign of time is that of p
    found = change + decay * inside
    assert np.abs(found - wanted).max() < 1e-9
    assert np.linalg.norm(moments * rates[-1]) == pytest.approx(
        np.exp(-decay * at.max()) * np.linalg.norm(moments * rates[0]), rel=1e-3
    )


def test_a_free_body_that_would_turn_over_is_refused():
    with pytest.raises(InputError, match="modulus"):
        build_free_rotation(np.array([1.0, 1.3, 1.8]), 0.2, 0.05, 1e-3, 0.0)


def test_rates_from_three_angles_lead_to_their_attitude():
    rng = np.random.default_rng(4)
    yaw, pitch = waves(rng, 0.4, (0.01, 0.05)), together(waves(rng, 0.3, (0.02, 0.1)), stepped([], 0.5))
    roll = stepped([Slew(np.array([1.0, 0, 0]), 0.7, 10.0, 40.0)], -0.2)

    def attitude(t):
        return (
            build_turn_matrix(np.eye(3)[0], roll(t)[0])
            @ build_turn_matrix(np.eye(3)[1], pitch(t)[0])
            @ build_turn_matrix(np.eye(3)[2], yaw(t)[0])
        )

    t = np.linspace(0, 60, 3001)
    path = integrate(headed(lambda tau: yaw(tau)[1], pitch, roll, np.eye(3)), t, convert_to_quaternion(attitude(t[:1]))[0])
    assert np.abs(separation(path.quaternions, convert_to_quaternion(attitude(t)))).max() < 1e-9


def test_a_nutating_spinner_keeps_its_angular_momentum_in_space():
    # Undisturbed between two pulses, I ω without the damper's loss points to one direction in space.
    name = "spinner"
    kind = replace(KINDS[name], turn_deg_s=(3, 3.1))
    drawn = replace(lot(name, 1), kind=kind)
    moved = KINDS[name].motion(drawn)
    first = moved.breaks[0]
    craft = np.random.default_rng(11)
    ratio = craft.choice([craft.uniform(0.3, 0.8), craft.uniform(1.2, 1.9)])
    t = np.linspace(0, min(0.9 * first, 60.0), 2001)
    rates = moved.rate(t)
    spun = rates @ drawn.frame
    momentum = (spun * [ratio, 1.0, 1.0]) @ drawn.frame.T
    flown = convert_to_matrix(integrate(moved.rate, t, np.array([0.0, 0, 0, 1])).quaternions)
    in_space = np.einsum("nij,ni->nj", flown, momentum)
    lean = np.hypot(spun[:, 1], spun[:, 2]) / (ratio * spun[:, 0])
    turned = np.arccos(np.clip(in_space @ in_space[0] / np.linalg.norm(in_space, axis=1) / np.linalg.norm(in_space[0]), -1, 1))
    assert np.max(turned) < 2 * abs(lean[0] - lean[-1]) + 1e-6
    assert lean.min() > 0.02
