import numpy as np
import pytest

import simulator
from gyrocal import recording as recording_file
from simulator.simulate import list_reference_times
from simulator.truth.integration import accumulate
from simulator.truth.maneuvers import Hold, Profile, Slew
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import separation

TRMM = simulator.load("trmm")
MOTION = simulator.motion(TRMM)

# N Table 2, pre-launch, 0.5 s: roll, pitch, yaw in degrees.
PRELAUNCH_RESIDUALS_DEG = [
    [0.012, -0.044, 0.045],
    [0.195, 0.002, 0.024],
    [0.018, -0.433, -0.011],
    [0.235, -0.243, -0.108],
    [0.073, -0.194, 0.066],
    [0.273, 0.105, 0.047],
]


def prelaunch_residuals(recording: recording_file.Recording) -> np.ndarray:
    """Residuals of the recording when processed with its a-priori gyro parameters, deg."""
    gyro, out = recording.gyro, []
    for number, samples in enumerate(MOTION.intervals):
        omega = gyro.rates[samples] @ gyro.apriori_G.T + gyro.apriori_bias
        before, after = recording.attitudes.quaternions[2 * number : 2 * number + 2]
        out.append(np.rad2deg(separation(accumulate(before, omega * gyro.sample_s)[-1], after)))
    return np.array(out)


def test_the_flights_prelaunch_residuals_are_predicted():
    """Signs of modes, slews, G and b all enter; the timings are guesses, hence a gap (own RMS 0.165 deg)."""
    gap = prelaunch_residuals(simulator.simulate(TRMM, noise=False)) - PRELAUNCH_RESIDUALS_DEG
    assert np.sqrt(np.mean(gap**2)) < 0.022


def test_noise_has_the_stated_size():
    """At 5 sigma of a standard deviation from 143 370 gyro draws and 1083 reference draws."""
    scenario = simulator.load("trmm_series")
    clean, noisy = simulator.simulate(scenario, noise=False), simulator.simulate(scenario, seed=1)
    gyro = np.rad2deg(noisy.gyro.rates - clean.gyro.rates)
    assert gyro.std() == pytest.approx(2.6e-4 / np.sqrt(0.5), rel=5 / np.sqrt(2 * gyro.size))
    errors = np.rad2deg(separation(clean.attitudes.quaternions, noisy.attitudes.quaternions))
    assert errors.std() == pytest.approx(0.005, rel=5 / np.sqrt(2 * errors.size))
    for recording in (clean, noisy):
        np.testing.assert_allclose(np.rad2deg(recording.attitudes.sigma), 0.005, rtol=1e-14)


def test_cases_and_streams_are_independent():
    first, second = simulator.simulate(TRMM, seed=1, case=0), simulator.simulate(TRMM, seed=1, case=1)
    assert not np.any(first.gyro.rates == second.gyro.rates)
    np.testing.assert_array_equal(simulator.simulate(TRMM, seed=1, case=1).gyro.rates, second.gyro.rates)
    gyro_only = simulator.observe(TRMM, MOTION, gyro_rng=simulator.generator(1, 0, "gyro_noise"), reference_rng=None)
    np.testing.assert_array_equal(gyro_only.gyro.rates, first.gyro.rates)
    np.testing.assert_array_equal(gyro_only.attitudes.quaternions, MOTION.quaternions)
    reference_only = simulator.observe(TRMM, MOTION, gyro_rng=None, reference_rng=simulator.generator(1, 0, "reference_noise"))
    np.testing.assert_array_equal(reference_only.attitudes.quaternions, first.attitudes.quaternions)
    assert not np.any(reference_only.gyro.rates == first.gyro.rates)


def test_a_cut_sample_has_the_noise_of_its_duration():
    scenario = simulator.override(TRMM, {"interval.0.stop_s": 6000.1})
    cut = simulator.motion(scenario).intervals[0].stop - 1
    noisy, clean = (simulator.simulate(scenario, seed=1, noise=noise).gyro.rates for noise in (True, False))
    draws = simulator.generator(1, 0, "gyro_noise").standard_normal(noisy.shape)
    arw = np.deg2rad(TRMM.gyro.arw_deg_per_sqrt_s)
    np.testing.assert_allclose((noisy - clean)[cut], draws[cut] * arw / np.sqrt(0.1), rtol=1e-9)
    np.testing.assert_allclose((noisy - clean)[cut - 1], draws[cut - 1] * arw / np.sqrt(0.5), rtol=1e-9)


# ---- times and errors of the references --------------------------------------------------------------------------------

LOW_ORBIT = CircularOrbit(350e3, 0.6)
Z = np.array([0.0, 0.0, 1.0])


def test_point_reading_is_the_rate_at_the_start_of_the_sample():
    rates = simulator.motion(simulator.override(TRMM, {"gyro.reading": "point"})).rates
    # Within the ramp up of a slew the mean over a sample is the trapezium of its end points up to h² ω''/12 = 8e-8 rad/s.
    slew = slice(MOTION.intervals[1].start + 160, MOTION.intervals[1].start + 240)
    np.testing.assert_allclose(0.5 * (rates[1:] + rates[:-1])[slew], MOTION.rates[slew], atol=1e-7)


def test_series_leaves_out_slews_and_transitions():
    profile = Profile(LOW_ORBIT, 0.0, 1030.0, 0.0, (Slew(Z, 1.0, 100.0, 150.0),), Hold(400.0, 900.0, 100.0, np.zeros(3)))
    expected = [0, 50, 100, 250, 300, 350, 400, 500, 550, 600, 650, 700, 750, 800, 900, 950, 1000, 1030]
    assert list_reference_times(profile, 50.0).tolist() == expected
