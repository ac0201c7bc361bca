"""Diagnosis of the flight's table: causes of the misfit between predicted and flown pre-launch residuals of N Table 2.

The numbers. y, the 18 pre-launch residuals at 0.5 s; c, the same after calibration; the columns at 1 and 2 s; the published
calibration x̂ (R eq. (9)); the pre-launch parameters x₀ (N Table 3). To first order, with noise n and the sensitivities Θ,

    y = Θ(x₀ − x) + n,   c = Θ(x̂ − x) + n   so that   y − c = Θ(x₀ − x̂)

for any noise and any weights of the flight's estimator. The diagnosis therefore has two parts, which share no noise: the
*motion*, y − c against the simulator's prediction, and the *noise*, the part of c that no calibration can absorb and the
differences between the step columns (`table`). The common inference is applied to them (`diagnosis`); the timings that N and R
leave open have broad priors (`timings`). The study also diagnoses simulated tables, its cases, and the flight's table under
deliberately wrong baselines (`report`).
"""

from studies.natanson.flight_diagnosis.report import ENTRY, STUDY

__all__ = ["ENTRY", "STUDY"]
