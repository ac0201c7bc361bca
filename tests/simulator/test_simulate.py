import numpy as np

import simulator
from simulator.simulate import list_reference_times
from simulator.truth.maneuvers import Hold, Profile, Slew
from simulator.truth.orbit import CircularOrbit

TRMM = simulator.load("trmm")
MOTION = simulator.motion(TRMM)


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
