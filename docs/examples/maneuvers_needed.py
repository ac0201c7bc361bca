"""Which maneuver determines what: sigmas of the twelve parameters when one of TRMM's six intervals is left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import gyrocal
import simulator
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from studies.report.panels import draw_panels, make_heat_map, save

recording = simulator.simulate(simulator.override(simulator.load("trmm"), {"gyro.sample_s": 2.0}), seed=1)


def sigmas(intervals):
    """Of the calibration from these intervals, a little a-priori knowledge standing in for what they do not determine."""
    all_of = recording.attitudes
    kept = np.any([(one.start_s <= all_of.t_s) & (all_of.t_s <= one.stop_s) for one in intervals], axis=0)
    attitudes = gyrocal.Attitudes(all_of.t_s[kept], all_of.quaternions[kept], all_of.sigma[kept])
    few = replace(recording, intervals=tuple(intervals), attitudes=attitudes)
    return gyrocal.calibrate(few, apriori_covariance=np.diag(PLAUSIBLE_RANGE**2)).sigma


whole = sigmas(recording.intervals)
rows = {
    f"without {left.name}, {left.activity}": sigmas([one for one in recording.intervals if one != left]) / whole
    for left in recording.intervals
}
grid = pd.DataFrame(rows, index=list(gyrocal.NAMES)).T.iloc[::-1]
print(grid.round(1).to_string())
figure = draw_panels(make_heat_map(grid, "{:.1f}", log=True, title="Sigma by that of all six"), size=(8.0, 3.2))
save(figure, Path("maneuvers_needed.svg"))
