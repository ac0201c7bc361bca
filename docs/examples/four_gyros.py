"""Four gyros in a tetrahedron: a step of one bias shows in the parity, whatever the motion and without any attitude."""

from pathlib import Path

import numpy as np

import simulator
from gyrocal.recording.gyros import compute_parity_basis
from simulator.simulate import compute_true_gyros
from studies.report.panels import BLUE, RED, Line, draw_panels, make_curves, save

DAY_H = 8.0  # that are shown: three intervals
scenario = simulator.override(simulator.load("trmm_tetrahedron"), {"gyro.sample_s": 2.0})
step = simulator.effects.parse("bias_step:4=3,time_s=13000")
K, c = compute_true_gyros(scenario)
V = compute_parity_basis(K, np.arange(4))
panels = []
for title, effects, colour in (("All four as calibrated", (), BLUE), ("Gyro 4 steps by 3 deg/h at 13000 s", (step,), RED)):
    recording = simulator.simulate(scenario, seed=1, effects=effects)
    residual = np.rad2deg((recording.gyro.rates - c) @ V)[:, 0] * 3600
    smooth = residual[: residual.size // 60 * 60].reshape(-1, 60).mean(axis=1)
    hours = recording.gyro.t_s[: smooth.size * 60 : 60] / 3600
    smooth, hours = smooth[hours < DAY_H], hours[hours < DAY_H]
    print(f"{title}: {smooth[hours < 3.6].mean():+.2f} deg/h before, {smooth[hours > 3.65].mean():+.2f} after 13000 s")
    axes = {"title": title, "x": "h since the epoch", "y": "parity, deg/h"}
    panels.append(make_curves([Line(hours, smooth, "", colour, ".", size=3)], at=(13000 / 3600,), **axes))
save(draw_panels(*panels, size=(7.5, 3.0), sharey=True), Path("four_gyros.svg"))
