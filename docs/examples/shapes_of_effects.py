"""What effects do to a gyro: its noise-free reading with an effect less the one without, in TRMM's first three maneuvers."""

from pathlib import Path

import numpy as np

import simulator
from studies.report.panels import BLUE, Line, draw_panels, make_curves, save

EFFECTS = (
    "bias_orbital:z=0.2,phase_deg=60",
    "bias_step:z=0.3,time_s=13000",
    "bias_drift:z=0.5",
    "scale_asymmetry:z=300",
    "time_offset=0.5",
    "rate_deadzone:z=0.01",
)
scenario = simulator.override(simulator.load("trmm"), {"gyro.sample_s": 10.0})
plain = simulator.simulate(scenario, noise=False)
shown = plain.gyro.t_s < plain.intervals[2].stop_s
hours = plain.gyro.t_s[shown] / 3600

panels = []
for text in EFFECTS:
    made = simulator.simulate(scenario, noise=False, effects=[simulator.effects.parse(text)])
    change = np.rad2deg(made.gyro.rates - plain.gyro.rates)[shown, 2] * 3600
    print(f"{text}: {change.min():+.3g} to {change.max():+.3g} deg/h")
    panels.append(
        make_curves([Line(hours, change, "", BLUE, ".", size=2)], title=text, x="h since the epoch", y="z gyro, deg/h")
    )
save(draw_panels(*panels, size=(8.0, 4.6), columns=3), Path("shapes_of_effects.svg"))
