import shutil
from pathlib import Path

import numpy as np
import pytest

from gyrocal.errors import InputError
from simulator import adopted_scenario, load, names, override
from tests import ROOT
from tests.builders import TRUE_BIAS, TRUE_G

TRMM = load("trmm")


def test_built_in_scenarios_load():
    assert {"trmm", "trmm_series"} <= set(names())
    for name in names():
        adopted_scenario.load(name)


def test_trmm_is_the_papers():
    """N Table 1's six intervals, R (9) as truth and N Table 3's pre-launch column."""
    assert [(i.start_s, i.stop_s) for i in TRMM.interval] == [
        (0, 6000),
        (12360, 13440),
        (19200, 24900),
        (93510, 97980),
        (2172120, 2177655),
        (2804550, 2805660),
    ]
    assert np.sum([(i.stop_s - i.start_s) / TRMM.gyro.sample_s for i in TRMM.interval]) == 47790
    off_diagonal = np.rad2deg(np.array(TRMM.gyro.apriori_G) - np.eye(3))
    np.testing.assert_allclose(off_diagonal, [[0, -0.036, 0.006], [0.059, 0, -0.033], [0.005, 0.03, 0]], atol=1e-12)
    np.testing.assert_array_equal(TRMM.gyro.true_G, TRUE_G)
    np.testing.assert_allclose(TRMM.gyro.true_bias_deg_s, np.rad2deg(TRUE_BIAS), rtol=1e-14)
    assert TRMM.gyro.apriori_bias_deg_s == (-1.41e-4, 1.58e-4, 0.86e-4)


def test_load_from_files(tmp_path: Path):
    shutil.copy(ROOT / "simulator/scenarios/trmm.toml", tmp_path / "mine.toml")
    (tmp_path / "deeper").mkdir()
    changed = tmp_path / "deeper" / "changed.toml"
    changed.write_text('base = "../mine.toml"\n[gyro]\nsample_s = 2\n[[interval]]\n' + INTERVAL, encoding="utf-8")
    scenario = load(changed)
    assert scenario.gyro.sample_s == 2.0
    assert scenario.gyro.true_G == TRMM.gyro.true_G
    assert [i.name for i in scenario.interval] == ["only"]
    assert load(tmp_path / "mine.toml") == TRMM


INTERVAL = 'name = "only"\nactivity = "-x forward"\nstart_s = 0\nstop_s = 600\nmode = "-x"\n'


def test_override_changes_what_it_names_only():
    changed = override(TRMM, {"gyro.arw_deg_per_sqrt_s": 1e-4, "interval.1.slew.0.start_s": 200, "gyro.true_G.0.1": 0.5})
    assert changed.gyro.arw_deg_per_sqrt_s == 1e-4
    assert changed.interval[1].slew[0].start_s == 200.0
    assert changed.gyro.true_G[0][1] == 0.5
    assert TRMM.interval[1].slew[0].start_s == 60.0


FAULTS = {
    "gyro.arw": (1.0, r"gyro\.arw: is not known; "),
    "interval.9.mode": ("+x", "9 is not the index of one of 6"),
    "gyro.sample_s": (0.0, r"gyro\.sample_s: .*greater than or equal to 0.001"),
    "gyro.true_G": ([[1, 0, 0], [0, 1, 0], [0, 1, 0]], r"gyro\.true_G: .*invertible"),
    "reference.at": ("series", r"reference\.every_s: .*required"),
    "interval.1.start_s": (5000.0, r"interval: .*m2 starts before m1 stops"),
    "interval.1.slew.0.duration_s": (1100.0, r"interval\.1\.slew: .*slew 0 ends at 1160 s"),
    "interval.3.slew.1.start_s": (400.0, r"interval\.3\.slew: .*slew 1 starts at 400 s, before slew 0 ends at 460 s"),
    "interval.4.slew": ([{"axis": [0, 0, 1], "angle_deg": 1, "start_s": 0, "duration_s": 200}], "overlaps slew 0"),
}


@pytest.mark.parametrize("path", FAULTS)
def test_faults_are_told_by_their_path(path):
    value, message = FAULTS[path]
    with pytest.raises(InputError, match=message):
        override(TRMM, {path: value})


def touching(**changes: object) -> dict[str, object]:
    common = {"activity": "", "mode": "+x"}
    first = {"name": "a", "start_s": 0.0, "stop_s": 600.0, **common}
    return {"interval": [first, {"name": "b", "start_s": 600.0, "stop_s": 1200.0, **common, **changes}]}


def test_touching_intervals_must_join():
    assert len(override(TRMM, touching()).interval) == 2
    with pytest.raises(InputError, match="b touches a but starts in another attitude"):
        override(TRMM, touching(mode="-x"))
    with pytest.raises(InputError, match="whole number of samples"):
        override(TRMM, {**touching(), "gyro.sample_s": 0.7})
