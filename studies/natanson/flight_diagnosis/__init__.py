"""The flight's table diagnosed: what parts the predicted from the flown pre-launch residuals of N Table 2.

The numbers. y, the 18 pre-launch residuals at 0.5 s; c, the same after calibration; the columns at 1 and 2 s; the published
calibration x̂ (R eq. (9)); the pre-launch parameters x₀ (N Table 3). To first order, with noise n and the sensitivities Θ,

    y = Θ(x₀ − x) + n,   c = Θ(x̂ − x) + n   so that   y − c = Θ(x₀ − x̂)

whatever the noise and whatever the weights of the flight's estimator: x̂ was fitted to these very residuals, and what makes it
uncertain is the noise in them. So the uncertainty of G and b must not be added to that of the residuals as if it were another
one. The diagnosis therefore has two parts, which share no noise (`numbers`): the *motion*, y − c against the simulator's
prediction (`table`), and the *noise*, what no calibration can take out of c and the differences between the step columns.

Hypotheses are weighed by families (`families`), those of other slew timings by integrals over broad priors (`timings`,
`draws`), after a test of whether there is a gap at all (`gap`). A cause is named at a probability of 0.95 or more
(`verdict`); how far the likeliest explanation closes the gap is measured also on numbers held out (`closing`). The same is
asked under baselines made wrong on purpose (`baselines`) and of simulated tables (`simulated_tables`), the study's cases.

Two settings were made after a first look at the flight's table, neither to fit it: the times' 15 s, a source of print that had
been forgotten, and 0.001 instead of 0.003 deg as the smallest unknown. The verdict was the same without them.
"""

from studies.natanson.flight_diagnosis.baselines import (
    Diagnosis,
    Trial,
    documents,
    evidence_table,
    examine,
    flight_diagnoses,
    trials,
)
from studies.natanson.flight_diagnosis.closing import Closure, closure
from studies.natanson.flight_diagnosis.families import FAMILIES, NOISE, RATE, TIMING, UNKNOWN, YAW, Hypothesis, hypotheses
from studies.natanson.flight_diagnosis.gap import by_step, gap_test, holm, where
from studies.natanson.flight_diagnosis.numbers import noise_factor, prepare
from studies.natanson.flight_diagnosis.report import ENTRY, make_report, power, run
from studies.natanson.flight_diagnosis.simulated_tables import KINDS, STUDY, FlightConfig, case, simulated
from studies.natanson.flight_diagnosis.table import Baseline, Table, flown, present, trmm
from studies.natanson.flight_diagnosis.verdict import FALSE_ALARM, SURE, Judgement, diagnose, judge

__all__ = [
    "ENTRY",
    "FALSE_ALARM",
    "FAMILIES",
    "KINDS",
    "NOISE",
    "RATE",
    "STUDY",
    "SURE",
    "TIMING",
    "UNKNOWN",
    "YAW",
    "Baseline",
    "Closure",
    "Diagnosis",
    "FlightConfig",
    "Hypothesis",
    "Judgement",
    "Table",
    "Trial",
    "by_step",
    "case",
    "closure",
    "diagnose",
    "documents",
    "evidence_table",
    "examine",
    "flight_diagnoses",
    "flown",
    "gap_test",
    "holm",
    "hypotheses",
    "judge",
    "make_report",
    "noise_factor",
    "power",
    "prepare",
    "present",
    "run",
    "simulated",
    "trials",
    "trmm",
    "where",
]
