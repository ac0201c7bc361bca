"""A case that diverged is a failed row with its reason, not one among the good ones."""

import json

import numpy as np
import pytest

from gyrocal import InputError
from gyrocal.calibration.problem import Iterates
from studies.calibration import timestep
from studies.montecarlo.engine import run

TURNED = "gyro.true_G.0.1"  # one in it turns the attitude of a slew by radians


def test_a_dispersion_of_a_billion_is_a_failure(tmp_path):
    study = timestep.STUDY
    dispersions = {TURNED: {"kind": "normal", "sigma": 1e9}}
    config = study.config.model_validate_json(json.dumps({"cases": 2, "dispersions": dispersions, "steps_s": [0.5]}))
    outcome = run(study, config, tmp_path, backend="serial")
    assert sorted(outcome.failures) == [0, 1]
    assert all("too large to linearise" in error and "diverged" in error for error in outcome.failures.values())
    assert "2 failed (2 InputError" in outcome.summary()


def iterates(**differences) -> Iterates:
    values = {"x": np.zeros((3, 12)), "theta": np.full((3, 6, 3), 0.01), "P": np.eye(12), "chi2": 6.0}
    return Iterates(**(values | differences))


@pytest.mark.parametrize(
    ("differences", "reason"),
    [
        ({"theta": np.full((3, 6, 3), 0.4)}, "39.7 deg under the parameters to start from"),
        ({"theta": np.full((3, 6, 3), np.nan)}, "nan deg under"),
        ({"x": np.full((3, 12), np.inf)}, "not finite"),
        ({"P": -np.eye(12)}, "not finite"),
    ],
)
def test_iterations_that_diverged_are_not(differences, reason):
    with pytest.raises(InputError, match=f"diverged: .*{reason}"):
        iterates(**differences).check_convergence()
