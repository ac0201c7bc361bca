"""Separation of two effects: against least squares on the model's own columns, and against the pairs of the plan."""

import numpy as np
import pytest

from diagnosis.plan.columns import build_signatures, linearise_noise_free
from diagnosis.plan.separate import OWN_PLAN, list_separations
from gyrocal import InputError
from simulator.effects import EFFECTS
from simulator.scenario import load, override


@pytest.fixture(scope="module")
def series():
    whole = override(load("trmm_series"), {"gyro.sample_s": 5.0, "reference.every_s": 120.0})
    return whole.model_copy(update={"interval": whole.interval[:3]})


def extra(length, start=6000.0, **more):
    return [{"name": "e", "activity": "extra", "start_s": start, "stop_s": start + length, "mode": "+x", **more}]


def test_the_needed_size_leaves_the_stated_residual_beside_the_other(series):
    """By `numpy.linalg.lstsq`: (a ‖x − B c‖)² = 2 ln 19 at the size a, for the worst axes."""
    (found,) = list_separations(series, "bias_drift", "bias_orbital", {})
    assert found.plan == OWN_PLAN
    every = {one.label: one for one in build_signatures(linearise_noise_free(series), ["bias_drift", "bias_orbital"])}
    sizes = {}
    for axis in "xyz":
        x = every[f"bias_drift:{axis}"].X[:, 0, 0]
        left = []
        for other in "xyz":
            B = every[f"bias_orbital:{other}"].X[:, 0]
            left.append(np.linalg.norm(x - B @ np.linalg.lstsq(B, x, rcond=None)[0]))
        sizes[f"bias_drift:{axis}"] = np.sqrt(2 * np.log(19)) / min(left)
    assert found.size == pytest.approx(max(sizes.values()))
    assert found.effect == max(sizes, key=sizes.get)


def test_a_maneuver_that_shows_more_comes_first_and_inseparable_effects_stay_so(series):
    plans = {"long": extra(5000.0), "short": extra(300.0)}
    found = list_separations(series, "bias_drift", "bias_orbital", plans)
    assert [one.plan for one in found] == ["long", "short", OWN_PLAN]
    assert found[0].size < found[1].size <= found[2].size * (1 + 1e-9)
    whole = override(load("trmm_series"), {"gyro.sample_s": 5.0, "reference.every_s": 120.0})
    (same,) = list_separations(whole, "time_offset", "rate_lag", {})  # both delay the rates
    assert same.share == pytest.approx(1.0)
    assert np.isinf(same.size)
    (unseen,) = list_separations(
        series, "time_offset", "bias_drift", {}
    )  # one orbit rate and one yaw: the calibration absorbs it
    assert np.isinf(unseen.size)


def test_effects_without_a_shape_are_refused(series):
    random = next(name for name, one in EFFECTS.items() if one.is_process)
    with pytest.raises(InputError, match="is a random effect"):
        list_separations(series, random, "bias_drift", {})
