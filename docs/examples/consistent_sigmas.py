"""Are the stated sigmas right? NEES of 100 calibrations with known truth, with gyro noise in the covariance and without it.

N (31), (32) take the errors of the reference attitudes alone; the gyro's noise, which adds up over an interval, is left out.
"""

from pathlib import Path

import numpy as np
from scipy.stats import chi2

import gyrocal
import simulator
from studies.report.panels import BLUE, GREY, RED, Line, draw_panels, make_curves, save

CASES = 100
MODELS = {"full covariance": "full", "references only, as the paper": "references only"}
scenario = simulator.override(simulator.load("trmm"), {"gyro.sample_s": 10.0})
truth = np.append(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))
samples = {name: [] for name in MODELS}
for seed in range(CASES):
    recording = simulator.simulate(scenario, seed=seed)
    for name, model in MODELS.items():
        result = gyrocal.calibrate(recording, covariance_model=model)
        error = np.append(result.G, result.bias) - truth
        samples[name].append(error @ np.linalg.solve(result.covariance, error))
for name, nees in samples.items():
    print(f"{name}: mean NEES {np.mean(nees):.1f} of 12 expected")

x, share = np.geomspace(3, 300, 200), (1 + np.arange(CASES)) / CASES
lines = [Line(x, chi2.cdf(x, 12), "χ², 12 degrees of freedom", GREY, "-")]
for (name, nees), colour, style in zip(samples.items(), (BLUE, RED), "^.", strict=True):
    lines.append(Line(np.sort(nees), share, name, colour, style, size=3))
axes = {"x": "NEES", "y": "share of cases below", "log": "x", "legend": "lower right"}
save(draw_panels(make_curves(lines, **axes), size=(6.0, 3.2)), Path("consistent_sigmas.svg"))
