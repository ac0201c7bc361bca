"""Diagnoses made by hand, one of each verdict, with tables of the size a real recording gives."""

from itertools import product

import numpy as np
import pandas as pd

from diagnosis.answer import Cause, Closure, Finding
from diagnosis.inference.levels import Level, Levels
from diagnosis.result import Details, Diagnosis

AXES = "xyz"
INTERVALS = [f"m{k + 1}" for k in range(6)]
LENGTH_S, GAP_S, EVERY_S = 4500.0, 900.0, 60.0
DEG_H = np.deg2rad(1 / 3600)
LEVELS = Levels(Level("gyro", 0.99), Level("z", 0.985), Level("periodic", 0.984))
ORBITAL = Cause("bias_orbital", "z", 0.11, "deg/h", 0.006, {"phase_deg": 57.0}, 0.983, ("bias_orbital:z",), 0.983, LEVELS)
STEP = Cause("g_matrix_step", "z", -1310.0, "ppm", 42.0, {"time_s": 15000.0, "toward": "y"}, 0.998, ("g_matrix_step:z",), 0.998)
LATE = Cause("time_offset", None, 0.52, "s", 0.02, {}, 0.55, ("time_offset", "rate_lag"), 0.991)


def residuals(causes, series_s=EVERY_S, seed=1):
    rng = np.random.default_rng(seed)
    tables = []
    for k, name in enumerate(INTERVALS):
        t = k * (LENGTH_S + GAP_S) + np.arange(0.0, LENGTH_S + 1, series_s)
        band = np.repeat((0.004 + 2e-6 * (t - t[0]))[:, None], 3, axis=1)
        after = band * rng.standard_normal((t.size, 3))
        signal = np.zeros_like(after)
        if causes:
            signal[:, 2] = 0.03 * (np.sin(2 * np.pi * t / 5492 + 1) - np.sin(2 * np.pi * t[0] / 5492 + 1))
        columns = {"interval": name, "t_s": t}
        for kind, values in (("before", after + signal), ("band", band), ("after", after)):
            columns |= {f"{kind}_{axis}": values[:, j] for j, axis in enumerate(AXES)}
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def statistics(strong, seed=2):
    rng = np.random.default_rng(seed)
    rows = []
    for name in INTERVALS:
        for axis in AXES:
            for phase in ("start", "slew", "hold", "end"):
                if phase == "slew" and name in ("m1", "m3"):
                    continue
                p = float(rng.uniform())
                if strong and axis == "z" and phase in ("hold", "end"):
                    p *= 10.0 ** -rng.uniform(3, 40)
                rows.append((name, axis, phase, "chi2", 8.0, 7, p, 0.0, 400.0))
    columns = ["interval", "axis", "phase", "statistic", "value", "dof", "p_value", "start_s", "stop_s"]
    return pd.DataFrame.from_records(rows, columns=columns)


def regressors(causes, table):
    columns = ["cause", "interval", "axis", "t_s", "regressor_deg", "residual_deg"]
    parts = [pd.DataFrame(columns=columns)]
    for cause, axis in product(causes, AXES):
        before = table[f"before_{axis}"]
        own = table[["interval", "t_s"]].assign(cause=cause.label, axis=axis, residual_deg=before)
        parts.append(own.assign(regressor_deg=before - table[f"after_{axis}"])[columns])
    return pd.concat(parts[1:] or parts, ignore_index=True)


def closure_of(closed=0.97):
    table = pd.DataFrame({"interval": INTERVALS, "before": [2.0, 2.9, 2.2, 3.4, 2.6, 2.1]})
    return Closure(
        "held-out whitened mean square", "leave-one-interval-out", 2.53, 1.13, 1.09, closed, (0.9, 1.05),
        table.assign(after=[1.1, 1.2, 1.05, 1.3, 1.1, 1.05], floor=[1.0, 1.1, 1.05, 1.2, 1.1, 1.1]),
    )  # fmt: skip


SPAN, WHEN = (450.0, 4050.0), "450 to 4050 s after its start"
FINDINGS = tuple(
    Finding("attitude", name, "z", SPAN, "chi2", value, p, f"{name}, hold, axis z: χ² {value:.0f} (61 expected), {WHEN}")
    for name, value, p in (("m4", 310.2, 1e-40), ("m2", 180.0, 3e-9))
)


def _made(verdict, causes=(), alternatives=(), unknown=0.004, closure=None, moved=False):
    table = residuals(causes or verdict == "unknown")
    baseline_G = np.eye(3) + 1e-3 * np.array([[0.4, -1.0, 0.7], [0.8, 0.5, -2.2], [0.9, 1.7, 0.9]])
    baseline_bias = np.deg2rad([-1.5e-4, 2.0e-4, 7.8e-5])
    if verdict == "unknown":
        table[[f"after_{axis}" for axis in AXES]] = table[[f"before_{axis}" for axis in AXES]].to_numpy()
    gap = verdict != "none"
    values = {
        "recording": "p07",
        "verdict": verdict,
        "present": gap,
        "p_value": 1e-12 if gap else 0.43,
        "false_alarm_rate": 0.01,
        "where": FINDINGS if gap else (),
        "causes": tuple(causes),
        "alternatives": tuple(alternatives),
        "unknown_probability": unknown,
        "posterior": ((("bias_orbital:z",), 1.0),),
        "closure": closure,
        "G": baseline_G + (1e-6 * np.array([[3.0, -40.0, 5.0], [60.0, 2.0, 9.0], [1.0, 4.0, 120.0]]) if moved else 0.0),
        "bias": baseline_bias + (DEG_H * np.array([0.001, -0.002, 0.08]) if moved else 0.0),
        "sigma_G": np.full((3, 3), 2.1e-5),
        "sigma_bias": DEG_H * np.array([0.011, 0.012, 0.009]),
        "baseline_G": baseline_G,
        "baseline_bias": baseline_bias,
        "notes": ("No housekeeping: bias_temperature cannot be tested.",),
        "runtime_s": 8.1,
        "details": Details(table, statistics(gap), regressors(causes, table)),
    }
    return Diagnosis(**values)


def none():
    return _made("none", unknown=0.0)


def named():
    return _made("named", [ORBITAL], [(("reference_orbital:z",), 0.01)], closure=closure_of(), moved=True)


def pair():
    alternatives = [(("bias_orbital:z", "scale_asymmetry:z"), 0.012), (("bias_orbital:z", "bias of another period:z"), 0.006)]
    return _made("named", [ORBITAL, STEP], alternatives, closure=closure_of(0.93), moved=True)


def group():
    return _made("group", [LATE], [(("rate_lag",), 0.441)], closure=closure_of(0.99), moved=True)


def unknown():
    alternatives = [(("references follow a rate:x", "bias_orbital:z"), 0.16), (("bias_orbital:z",), 0.03)]
    return _made("unknown", alternatives=alternatives, unknown=0.97)


CASES = {
    "none": none,
    "named": named,
    "pair": pair,
    "group": group,
    "unknown": unknown,
}
