"""TRMM's plan: the six activities of N Table 1 with drawn lengths, rates, gaps and order, in the simulator's own scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from simulator.effects.common import log_uniform
from simulator.scenario import Scenario, load, override
from simulator.simulate import add_gyro_temperature, motion, observe
from studies.validation.world.kinds import Grade
from studies.validation.world.plans import Plan

RAMP = 0.1
DAY_S = 86400.0
GAP_S = (1200.0, 21 * DAY_S)  # between two intervals
TRMM_REFERENCE_SPACING_S = (100.0, 300.0)  # between references
TRMM_SAMPLE_S = (0.5, 1.0, 2.0)
SIGMA_RATIO = (1.0, 1.0, 1.6)  # of the references about roll, pitch and yaw
SWAY_DEG, SWAY_S = (0.01, 0.05), (150.0, 400.0)


def draw_trmm_plan(rng: np.random.Generator, grade: Grade, title: str, warm: float = 0.4) -> Plan:
    """Draw a plan like TRMM's; parameters as of `studies.validation.world.plans.draw_generic_plan`."""
    base = override(
        load("trmm_series"),
        {"gyro.sample_s": float(rng.choice(TRMM_SAMPLE_S)), "reference.every_s": TRMM_REFERENCE_SPACING_S[0]},
    )
    size, bias = log_uniform(rng, *grade.matrix), log_uniform(rng, *grade.bias)
    gyro = base.gyro.model_dump() | {
        "arw_deg_per_sqrt_s": log_uniform(rng, *grade.arw),
        "true_G": (np.eye(3) + size * rng.standard_normal((3, 3))).tolist(),
        "true_bias_deg_s": (bias * rng.standard_normal(3)).tolist(),
        "apriori_G": np.eye(3).tolist(),
        "apriori_bias_deg_s": (0.0, 0.0, 0.0),
    }
    sigma = log_uniform(rng, *grade.sigma)
    document = base.model_dump(exclude_none=True) | {
        "title": title,
        "gyro": gyro,
        "reference": base.reference.model_dump(exclude_none=True)
        | {
            "every_s": round(log_uniform(rng, *TRMM_REFERENCE_SPACING_S)),
            "sigma_deg": [sigma * ratio for ratio in SIGMA_RATIO],
        },
        "orbit": base.orbit.model_dump()
        | {"raan_deg": float(rng.uniform(0, 360)), "argument_of_latitude_deg": float(rng.uniform(0, 360))},
        "control_motion": {
            "amplitude_deg": rng.uniform(*SWAY_DEG, 3).tolist(),
            "period_s": rng.uniform(*SWAY_S, 3).tolist(),
            "phase_deg": rng.uniform(0, 360, 3).tolist(),
        },
        "interval": _draw_intervals(rng, base.orbit.build_circular_orbit().period),
    }
    scenario = Scenario.model_validate(document)
    truth = motion(scenario)
    plain = observe(scenario, truth, gyro_rng=None, reference_rng=None)
    if rng.random() < warm:
        plain = add_gyro_temperature(plain, int(rng.integers(2**31)))
    plain = replace(plain, title=title)
    return Plan(truth, plain, np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


def _draw_intervals(rng: np.random.Generator, period_s: float) -> list[dict[str, Any]]:
    """The intervals in time order."""
    backward = [_draw_backward(rng), _draw_minus_y(rng), _draw_hold(rng, period_s)]
    between = [_draw_yaw(rng, "+x"), *(backward[k] for k in rng.permutation(3)), _draw_yaw(rng, "-x")]
    parts = [_draw_forward(rng), *between] if rng.random() < 0.6 else [*between, _draw_forward(rng)]
    start, out = 0.0, []
    for number, part in enumerate(parts, start=1):
        length = part.pop("length_s")
        out.append(part | {"name": f"m{number}", "start_s": start, "stop_s": start + length})
        start += length + round(log_uniform(rng, *GAP_S))
    return out


def _draw_forward(rng: np.random.Generator) -> dict[str, Any]:
    return {"activity": "+x forward", "mode": "+x", "length_s": _draw_seconds(rng, 5400, 6000)}


def _draw_backward(rng: np.random.Generator) -> dict[str, Any]:
    return {"activity": "-x forward", "mode": "-x", "length_s": _draw_seconds(rng, 5100, 6000)}


def _draw_yaw(rng: np.random.Generator, mode: str) -> dict[str, Any]:
    other = "-x" if mode == "+x" else "+x"
    duration, before, after = _draw_seconds(rng, 650, 950), _draw_seconds(rng, 60, 150), _draw_seconds(rng, 80, 200)
    slew = _describe_slew(float(rng.choice([-180.0, 180.0])), before, duration)
    return {"activity": f"{mode} to {other} yaw", "mode": mode, "slew": [slew], "length_s": before + duration + after}


def _draw_minus_y(rng: np.random.Generator) -> dict[str, Any]:
    """From -x forward to -y forward and back."""
    first, second = _draw_seconds(rng, 350, 480), _draw_seconds(rng, 350, 480)
    before, stay, after = _draw_seconds(rng, 60, 150), _draw_seconds(rng, 2900, 3500), _draw_seconds(rng, 250, 450)
    slews = [_describe_slew(-90.0, before, first), _describe_slew(90.0, before + first + stay, second)]
    return {"activity": "-y forward", "mode": "-x", "slew": slews, "length_s": before + first + stay + second + after}


def _draw_hold(rng: np.random.Generator, period_s: float) -> dict[str, Any]:
    """One orbit, so that the attitude after it is nearly that of the mode again."""
    start, transition = _draw_seconds(rng, 6, 120), float(rng.uniform(25, 60))
    stop = start + period_s + transition + float(rng.uniform(-60, 60))
    hold = {"start_s": start, "stop_s": stop, "transition_s": transition}
    return {
        "activity": "inertial hold",
        "mode": "-x",
        "hold": hold,
        "length_s": float(np.ceil(stop)) + _draw_seconds(rng, 6, 120),
    }


def _describe_slew(angle_deg: float, start_s: float, duration_s: float) -> dict[str, Any]:
    return {
        "axis": (0.0, 0.0, 1.0),
        "angle_deg": angle_deg,
        "start_s": start_s,
        "duration_s": duration_s,
        "ramp_fraction": RAMP,
    }


def _draw_seconds(rng: np.random.Generator, low: float, high: float) -> float:
    """A whole number of seconds."""
    return float(rng.integers(round(low), round(high), endpoint=True))
