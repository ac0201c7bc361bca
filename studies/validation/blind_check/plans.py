"""Maneuver plans around that of TRMM: the same six activities, with other lengths, rates, gaps and in another order."""

from typing import Any

import numpy as np

from simulator.scenario import Scenario

RAMP = 0.1
DAY_S = 86400.0
GAP_S = (1200.0, 21 * DAY_S)  # between two intervals, log-uniform
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
G_RMS = 1e-3
BIAS_DEG_S = 1e-4
SWAY_DEG, SWAY_S = (0.01, 0.05), (150.0, 400.0)


def plan(rng: np.random.Generator, base: Scenario, title: str) -> Scenario:
    """A scenario like the base in gyro, references and orbit height, with a plan, a gyro and a control motion of its own.

    Parameters
    ----------
    rng : source of all that is drawn
    base : sample length, noise and references are its
    title : of the scenario
    """
    # The diagnosis sees the a-priori calibration, which therefore must not be the truth.
    gyro = base.gyro.model_dump() | {
        "true_G": (np.eye(3) + G_RMS * rng.standard_normal((3, 3))).tolist(),
        "true_bias_deg_s": (BIAS_DEG_S * rng.standard_normal(3)).tolist(),
        "apriori_G": IDENTITY,
        "apriori_bias_deg_s": (0.0, 0.0, 0.0),
    }
    orbit = base.orbit.model_dump() | {
        "raan_deg": float(rng.uniform(0, 360)),
        "argument_of_latitude_deg": float(rng.uniform(0, 360)),
    }
    motion = {
        "amplitude_deg": rng.uniform(*SWAY_DEG, 3).tolist(),
        "period_s": rng.uniform(*SWAY_S, 3).tolist(),
        "phase_deg": rng.uniform(0, 360, 3).tolist(),
    }
    document = base.model_dump(exclude_none=True) | {
        "title": title,
        "gyro": gyro,
        "orbit": orbit,
        "control_motion": motion,
        "interval": _intervals(rng, base.orbit.circular_orbit().period),
    }
    return Scenario.model_validate(document)


def _intervals(rng: np.random.Generator, period_s: float) -> list[dict[str, Any]]:
    """The intervals in time order."""
    backward = [_backward(rng), _minus_y(rng), _hold(rng, period_s)]
    between = [_yaw(rng, "+x"), *(backward[k] for k in rng.permutation(3)), _yaw(rng, "-x")]
    parts = [_forward(rng), *between] if rng.random() < 0.6 else [*between, _forward(rng)]
    start, out = 0.0, []
    for number, part in enumerate(parts, start=1):
        length = part.pop("length_s")
        out.append(part | {"name": f"m{number}", "start_s": start, "stop_s": start + length})
        start += length + float(np.round(np.exp(rng.uniform(*np.log(GAP_S)))))
    return out


def _forward(rng: np.random.Generator) -> dict[str, Any]:
    return {"activity": "+x forward", "mode": "+x", "length_s": _seconds(rng, 5400, 6000)}


def _backward(rng: np.random.Generator) -> dict[str, Any]:
    return {"activity": "-x forward", "mode": "-x", "length_s": _seconds(rng, 5100, 6000)}


def _yaw(rng: np.random.Generator, mode: str) -> dict[str, Any]:
    other = "-x" if mode == "+x" else "+x"
    duration, before, after = _seconds(rng, 650, 950), _seconds(rng, 60, 150), _seconds(rng, 80, 200)
    slew = _slew(float(rng.choice([-180.0, 180.0])), before, duration)
    return {"activity": f"{mode} to {other} yaw", "mode": mode, "slew": [slew], "length_s": before + duration + after}


def _minus_y(rng: np.random.Generator) -> dict[str, Any]:
    """From -x forward to -y forward and back."""
    first, second = _seconds(rng, 350, 480), _seconds(rng, 350, 480)
    before, stay, after = _seconds(rng, 60, 150), _seconds(rng, 2900, 3500), _seconds(rng, 250, 450)
    slews = [_slew(-90.0, before, first), _slew(90.0, before + first + stay, second)]
    return {"activity": "-y forward", "mode": "-x", "slew": slews, "length_s": before + first + stay + second + after}


def _hold(rng: np.random.Generator, period_s: float) -> dict[str, Any]:
    """One orbit, so that the attitude after it is nearly that of the mode again."""
    start, transition = _seconds(rng, 6, 120), float(rng.uniform(25, 60))
    stop = start + period_s + transition + float(rng.uniform(-60, 60))
    hold = {"start_s": start, "stop_s": stop, "transition_s": transition}
    return {"activity": "inertial hold", "mode": "-x", "hold": hold, "length_s": float(np.ceil(stop)) + _seconds(rng, 6, 120)}


def _slew(angle_deg: float, start_s: float, duration_s: float) -> dict[str, Any]:
    return {
        "axis": (0.0, 0.0, 1.0),
        "angle_deg": angle_deg,
        "start_s": start_s,
        "duration_s": duration_s,
        "ramp_fraction": RAMP,
    }


def _seconds(rng: np.random.Generator, low: float, high: float) -> float:
    """A whole number of seconds."""
    return float(rng.integers(round(low), round(high), endpoint=True))
