"""What innovations are asked to follow, and what is in progress at a reference."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.model.layout import tabulate_references
from diagnosis.model.misfit import check_baseline
from diagnosis.model.prepare import prepare
from tests.diagnosis.recordings import of_rates, slews_between_references


@pytest.fixture(scope="module")
def rested():
    """Slews between references, and a sway at them that is as large as the gyro's noise."""
    return prepare(of_rates(slews_between_references(300, 72, 0.5, 3e-5), 72, 0.5, 3.8e-5, 7e-5, 0)).model


def tabulate(model):
    """What all references may follow, (m, q)."""
    return tabulate_references(model, np.ones(model.reference_rows.size, dtype=bool)).regressors


def test_the_rate_at_a_reference_holds_no_noise_from_before_it(rested):
    model = rested
    gyro, at = model.recording.gyro, model.references.t_s.size // 2
    early = gyro.t_s < model.references.t_s[at]
    noisy = gyro.rates + 1e-6 * np.random.default_rng(0).standard_normal(gyro.rates.shape) * early[:, None]
    changed = replace(model, recording=replace(model.recording, gyro=replace(gyro, rates=noisy)))
    change = tabulate(changed) - tabulate(model)
    np.testing.assert_allclose(change[at:-1, :9], 0, atol=1e-15)  # after the last one there are no readings
    found = {one.name: one for one in check_baseline(rested)}
    assert found["dependence on what is known"].p_value > 1e-3
