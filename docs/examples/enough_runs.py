"""Whether a study has enough runs: three units against a limit that 99.73 % of cases must keep, with 90 % confidence."""

from pathlib import Path

import numpy as np
from scipy.stats import binom

from studies.montecarlo.criteria import Requirement, count_runs
from studies.report.panels import BLUE, DARK, RED, TEAL, Line, draw_panels, make_curves, save

requirement = Requirement.parse("p99.73(pointing_deg) < 0.4 @ 90%")
allowed, risk = requirement.failure_probability, 1 - requirement.confidence / 100
runs = np.arange(20, 4001, 20)
print("runs needed with 0, 1, 2 … cases beyond the limit:", [count_runs(beyond, allowed, risk) for beyond in range(5)])

# Pointing errors of three units are normal, each with its own sigma; the requirement needs 0.133 deg.
fewest, most = binom.isf(risk, runs, allowed) + 1, binom.ppf(risk, runs, allowed) - 1
lines = [
    Line(runs, fewest, "not met from here up", DARK, "--"),
    Line(runs, np.where(most < 0, np.nan, most), "met from here down", DARK, "-"),
]
for sigma, colour in ((0.11, TEAL), (0.13, BLUE), (0.15, RED)):
    errors = np.abs(np.random.default_rng(1998).normal(0.0, sigma, runs[-1]))
    beyond = np.cumsum(errors >= requirement.limit)
    lines.append(Line(runs, beyond[runs - 1], f"sigma {sigma:g} deg", colour, "-"))
    for count in (500, 1500, 4000):
        print(f"sigma {sigma:g} deg:", requirement.judge_counts(count, int(beyond[count - 1])))
panel = make_curves(lines, x="runs", y="cases beyond the limit")
save(draw_panels(panel, size=(7.2, 3.4), legend="outside right center"), Path("enough_runs.svg"))
