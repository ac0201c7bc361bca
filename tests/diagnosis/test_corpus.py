"""Damaged recordings end in an answer or in one line: those of the corpus that once did neither, and one of each other kind."""

import shutil

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from gyrocal import GyrocalError, load
from simulator.effects.recording_view import interpolate_housekeeping
from tests.corpus_recordings import QUICK, damages, intact

DAMAGES = dict(damages())
REFUSED = {
    "gyro +1e+09 s": "interval m1: no gyro sample covers its first reference attitude",
    "one sample": "no gyro samples between",
    "rates all zero": "all rates are zero",
    "rate 1 zero": "too large to linearise",
    "all rates 1e-310": "too large to linearise",
    "orbit of 1e300 s": "orbit.period_s",
    "gyro rate_x_deg_s nan": "row 50: not a finite number",
    "attitude sigma_y_deg 1e-310": "sigma in row 50 is not within",
    "housekeeping t_s in words": "column t_s holds",
}
ANSWERED = (
    ("intervals of 1 samples",),
    ("sigma and arw of 1e-9",),
    ("housekeeping gyro_temperature_c inf", "housekeeping with a column of words"),
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return intact(tmp_path_factory.mktemp("corpus") / "intact")


@pytest.fixture
def damaged(whole, tmp_path):
    def make(*names):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        shutil.copytree(whole, folder)
        for name in names:
            DAMAGES[name](folder)
        return folder

    return make


def test_there_are_as_many_damages_as_names():
    names = [name for name, _ in damages()]
    assert len(names) == len(set(names)) >= 150


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused_in_one_line(name, damaged):
    with pytest.raises(GyrocalError) as caught:
        diagnose(load(damaged(name)), settings=QUICK)
    assert REFUSED[name] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("names", ANSWERED, ids=" and ".join)
def test_what_can_be_used_is_answered(names, damaged):
    found = diagnose(load(damaged(*names)), settings=QUICK)
    assert found.verdict in ("none", "named", "group", "unknown", "not identifiable")


def test_housekeeping_is_read_in_order_and_without_fillers(damaged, whole):
    at = np.array([100.0, 300.0])
    for name in ("housekeeping backwards", "housekeeping gyro_temperature_c 1e+300", "housekeeping gyro_temperature_c inf"):
        found = interpolate_housekeeping(load(damaged(name)), at)
        np.testing.assert_allclose(found["gyro_temperature_c"], 20.0 + 0.01 * at)
