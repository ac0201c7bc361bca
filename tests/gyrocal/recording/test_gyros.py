"""Several gyros: rates and parity, files of format 2, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from gyrocal import InputError, calibrate, load, save, triad
from gyrocal.recording.gyros import compute_gyro_gain, compute_nominal_gyros, compute_parity_basis, select_interval_samples
from gyrocal.recording.parts import build_empty_attitudes
from tests.builders import piecewise_recording
from tests.gyro_arrays import ITSELF, SKEWED, TETRAHEDRON, array_recording

SWITCHED = [None, ("1", "2", "3", "4"), ("1", "2", "4", "5"), None, ("3", "4", "5"), None]


@pytest.mark.parametrize("axes", [TETRAHEDRON, SKEWED])
def test_rates_and_parity_share_no_noise(axes):
    every, three = np.arange(len(axes)), np.array([0, 1, 3])
    G, V = compute_gyro_gain(axes, every), compute_parity_basis(axes, every)
    np.testing.assert_allclose(G @ axes, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(V.T @ axes, 0, atol=1e-15)
    np.testing.assert_allclose(G @ V, 0, atol=1e-15)
    np.testing.assert_allclose(V.T @ V, np.eye(len(axes) - 3), atol=1e-15)
    # K G + V Vᵀ = I: what the rates do not hold is in the parity.
    np.testing.assert_allclose(axes @ G + V @ V.T, np.eye(len(axes)), atol=1e-15)
    assert not compute_gyro_gain(axes, three)[:, 2].any()
    assert compute_parity_basis(axes, three).shape == (len(axes), 0)


def test_the_tetrahedron_by_hand():
    np.testing.assert_allclose(compute_gyro_gain(TETRAHEDRON, np.arange(4)), 0.75 * TETRAHEDRON.T, atol=1e-15)
    np.testing.assert_allclose(np.abs(compute_parity_basis(TETRAHEDRON, np.arange(4))), 0.5, atol=1e-15)


def test_body_rates_are_those_of_the_gyros_that_were_on():
    recording, K, c = array_recording(SKEWED, gyros=SWITCHED)
    G = np.linalg.pinv(K)
    exact = replace(recording, gyro=replace(recording.gyro, apriori_G=G, apriori_bias=-G @ c))
    for found, expected in zip(compute_nominal_gyros(exact.gyro), (K, K @ (G @ c)), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-15)
    body, truth = triad(exact), piecewise_recording(truth=ITSELF)
    for number in range(6):
        part, dt = select_interval_samples(recording, number)
        one, chosen = recording.intervals[number], recording.switched_on(number)
        assert dt.sum() == pytest.approx(one.stop_s - one.start_s)
        expected = truth.gyro.rates[part] + compute_gyro_gain(K, chosen)[:, chosen] @ c[chosen]
        np.testing.assert_allclose(body.gyro.rates[part], expected, atol=1e-15)


def test_format_2_keeps_names_switches_holes_and_the_lack_of_attitudes(tmp_path):
    recording, *_ = array_recording(SKEWED, arw=1e-6, gyros=SWITCHED)
    save(recording, tmp_path)
    back = load(tmp_path)
    assert back.gyro.names == recording.gyro.names
    assert back.intervals == recording.intervals
    np.testing.assert_allclose(back.gyro.rates, recording.gyro.rates, rtol=4e-16)
    np.testing.assert_array_equal(back.gyro.apriori_G, recording.gyro.apriori_G)
    save(replace(recording, attitudes=build_empty_attitudes()), tmp_path)
    assert not (tmp_path / "attitude.parquet").exists()
    assert load(tmp_path).attitudes.t_s.size == 0
    with pytest.raises(InputError, match="no reference attitudes"):
        triad(load(tmp_path))


def test_three_gyros_and_one_sensor_are_still_format_1_on_file(tmp_path):
    save(piecewise_recording(), tmp_path)
    header = (tmp_path / "recording.toml").read_text()
    assert header.startswith("format = 1\n")
    assert 'maps = "inertial to body"' in header
    assert "names" not in header
    assert "raan" not in header
    assert "sensor" not in piecewise_recording().to_frame("attitude").columns


def _changed(**changes):
    recording, *_ = array_recording(SKEWED)
    return replace(recording, gyro=replace(recording.gyro, **changes))


def _on(*names):
    recording, *_ = array_recording(SKEWED)
    first, *others = recording.intervals
    return replace(recording, intervals=(replace(first, gyros=names), *others))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: _changed(names=("1", "2", "3")), "rates must be three a sample"),
        (lambda: _changed(names=("x", "y", "z", "u", "v")), "letters with digits at the end"),
        (lambda: _changed(names=("1", "2", "3", "4", "4")), "different names"),
        (lambda: _changed(apriori_G=np.eye(3)), "G must be 3×5"),
        (lambda: _changed(apriori_G=np.ones((3, 5))), "must not lie in one plane"),
        (lambda: _on("1", "2", "7"), "interval m1: no gyro 7; there are 1, 2, 3, 4, 5"),
        (lambda: _on("1", "2"), "interval m1: its gyros 1, 2 do not see all three axes"),
        (lambda: _changed(rates=np.full((len(array_recording()[0].gyro.t_s), 5), np.nan)), "finite"),
        (lambda: calibrate(array_recording(SKEWED)[0]), "takes the three gyros x, y and z, not 1, 2, 3, 4, 5"),
        (lambda: replace(piecewise_recording(), attitudes=build_empty_attitudes()), "attitude: no rows"),
    ],
)
def test_what_does_not_fit_is_said(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_gyro_that_is_on_must_have_numbers():
    recording, *_ = array_recording(SKEWED, gyros=SWITCHED)
    rates = recording.gyro.rates.copy()
    rates[10, 2] = np.nan
    with pytest.raises(InputError, match="interval m1: gyro row 10 is not a finite number"):
        replace(recording, gyro=replace(recording.gyro, rates=rates))
