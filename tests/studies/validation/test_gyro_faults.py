"""Faults of one gyro: drawn at the signal-to-noise ratio that is asked for, and counted as they are said."""

import numpy as np
import pandas as pd
import pytest

from diagnosis.model.parity import parity_model
from gyrocal import InputError
from studies.montecarlo.study import Streams, changed
from studies.validation.gyro_faults import cases
from studies.validation.gyro_faults.cases import KINDS, SETUPS, STUDY, GyroFaultsConfig, drawn, observed, of_causes, set_up
from studies.validation.gyro_faults.report import report, told_apart

CONFIG = GyroFaultsConfig(sample_s=4.0)


def test_a_round_has_every_kind_of_every_set_up(monkeypatch):
    monkeypatch.setattr(cases, "world", lambda *settings: settings)
    found = {set_up(CONFIG, number)[1:] for number in range(len(SETUPS) * len(KINDS))}
    assert len(found) == len(SETUPS) * len(KINDS)


@pytest.mark.parametrize("kind", ["step", "scale"])
def test_a_step_adds_its_snr_to_the_parity(kind):
    here, *_ = set_up(CONFIG, 0)
    fault = drawn(here, kind, (30.0, 30.0), np.random.default_rng(1))
    assert fault.snr == pytest.approx(30.0)
    # The recording with the fault and without it, both without noise, in units of the parity's.
    number = 4 * list(KINDS).index(kind)
    same = changed(CONFIG, {"snr": [30.0, 30.0]})
    seen = [observed(same, number, Streams(same.entropy, number), faulty=faulty)[0] for faulty in (True, False)]
    models = [parity_model(one, here.truth, np.full(6, one.gyro.arw)) for one in seen]
    change = models[0].projected(models[0].observed - models[1].observed)
    assert np.linalg.norm(change) == pytest.approx(30.0, rel=0.02)


def test_noise_has_the_expected_likelihood_ratio():
    here, *_ = set_up(CONFIG, 0)
    fault = drawn(here, "noise", (12.0, 12.0), np.random.default_rng(2))
    v, n = fault.setting.size**2, here.model.parity.t_s.size
    x = np.random.default_rng(3).normal(size=(200, n)) * fault.setting.size
    ratio = np.mean(np.sum(x**2 * (1 - 1 / v), axis=1) - n * np.log(v))  # twice that of v against 1
    assert np.sqrt(ratio) == pytest.approx(12.0, rel=0.05)


def test_a_dead_gyro_stands_out():
    here, *_ = set_up(CONFIG, 0)
    fault = drawn(here, "dead", (8.0, 60.0), np.random.default_rng(4))
    assert fault.snr > 60


def test_the_scenarios_are_the_studys_own():
    with pytest.raises(InputError, match="change snr"):
        changed(STUDY.config(), {"overrides.gyro.sample_s": 1.0})


def test_gyros_of_causes():
    assert of_causes([("bias_step:3", "bias_drift:3"), ("gyro_dead:10",)]) == {"3", "10"}
    assert of_causes([]) == set()


def test_what_is_counted():
    common = {"error": "", "gyro": "1", "snr": 9.0, "size": 1.0, "time_s": 0.0, "verdict": "named", "said": "", "found": ""}
    common |= {"nees": np.nan, "cpu_s": 1.0, "wrong": False, "alarm": True, "kind": True, "references": False}
    rows = pd.DataFrame([
        {**common, "case": 0, "gyros": "six", "fault": "step", "named": True},
        {**common, "case": 1, "gyros": "six", "fault": "noise", "named": False, "kind": False, "wrong": True},
        {**common, "case": 2, "gyros": "tetrahedron", "fault": "step", "named": False},
        {**common, "case": 3, "gyros": "tetrahedron", "fault": "noise", "named": True},
        {**common, "case": 4, "gyros": "six", "fault": "none", "named": False, "alarm": False, "kind": False},
    ])  # fmt: skip
    assert told_apart(rows).tolist() == [True, True, False, True, False]
    made = report(CONFIG, rows)
    checks = {one.name: one for one in made.checks}
    assert checks["faulty gyro named, 2 of 3"].verdict == "fail"
    assert checks["a sound gyro blamed, 1 of 4"].verdict == "fail"
    assert checks["alarms where nothing is wrong, 0 of 1"].verdict == "pass"
    assert made.tables["missed"].data["case"].tolist() == [1]
