"""Packets of accumulated angles: what they hold, and read back by the reader of `gyrocal import csv`."""

import numpy as np

import gyrocal
from studies.natanson.omitted_effects import ARCSEC_IN_RAD, convert_through_packets, simulate_packets
from tests.builders import piecewise_recording

LSB = 20.0  # arcsec
RECORDING = piecewise_recording(arw=2e-6)
FASTEST = np.abs(RECORDING.gyro.rates).max() * RECORDING.gyro.sample_s / (LSB * ARCSEC_IN_RAD)  # counts from packet to packet
WRAP = int(3 * FASTEST)


def test_counts_are_whole_stay_in_the_register_and_wrap():
    table = simulate_packets(RECORDING, LSB * ARCSEC_IN_RAD, WRAP, np.random.default_rng(1))
    counts = table.drop(columns="t_s").to_numpy()
    assert counts.dtype == np.int64
    assert counts.min() >= 0
    assert counts.max() < WRAP
    assert (np.abs(np.diff(counts, axis=0)) > WRAP / 2).sum() > 10
    assert len(table) > len(RECORDING.gyro.t_s)


def test_what_is_read_back_is_off_by_less_than_a_count_and_does_not_add_up():
    back, wraps = convert_through_packets(RECORDING, LSB, WRAP, np.random.default_rng(1))
    off = (back.gyro.rates - RECORDING.gyro.rates) * RECORDING.gyro.sample_s / (LSB * ARCSEC_IN_RAD)
    assert wraps > 10
    assert 0.1 < np.abs(off).max() < 1.0
    gaps = np.flatnonzero(np.diff(RECORDING.gyro.t_s) > 1.5 * RECORDING.gyro.sample_s) + 1
    for stretch in np.split(off, gaps):
        assert np.abs(np.cumsum(stretch, axis=0)).max() < 1.0
    # Independent roundings of the rates would add up: a walk of their spread.
    assert np.sqrt(len(off)) * off.std() > 3.0


def test_small_counts_calibrate_as_the_rates_do():
    back, _ = convert_through_packets(RECORDING, 1e-3, 2**40, np.random.default_rng(1))
    one, other = (gyrocal.calibrate(recording) for recording in (RECORDING, back))
    assert np.abs((one.parameters.vector - other.parameters.vector) / np.sqrt(np.diag(one.covariance))).max() < 0.01
