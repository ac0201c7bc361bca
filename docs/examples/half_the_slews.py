"""TRMM's six intervals with the same sigmas in half the slew time, as planned by `gyrocal plan --optimise`, simulated."""

from pathlib import Path

import numpy as np
import pandas as pd

import gyrocal
import simulator
from diagnosis.plan.slew_design import compute_slew_time
from simulator.simulate import motion
from studies.report.panels import Line, draw_panels, make_curves, make_strokes, save

CASES = 40
FILE = Path(__file__).with_name("half_the_slews.toml")  # as gyrocal plan --optimise wrote it, see docs/plan.md

trmm, better = (simulator.override(simulator.load(name), {"gyro.sample_s": 5.0}) for name in ("trmm", FILE))
before, after = (gyrocal.calibrate(simulator.simulate(one, noise=False)).sigma for one in (trmm, better))
truth = np.append(np.ravel(better.gyro.true_G), np.deg2rad(better.gyro.true_bias_deg_s))
errors = np.array(
    [gyrocal.calibrate(simulator.simulate(better, seed=1, case=k)).parameters.vector - truth for k in range(CASES)]
)
table = pd.DataFrame({"ratio to TRMM": after / before, "spread over sigma": errors.std(axis=0) / after}, index=gyrocal.NAMES)
print(table.round(2).to_string())

lines = []
for one, colour in ((trmm, "#999999"), (better, "#00806f")):
    path = motion(one)
    hours = np.cumsum(path.duration_s) / 3600
    rates = np.rad2deg(np.linalg.norm(path.rates, axis=1))
    lines.append(Line(hours, rates, f"{compute_slew_time(one):.0f} s of slews", colour, "-"))
samples = {name: errors[:, k] / before[k] for k, name in enumerate(gyrocal.NAMES)}
panels = (
    make_curves(lines, x="Recorded time (h)", y="Body rate (deg/s)", legend="lower left"),
    make_strokes(samples, (-2.0, 2.0), x="Error of the optimised plan by TRMM's sigma"),
)
save(draw_panels(*panels, size=(9.0, 3.6)), Path("half_the_slews.svg"))
