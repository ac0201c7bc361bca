"""The study of imports: what a case says, and what its report judges."""

import numpy as np
import pandas as pd
import pytest

from studies.montecarlo.study import Streams
from studies.validation import imports


@pytest.fixture(scope="module")
def rows():
    config = imports.ImportConfig(cases=3, seconds=60.0)
    return pd.DataFrame([row for number in range(3) for row in imports.run_case(config, number, Streams(8, number))])


def test_every_case_is_right_and_every_wrong_mapping_named(rows):
    report = imports.report(imports.ImportConfig(cases=3), rows)
    assert [check.verdict for check in report.checks] == ["pass"] * 12
    assert list(report.tables["named"].data["named"]) == [3] * 10


def test_the_report_fails_where_a_calibration_or_a_name_is_wrong(rows):
    spoilt = rows.copy()
    right = spoilt["kind"] == "right"
    spoilt.loc[right, "error_b_x_deg_h"] += 10 * spoilt.loc[right, "sigma_b_x_deg_h"]
    spoilt.loc[right, "nees"] += 100.0
    spoilt.loc[spoilt["kind"] == "conjugate", "named"] = False
    report = imports.report(imports.ImportConfig(cases=3), spoilt)
    assert report.check("largest error of a parameter").verdict == "fail"
    assert report.check("mean NEES").verdict == "fail"
    assert report.check("named: conjugate").verdict == "fail"


@pytest.mark.parametrize(
    ("message", "wanted", "named"),
    [
        ("80 % is left; 3.3 % with times in ms, not s", "times in ms, not s", True),
        ("80 % is left; 3.3 % with times in ms, not s or times in us, not s", "times in ms, not s", False),
        ("80 % is left; 3 % with -0.351 s added to the attitudes' time tags", "{} s added to the attitudes' time tags", True),
        ("80 % is left; 3 % with +0.351 s added to the attitudes' time tags", "{} s added to the attitudes' time tags", False),
        ("", "times in ms, not s", False),
    ],
)
def test_a_name_counts_only_alone(message, wanted, named):
    assert imports.is_mapping_named(message, wanted) is named


def test_logs_are_those_of_their_stream():
    config = imports.ImportConfig(seconds=30.0)
    logs = [imports.log(Streams(1, k).generator("log"), config.seconds) for k in (0, 0, 1)]
    pd.testing.assert_frame_equal(logs[0].gyro, logs[1].gyro)
    assert not np.allclose(logs[0].gyro["gx"], logs[2].gyro["gx"])
