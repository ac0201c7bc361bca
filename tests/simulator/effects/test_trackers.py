"""Effects of one of several star trackers do what their files say, and only to that tracker."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import simulator
from gyrocal import InputError
from gyrocal.recording.trackers import stack_sensor_axes
from simulator.effects import extract_references, parse
from simulator.effects.tracker_view import ASTRONOMICAL_UNIT, LIGHT, compute_annual_velocity, compute_orbital_velocity
from simulator.simulate import build_surroundings, motion
from simulator.truth.orbit import compute_lvlh_attitude
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector
from tests.tracker_cases import AGILE, ESTIMATED

ARCSEC = np.deg2rad(1 / 3600)
PLAIN = simulator.simulate(AGILE, noise=False)


def turned(recording):
    """(m, 3) of the references from the true ones about the axes of their trackers, arcsec."""
    A, before = Rotation.from_quat(recording.attitudes.quaternions).inv(), Rotation.from_quat(PLAIN.attitudes.quaternions)
    return np.einsum("mij,mj->mi", stack_sensor_axes(PLAIN.attitudes), (A * before).as_rotvec()) / ARCSEC


def error(text, seed=4):
    return turned(simulator.simulate(AGILE, noise=False, seed=seed, effects=[parse(text)]))


def own(name):
    return PLAIN.attitudes.sensor == [one.name for one in PLAIN.attitudes.sensors].index(name)


def test_a_misalignment_is_a_constant_turn_about_its_own_axes():
    found = error("tracker_misalignment:st2=10,m_x_arcsec=3,m_y_arcsec=0,m_z_arcsec=4")
    assert np.abs(found[own("st1")]).max() < 1e-6
    assert found[own("st2")] == pytest.approx(np.tile([6.0, 0.0, 8.0], (own("st2").sum(), 1)), abs=1e-3)


def test_time_offset_show_an_earlier_attitude():
    """Against the true motion integrated to the shifted time, in the first interval, whose rate is the orbit's."""
    found = error("tracker_time_offset:st1=0.5")[own("st1") & (PLAIN.attitudes.t_s < 1800.0)]
    times = PLAIN.attitudes.t_s[own("st1") & (PLAIN.attitudes.t_s < 1800.0)]
    orbit = AGILE.orbit.build_circular_orbit()
    shift = Rotation.from_matrix(
        compute_lvlh_attitude(orbit, times - 0.5) @ compute_lvlh_attitude(orbit, times).transpose(0, 2, 1)
    )
    M = PLAIN.attitudes.sensors[0].M
    assert found == pytest.approx(shift.as_rotvec() @ M.T / ARCSEC, abs=0.05)
    assert np.abs(found).max() > 80


def test_aberration_moves_the_stars_to_where_it_flies():
    """An attitude that turns every star's apparent direction back to where the tracker believes the star to be."""
    rows = own("st2")
    found = error("tracker_aberration:st2=1")[rows] * ARCSEC
    v = compute_orbital_velocity(PLAIN, PLAIN.attitudes.t_s)[rows] + compute_annual_velocity(PLAIN, PLAIN.attitudes.t_s)[rows]
    A = Rotation.from_quat(PLAIN.attitudes.quaternions[rows]).inv().as_matrix()
    M = PLAIN.attitudes.sensors[1].M
    star = np.einsum("mji,j->mi", A, M[2])  # the one on the boresight
    apparent = star + v
    apparent /= np.linalg.norm(apparent, axis=1)[:, None]
    seen = np.einsum("ij,mjk,mk->mi", M, A, apparent)  # measured, in the tracker's axes
    wrong = Rotation.from_rotvec(found).as_matrix()
    believed = np.einsum("mij,jk,mkl,ml->mi", wrong, M, A, star)
    assert np.abs(seen - believed).max() < 2e-8
    assert np.abs(found[:, 2]).max() < 1e-12


