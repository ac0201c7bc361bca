"""Held-out turns: their errors are those of the parameters and references, and no calibration has used them."""

from dataclasses import replace

import numpy as np
import pytest

import simulator
from gyrocal.estimation import held_out
from gyrocal.estimation.held_out import describe_held_out_turns, predict_held_out_turns


@pytest.fixture(scope="module")
def recording():
    """TRMM's maneuvers with a reference every minute."""
    chosen = simulator.override(simulator.load("trmm_series"), {"gyro.sample_s": 2.0})
    return simulator.simulate(chosen, seed=1)


def spoil(recording, factor):
    """The recording with all rates so many times as large."""
    return replace(recording, gyro=replace(recording.gyro, rates=factor * recording.gyro.rates))


def test_a_scale_error_spoils_what_is_stated_and_not_what_is_calibrated(recording):
    (found,) = [one for one in predict_held_out_turns(spoil(recording, 1.01)) if one.length_s == 60.0]
    assert found.count > 100
    assert found.calibrated == pytest.approx(found.references, rel=0.25)
    # By hand: a hundredth of the angle that the body turns in a minute, beside the errors of the references.
    t_s, gyro = recording.attitudes.t_s[:-1], recording.gyro
    turned = [2.0 * np.linalg.norm(gyro.rates[(gyro.t_s >= t) & (gyro.t_s < t + 60.0)].sum(axis=0)) for t in t_s]
    by_hand = np.sqrt(np.mean(np.square(turned)) * 1e-4 + found.references**2)
    assert found.stated == pytest.approx(by_hand, rel=0.1)
    assert found.bias_alone > 2 * found.calibrated
    assert "better than the bias alone and better than the gyro as stated" in describe_held_out_turns([found])


def test_no_calibration_has_the_references_of_its_turns(recording, monkeypatch):
    seen, compared = [], []
    calibrate, compare = held_out.calibrate, held_out._compare_turns

    def calibrating(others, **options):
        seen.append(others.attitudes.t_s)
        return calibrate(others, **options)

    def comparing(whole, rows, used, *rest):
        compared.append((whole.attitudes.t_s[rows], seen[-1]))
        return compare(whole, rows, used, *rest)

    monkeypatch.setattr(held_out, "calibrate", calibrating)
    monkeypatch.setattr(held_out, "_compare_turns", comparing)
    assert predict_held_out_turns(recording)
    assert len(seen) == 2 * held_out.HELD_OUT_BLOCKS
    assert not any(np.isin(turned, used).any() for turned, used in compared)
    held = np.unique(np.concatenate([turned for turned, _ in compared]))
    np.testing.assert_array_equal(held, recording.attitudes.t_s)  # each is held out once
