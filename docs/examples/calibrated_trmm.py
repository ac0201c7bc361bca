"""TRMM's six calibration maneuvers flown and calibrated: residuals before and after, and errors in sigmas of the truth."""

from pathlib import Path

import numpy as np

import gyrocal
import simulator
from studies.report.panels import BLUE, RED, TEAL, Line, draw_panels, make_curves, save

scenario = simulator.load("trmm_series")
result = gyrocal.calibrate(simulator.simulate(scenario, seed=1))

table = result.residuals
over = np.arange(len(table))
before, after = (np.linalg.norm(table.filter(regex=f"^{phase}_"), axis=1) for phase in ("before", "after"))
lines = [Line(over, before, "before", RED, "."), Line(over, after, "after", BLUE, "^", size=3)]

truth = np.append(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))
found = np.append(result.G, result.bias)
errors = (found - truth) / result.sigma
parameters = Line(errors, np.arange(12), "", TEAL, "o")

figure = draw_panels(
    make_curves(
        lines, title="Residuals of the references", x="reference, in order", y="size, deg", log="y", legend="upper left"
    ),
    make_curves([parameters], title="Errors of G and b", x="sigma", at=(-2, 0, 2), rows=gyrocal.NAMES),
    size=(7.5, 3.0),
)
print(f"chi2 {result.chi2:.0f} of {result.dof}, p = {result.p_value:.2f}")
save(figure, Path("calibrated_trmm.svg"))
