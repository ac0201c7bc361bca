"""docs/mission.md holds the committed numbers."""

import json

import pandas as pd

from studies.robertson import flown, report
from studies.robertson.runs import PERIODS
from tests import ROOT

TEXT = (ROOT / "docs" / "mission.md").read_text()
RESULTS = ROOT / "results" / "mission"
PARAMETERS = {
    "attitude_accuracy_deg": ("attitude accuracy", 3),
    "yaw_update_deg": ("yaw update", 2),
    "gyro_bias_std_deg_h": ("bias scatter", 3),
}


def test_summary():
    summary = json.loads((RESULTS / "summary.json").read_text())
    for row in report.summary_table(summary).itertuples(index=False):
        assert f"| {row.question} | {row.answer} |" in TEXT


def test_table3():
    table = pd.read_csv(RESULTS / "table3.csv").set_index(["parameter", "axis", "period"])
    assert set(table.index.get_level_values("parameter")) == set(PARAMETERS)
    for (parameter, axis), rows in table.groupby(level=["parameter", "axis"], sort=False):
        name, digits = PARAMETERS[parameter]
        cells = [""] * len(PERIODS)
        for k, period in enumerate(PERIODS):
            if (parameter, axis, period) in rows.index:
                row = rows.loc[(parameter, axis, period)]
                assert row["flight"] == flown.performance(parameter, axis, period)
                cells[k] = f"{row['flight']:.{digits}f} → {row['simulated']:.3f}"
        assert f"| {name} | {axis} | {' | '.join(cells)} |" in TEXT


def test_mountings():
    for row in pd.read_csv(RESULTS / "mountings.csv").itertuples(index=False):
        assert f"| {row.mounting} | {row.precalibration:.2f} | {row.calibration1:.2f} | {row.postcalibration:.2f} |" in TEXT
