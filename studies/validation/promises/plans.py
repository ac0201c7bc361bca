"""Four maneuver plans and four grades of noise, in every combination, on which what the library states is tried.

- `TRMM`: its six intervals, each an hour or more at one rate, or a turn by 180°.
- `agile`: six intervals of half an hour with slews of 50 to 180° about every axis and a slanted one.
- `short slews`: seven intervals of five minutes with a turn by 60 to 180° each.
- `survey`: eight arcs of twenty minutes in four modes, with small slews to and fro.

The grades are an angle random walk, and a 1-sigma about each body axis of references that such a craft has.
"""

from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal import GyroParameters
from simulator import scenario as scenarios
from simulator.scenario import Scenario
from simulator.simulate import motion
from simulator.truth.maneuvers import trajectory
from simulator.truth.motion import Motion
from simulator.truth.rotation import matrix
from studies.calibration.prepared import true_parameters
from studies.estimation.flights import Flight

Array = NDArray[np.float64]
References = Literal["ends", "series", "trackers"]

PLANS = ("TRMM", "agile", "short slews", "survey")
GRADES = {  # ARW in deg/√s, sigma of a reference in deg
    "resonator": (2e-5, 5e-4),
    "fibre optic": (2.6e-4, 5e-3),
    "tactical": (2e-3, 2e-2),
    "MEMS": (1e-2, 1e-1),
}
# What holding the mean rate over a sample leaves must stay below the noise, so that a quieter gyro is sampled more often.
SAMPLE_S = {"TRMM": 0.5, "agile": 0.5, "short slews": 0.25, "survey": 0.5}
LONGER = {"resonator": 1, "fibre optic": 2, "tactical": 8, "MEMS": 8}
EVERY_S = {"TRMM": 100.0, "agile": 100.0, "short slews": 20.0, "survey": 100.0}
FLOWN = {"TRMM": 1, "agile": 5, "short slews": 3, "survey": 1}  # the interval that filters and batches are flown on
MOUNTINGS = ((0.953716950748227, 0.0, 0.0, -0.300705799504273), (0.953716950748227, 0.0, 0.0, 0.300705799504273))
ALONG = 10.0  # times a tracker's sigma across its boresight
MOUNTING_SIGMA_DEG = 0.05


def cell(number: int) -> tuple[str, str]:
    """Plan and grade of a case: neighbours differ, so that any number of cases is spread over all of them."""
    return PLANS[number % len(PLANS)], list(GRADES)[number // len(PLANS) % len(GRADES)]


def scenario(plan: str, grade: str, references: References = "series", array: bool = False) -> Scenario:
    """A plan with a grade of noise.

    Parameters
    ----------
    plan, grade : names
    references : at the ends of intervals, a series, or by two star trackers, the second of which has its mounting estimated
    array : whether four gyros in a tetrahedron fly, and not x, y and z
    """
    arw, sigma = GRADES[grade]
    return _with(_shaped(plan, sample_s(plan, grade), references, array), arw, sigma)


def sample_s(plan: str, grade: str) -> float:
    """Length of a sample."""
    return SAMPLE_S[plan] * LONGER[grade]


def path(plan: str, grade: str, references: References) -> Motion:
    """The noise-free motion, of which grades change how it is sampled."""
    return _path(plan, sample_s(plan, grade), references)


@lru_cache(maxsize=36)
def _path(plan: str, step: float, references: References) -> Motion:
    return motion(_shaped(plan, step, references, False))


@lru_cache(maxsize=12)
def _flown(plan: str, step: float) -> tuple[Array, Array, Array]:
    """Edges of the samples, s, attitudes there, and mean rates of the interval that estimators are flown on."""
    whole = _shaped(plan, step, "series", False)
    profile = scenarios.profiles(whole)[FLOWN[plan]]
    t = step * np.arange(int((profile.stop_s - profile.start_s) / step) + 1, dtype=np.float64)
    found = trajectory(profile, t)
    return t, matrix(found.quaternions), found.angles / step


def flight(plan: str, grade: str) -> Flight:
    """One interval of a plan as a flight for batches, filters and alignments, from zero seconds on."""
    t, A, rates = _flown(plan, sample_s(plan, grade))
    own = scenario(plan, grade)
    arw = float(np.deg2rad(own.gyro.arw_deg_per_sqrt_s))
    return Flight(t, A, rates, true_parameters(own), arw, GyroParameters(true_parameters(own).G, np.zeros(3)))


def _with(base: Scenario, arw: float, sigma: float) -> Scenario:
    trackers = tuple(one.model_copy(update={"sigma_deg": (sigma, sigma, ALONG * sigma)}) for one in base.reference.tracker)
    reference = base.reference.model_copy(update={"sigma_deg": (sigma,) * 3, "tracker": trackers})
    gyro = base.gyro.model_copy(update={"arw_deg_per_sqrt_s": arw})
    return base.model_copy(update={"gyro": gyro, "reference": reference})


@lru_cache(maxsize=64)
def _shaped(plan: str, step: float, references: References, array: bool) -> Scenario:
    """A plan without a grade."""
    base = scenarios.load("trmm_tetrahedron" if array else "trmm_series")
    document = base.model_dump(exclude_none=True)
    document["title"] = f"promises, {plan}"
    document["gyro"]["sample_s"] = step
    document["reference"] = {"at": "ends" if references == "ends" else "series", "sigma_deg": (1.0, 1.0, 1.0)}
    if references != "ends":
        document["reference"]["every_s"] = EVERY_S[plan]
    if references == "trackers":
        document["reference"]["tracker"] = [
            {"name": f"st{k + 1}", "mounting": q, "sigma_deg": (1.0, 1.0, ALONG), "estimated": k == 1}
            for k, q in enumerate(MOUNTINGS)
        ]
    if plan == "agile":
        document["interval"] = scenarios.load("agile_trackers").model_dump(exclude_none=True)["interval"]
    elif plan != "TRMM":
        document["interval"] = list(_short_slews() if plan == "short slews" else _survey())
    return Scenario.model_validate(document)


def _short_slews() -> list[dict[str, Any]]:
    turns = [
        ((1, 0, 0), 90),
        ((0, 1, 0), -120),
        ((0, 0, 1), 180),
        ((1, 1, -1), 70),
        ((0, 1, 1), -100),
        ((1, 0, -1), 60),
        ((0, 0, 1), -90),
    ]
    return [_interval(k, 600.0 * k, 300.0, "+x", [(axis, angle, 60.0, 150.0)]) for k, (axis, angle) in enumerate(turns)]


def _survey() -> list[dict[str, Any]]:
    modes = ("+x", "-y", "-x", "+y", "+x", "-x", "-y", "+y")
    axes = ((1, 0, 0), (0, 0, 1), (0, 1, 0), (1, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 1), (1, 0, 1))
    return [
        _interval(k, 1500.0 * k, 1200.0, mode, [(axis, 40, 100.0, 300.0), (axis, -40, 700.0, 300.0)])
        for k, (mode, axis) in enumerate(zip(modes, axes, strict=True))
    ]


def _interval(
    number: int, start_s: float, length_s: float, mode: str, slews: list[tuple[tuple[int, int, int], int, float, float]]
) -> dict[str, Any]:
    return {
        "name": f"p{number + 1}",
        "activity": "slews",
        "start_s": start_s,
        "stop_s": start_s + length_s,
        "mode": mode,
        "slew": [
            {
                "axis": [float(x) for x in axis],
                "angle_deg": float(angle),
                "start_s": at,
                "duration_s": lasts,
                "ramp_fraction": 0.2,
            }
            for axis, angle, at, lasts in slews
        ],
    }
