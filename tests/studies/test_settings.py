"""Settings that a study cannot use are refused in one line that names them."""

import pytest

from gyrocal import InputError
from studies import catalogue
from studies.montecarlo.study import load_config

UNIFORM = {"kind": "uniform", "low": 0.1, "high": 0.2}
REFUSED = [
    ("consistency", {"sampler": "sobol"}, "sampler"),
    ("consistency", {"dispersions.gyro.true_G.0.0": UNIFORM}, "must be normal"),
    ("noise", {"cases": 6}, "the grid has 43 points, one a case; change them by arw_deg_per_sqrt_s and sigma_deg"),
    ("noise", {"sigma_deg": [0.01, 0.005]}, "rising numbers above zero"),
    ("observability", {"dispersions.orbit.raan_deg": UNIFORM}, "not dispersed"),
    ("psi", {"steps_s": [0.5], "cases": 90}, "the grid has 18 points, one a case; change them by slew_angles_deg and"),
    ("psi", {"slew_angles_deg": []}, "one or more"),
    ("iterations", {"iterations": 3}, "must be between 4 and 100"),
]


@pytest.mark.parametrize(("name", "changes", "message"), REFUSED)
def test_settings_that_cannot_be_used_are_refused_in_one_line(name, changes, message):
    with pytest.raises(InputError, match=message) as refusal:
        load_config(catalogue.find_entry(name).study, changes=changes)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", catalogue.STUDY_NAMES)
def test_every_study_of_the_list_is_loaded(name):
    assert catalogue.find_entry(name).summary
