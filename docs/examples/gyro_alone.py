"""The attitude carried on by gyro alone from one reference to the next hour: its stated sigma, and how far it is off."""

from pathlib import Path

import numpy as np

import simulator
from gyrocal.attitude import quaternion_from_matrix
from gyrocal.estimation.predict import predict, prior_covariance
from simulator.truth.rotation import separation
from studies.report.panels import BLUE, GREY, RED, Line, draw_panels, make_curves, save

FROM_S, SEEDS = 3000.0, 12
times = np.arange(3030.0, 6000.0, 30.0)
scenario = simulator.override(simulator.load("trmm_series"), {"reference.every_s": 30.0})
truth = simulator.simulate(scenario, noise=False).attitudes
known = [int(np.flatnonzero(truth.t_s == t)[0]) for t in times]

lines = []
for seed in range(SEEDS):
    recording = simulator.simulate(scenario, seed=seed)
    found = predict(recording, FROM_S, times, prior_covariance(1e-4))
    error = np.rad2deg(separation(quaternion_from_matrix(found.A), truth.quaternions[known]))[:, 2] * 3600
    lines.append(Line(times - FROM_S, error, "errors of 12 flights" if seed == 0 else "", GREY, "-"))
sigma = np.rad2deg(found.sigma[:, 2]) * 3600
lines += [Line(times - FROM_S, sigma, "stated sigma", RED, "-"), Line(times - FROM_S, -sigma, "", RED, "-")]
print(f"yaw sigma after {times[-1] - FROM_S:.0f} s: {sigma[-1]:.0f} arcsec")
lines.append(Line([0], [0], "last reference used", BLUE, "o"))
axes = {"x": "s since the last reference", "y": "yaw error, arcsec", "legend": "upper left"}
save(draw_panels(make_curves(lines, **axes), size=(6.0, 3.2)), Path("gyro_alone.svg"))
