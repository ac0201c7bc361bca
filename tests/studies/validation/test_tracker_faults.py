"""Effects of one star tracker: drawn at the signal-to-noise ratio that is asked for, and counted as they are said."""

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError
from simulator.truth.rotation import separation
from studies.montecarlo.study import Streams, changed
from studies.validation.tracker_faults.cases import (
    KINDS,
    MOUNTING_SIGMA_DEG,
    NONE,
    PLANS,
    STUDY,
    TrackerFaultsConfig,
    drawn,
    recording,
    set_up,
    world,
)
from studies.validation.tracker_faults.report import report

CONFIG = TrackerFaultsConfig(sample_s=4.0)


def of(kind, snr, plan="calm"):
    here = world(plan, CONFIG.sample_s)
    return here, drawn(here, kind, (snr, snr), np.random.default_rng(1), 7, 3)


def test_a_round_has_every_kind_of_every_plan():
    assert len({set_up(number) for number in range(len(PLANS) * len(KINDS))}) == len(PLANS) * len(KINDS)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in (NONE, "tracker_noise_excess")])
def test_an_effect_shows_with_its_snr(kind):
    here, one = of(kind, 30.0)
    assert here.snr(one, 7, 3) == pytest.approx(30.0, rel=0.01)
    plain, moved = (here.recording(setting, None, 7, 3).attitudes.quaternions for setting in (None, one))
    own = here.plain.attitudes.sensor == ["st1", "st2"].index(one.axis)
    turned = np.linalg.norm(separation(plain, moved), axis=1)
    assert turned[~own].max() < 1e-12
    assert turned[own].max() > 1e-6


def test_noise_has_the_expected_likelihood_ratio():
    here, one = of("tracker_noise_excess", 12.0)
    n = 3 * int(np.sum(here.plain.attitudes.sensor == ["st1", "st2"].index(one.axis)))
    v = one.size**2
    assert np.sqrt(n * (v - 1 - np.log(v))) == pytest.approx(12.0)


def test_a_mounting_with_a_prior_is_off_as_that_says_and_no_effect():
    number = list(PLANS).index("mounting with a prior")
    assert of("tracker_misalignment", 30.0, "mounting with a prior")[1] is None
    here = world("mounting with a prior", CONFIG.sample_s)
    seen = recording(CONFIG, number, Streams(CONFIG.entropy, number)).attitudes
    dots = np.abs(np.sum(seen.quaternions * here.plain.attitudes.quaternions, axis=1))
    turned = np.rad2deg(2 * np.arccos(np.clip(dots[seen.sensor == 1], 0, 1)))
    assert 0.3 * MOUNTING_SIGMA_DEG < np.median(turned) < 10 * MOUNTING_SIGMA_DEG


def test_the_scenarios_are_the_studys_own():
    with pytest.raises(InputError, match="change snr"):
        changed(STUDY.config(), {"overrides.gyro.sample_s": 1.0})


def test_what_is_counted():
    common = {"error": "", "tracker": "st1", "size": 1.0, "parameters": "", "snr": 20.0, "verdict": "named", "said": ""}
    common |= {"unknown_probability": 0.1, "size_in_sigma": np.nan, "cpu_s": 1.0, "plan": "calm"}
    no = {"named": False, "alone": False, "wrong": False, "alarm": True}
    late, error = "tracker_time_offset", "tracker_field_error"
    rows = pd.DataFrame([
        {**common, **no, "case": 0, "effect": late, "named": True, "alone": True, "size_in_sigma": 1.0},
        {**common, **no, "case": 1, "effect": late, "named": True},
        {**common, **no, "case": 2, "effect": error, "wrong": True},
        {**common, **no, "case": 3, "effect": error},
        {**common, **no, "case": 4, "effect": NONE, "alarm": False},
    ])  # fmt: skip
    made = report(CONFIG, rows)
    checks = {one.name: one for one in made.checks}
    assert checks["effect of one tracker named, alone or in a group, 2 of 4"].value == 0.5
    assert checks["and alone, 1 of 4"].value == 0.25
    assert checks["a confident wrong name, 1 of 4"].verdict == "fail"
    assert checks["alarms where nothing is wrong, 0 of 1"].verdict == "pass"
    assert made.tables["missed"].data["case"].tolist() == [2, 3]
