"""Allan deviation: white noise alone, and with a bias instability that a calibration's sigmas would not know of."""

from pathlib import Path

import numpy as np

import simulator
from gyrocal.allan import fit_terms, overlapping_allan_deviation
from studies.report.panels import BLUE, DARK, RED, Line, draw_panels, make_curves, make_power_law, save

scenario = simulator.load("trmm")
lines = []
for effects, name, colour, style in (((), "white noise", BLUE, "^"), (("noise_flicker:z=0.4",), "and 1/f noise", RED, "o")):
    made = simulator.simulate(scenario, seed=2, effects=[simulator.effects.parse(one) for one in effects])
    held = made.intervals[0]  # +x forward: the body turns at a constant rate
    inside = (made.gyro.t_s >= held.start_s) & (made.gyro.t_s < held.stop_s)
    found = overlapping_allan_deviation([np.rad2deg(made.gyro.rates[inside, 2]) * 3600], made.gyro.sample_s)
    lines.append(Line(found.tau_s, found.deviation, name, colour, style))
    fit = fit_terms(found)
    walk, floor = fit.estimate("angle random walk"), fit.estimate("bias instability")
    print(f"{name}: angle random walk {walk.value / 3600:.2e} deg/√s, bias instability {floor.value:.2f} deg/h")

tau = lines[0].x
stated = 3600 * scenario.gyro.arw_deg_per_sqrt_s / np.sqrt(tau[0])
lines.append(make_power_law(tau, -0.5, stated, "as stated"))
lines.append(Line(tau, np.full(len(tau), 0.4 * np.sqrt(2 * np.log(2) / np.pi)), "0.4 deg/h of bias instability", DARK, ":"))
axes = {"x": "averaging time, s", "y": "overlapping Allan deviation, deg/h", "log": "xy", "legend": "lower left"}
save(draw_panels(make_curves(lines, **axes), size=(5.5, 3.4)), Path("noise_of_a_gyro.svg"))
