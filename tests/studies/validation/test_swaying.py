"""`gyrocal study sway`: what it draws, and that its report tells alarms and missed vibrations from right answers."""

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from gyrocal import calibrate
from studies.montecarlo.study import Streams, find
from studies.validation import swaying
from studies.validation.swaying import SwayConfig

CONFIG = SwayConfig(cases=8, vibrations=2)


def recorded(number):
    return swaying.recording(CONFIG, number, Streams(CONFIG.entropy, number))


def rows(alarms, missed, shaken=0):
    """Made-up rows of 100 bodies without an effect and 40 with a vibration."""
    kinds = np.array(["none"] * 100 + ["shaken"] * 40)
    number = np.arange(140)
    none = kinds == "none"
    return pd.DataFrame(
        {
            "case": number,
            "kind": kinds,
            "sample_hz": 50,
            "reference_hz": 1,
            "axis": np.where(none, "", "x"),
            "vibration_hz": np.where(none, np.nan, 7.0),
            "snr": np.where(none, np.nan, 20.0),
            "verdict": np.where(none & (number >= alarms), "none", "named"),
            "said": "",
            "p_value": 0.5,
            "named": ~none & (number >= 100 + missed),
            "vibrations_named": none & (number < shaken),
            "seconds": 1.0,
        }
    )


def verdicts(table):
    return [one.verdict for one in swaying.report(SwayConfig(), table).checks][:3]


def test_the_study_is_found_by_its_name():
    assert find("studies.validation.swaying:STUDY") == swaying.STUDY


def test_alarms_named_vibrations_and_missed_ones_are_told_apart():
    assert verdicts(rows(2, 2)) == ["pass", "pass", "pass"]
    assert verdicts(rows(3, 2)) == ["fail", "pass", "pass"]
    assert verdicts(rows(2, 2, shaken=1)) == ["pass", "fail", "pass"]
    assert verdicts(rows(2, 3)) == ["pass", "pass", "fail"]


def test_bodies_without_an_effect_fit_a_calibration_and_a_vibration_is_as_strong_as_said():
    fits = [calibrate(recorded(number), plausible_G=1e3, plausible_bias=1e3).p_value for number in (0, 5)]
    assert min(fits) > 1e-3
    row = swaying._drawn(CONFIG, 7, Streams(CONFIG.entropy, 7))[1]
    still = swaying.recording(SwayConfig(cases=8, vibrations=0), 7, Streams(CONFIG.entropy, 7))
    shaken = recorded(7)
    added = shaken.gyro.rates - still.gyro.rates
    noise = shaken.gyro.arw / np.sqrt(shaken.gyro.sample_s)
    assert np.sqrt(np.sum(added**2)) / noise == pytest.approx(row["snr"], rel=0.01)
    assert np.flatnonzero(added.any(axis=0)).tolist() == ["xyz".index(row["axis"])]


def test_settings_that_have_no_meaning_are_refused():
    with pytest.raises(ValidationError, match="vibrations"):
        SwayConfig(cases=3, vibrations=4)
    with pytest.raises(ValidationError, match="drawn by the study itself"):
        SwayConfig(overrides={"gyro.sample_s": 1.0})