def test_velocities_are_those_of_the_orbit_and_the_earth():
    t_s = np.linspace(0.0, 6000.0, 7)
    assert np.linalg.norm(compute_orbital_velocity(PLAIN, t_s), axis=1) * LIGHT == pytest.approx(np.full(7, 7459.0), abs=15)
    earth = compute_annual_velocity(PLAIN, t_s)
    assert np.linalg.norm(earth, axis=1) / ARCSEC == pytest.approx(np.full(7, 20.5), abs=0.4)
    sun = compute_sun_vector(compute_julian_date(PLAIN.epoch) + t_s / DAY)
    assert np.abs(np.einsum("mi,mi->m", earth, sun)).max() < 1e-6
    assert (np.cross(sun, -earth)[:, 2] < 0).all() or (np.cross(-sun, earth)[:, 2] > 0).all()  # eastward about the Sun
    assert pytest.approx(1.496e11, rel=1e-3) == ASTRONOMICAL_UNIT


def test_an_error_in_the_field_stands_still_where_the_stars_do():
    """Its changes have the variance 2 size² (1 − exp(−Δs/L)) by the angle Δs, whatever the time."""
    size, length = 3.0, 2.0
    rows, steps, moved = own("st2"), [], []
    seen = build_surroundings(PLAIN, motion(AGILE)).references
    assert extract_references(PLAIN).trackers is None  # without a stream nobody knows how it moves
    along = np.rad2deg(seen.trackers.path[rows])
    same = np.diff(seen.interval[rows]) == 0
    for seed in range(40):
        e = error(f"tracker_field_error:st2={size}", seed)[rows]
        assert np.abs(e[:, 2]).max() < 1e-6
        steps.append(np.diff(e[:, :2], axis=0)[same])
        moved.append(np.diff(along)[same])
    expected = 2 * size**2 * (1 - np.exp(-np.concatenate(moved) / length))
    ratio = np.concatenate(steps) ** 2 / expected[:, None]
    assert np.mean(ratio) == pytest.approx(1.0, abs=4 * np.sqrt(2 / ratio.size) * 1.5)


def test_noise_of_one_tracker_is_scaled_and_that_of_the_other_stays():
    plain = simulator.simulate(AGILE, seed=4)
    loud = simulator.simulate(AGILE, seed=4, effects=[parse("tracker_noise_excess:st2=3")])
    # The plain recording draws in the same order, so that the first tracker's errors are the same and the second's three times.
    one, other = turned(plain), turned(loud)
    assert np.std(other[own("st2")]) / np.std(one[own("st2")]) == pytest.approx(3.0, abs=0.5)
    assert np.std(other[own("st1")]) / np.std(one[own("st1")]) == pytest.approx(1.0, abs=0.2)


def test_a_boresight_follows_the_temperature():
    found = error("tracker_thermal:st1=4,a_x=0,a_y=1")[own("st1")]
    assert np.abs(found[:, [0, 2]]).max() < 1e-6
    assert np.mean(found[:, 1]) == pytest.approx(0.0, abs=1e-3)
    assert np.ptp(found[:, 1]) > 4.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tracker_misalignment:st1=5", "defines the axes"),
        ("tracker_time_offset:st7=1", "no star tracker st7"),
        ("tracker_noise_excess:st7=2", "no star tracker st7"),
        ("tracker_time_offset=1", "which star tracker"),
    ],
)
def test_what_cannot_act_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        simulator.simulate(AGILE, effects=[parse(text)])


def test_one_sensor_is_no_tracker():
    with pytest.raises(InputError, match="one sensor only"):
        simulator.simulate(simulator.load("trmm"), effects=[parse("tracker_time_offset:st1=1")])


def test_a_tracker_sees_nothing_while_the_body_turns_too_fast_or_the_sun_is_near():
    slow = simulator.override(AGILE, {"reference.tracker.0.max_rate_deg_s": 0.1})
    count = [(simulator.simulate(one, noise=False).attitudes.sensor == 0).sum() for one in (slow, AGILE)]
    assert count[0] < count[1]
    dark = simulator.override(AGILE, {"reference.tracker.0.sun_exclusion_deg": 0.0})
    assert (simulator.simulate(dark, noise=False).attitudes.sensor == 0).sum() > count[1]


def test_the_true_mounting_is_in_the_references():
    e = turned(simulator.simulate(ESTIMATED, noise=False))[own("st2")] / 3600
    assert e == pytest.approx(np.tile(ESTIMATED.reference.tracker[1].misalignment_deg, (len(e), 1)), abs=1e-8)
