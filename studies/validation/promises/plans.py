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
from simulator.truth.maneuvers import integrate_trajectory
from simulator.truth.motion import Motion
from simulator.truth.rotation import convert_to_matrix
from studies.calibration.shared_truth import get_true_parameters
from studies.estimation.flights import Flight

Array = NDArray[np.float64]
References = Literal["ends", "series", "trackers"]

PLAN_NAMES = ("TRMM", "agile", "short slews", "survey")
SENSOR_GRADES = {  # ARW in deg/√s, sigma of a reference in deg
    "resonator": (2e-5, 5e-4),
    "fibre optic": (2.6e-4, 5e-3),
    "tactical": (2e-3, 2e-2),
    "MEMS": (1e-2, 1e-1),
}
# What holding the mean rate over a sample leaves must stay below the noise, so that a quieter gyro is sampled more often.
PLAN_SAMPLE_S = {"TRMM": 0.5, "agile": 0.5, "short slews": 0.25, "survey": 0.5}
LONGER = {"resonator": 1, "fibre optic": 2, "tactical": 8, "MEMS": 8}
REFERENCE_SPACING_S = {"TRMM": 100.0, "agile": 100.0, "short slews": 20.0, "survey": 100.0}
FILTERED_INTERVALS = {
    "TRMM": 1,
    "agile": 5,
    "short slews": 3,
    "survey": 1,
}  # the interval that filters and batches are flown on
MOUNTINGS = ((0.953716950748227, 0.0, 0.0, -0.300705799504273), (0.953716950748227, 0.0, 0.0, 0.300705799504273))
ALONG = 10.0  # times a tracker's sigma across its boresight
MOUNTING_SIGMA_DEG = 0.05


def select_plan_and_grade(number: int) -> tuple[str, str]:
    """Plan and grade of a case: neighbours differ, so that any number of cases is spread over all of them."""
    return PLAN_NAMES[number % len(PLAN_NAMES)], list(SENSOR_GRADES)[number // len(PLAN_NAMES) % len(SENSOR_GRADES)]


def build_graded_scenario(plan: str, grade: str, references: References = "series", array: bool = False) -> Scenario:
    """A plan with a grade of noise.

    Parameters
    ----------
    plan, grade : names
    references : at the ends of intervals, a series, or by two star trackers, the second of which has its mounting estimated
    array : whether the gyros are four in a tetrahedron in place of x, y and z
    """
    arw, sigma = SENSOR_GRADES[grade]
    return _set_noise_grade(_build_plan_scenario(plan, compute_sample_length(plan, grade), references, array), arw, sigma)


def compute_sample_length(plan: str, grade: str) -> float:
    """Length of a sample."""
    return PLAN_SAMPLE_S[plan] * LONGER[grade]


def simulate_plan_motion(plan: str, grade: str, references: References) -> Motion:
    """The noise-free motion, of which grades change how it is sampled."""
    return _simulate_plan_cached(plan, compute_sample_length(plan, grade), references)


@lru_cache(maxsize=36)
def _simulate_plan_cached(plan: str, step: float, references: References) -> Motion:
    return motion(_build_plan_scenario(plan, step, references, False))


@lru_cache(maxsize=12)
def _simulate_flown_interval(plan: str, step: float) -> tuple[Array, Array, Array]:
    """Edges of the samples, s, attitudes there, and mean rates of the interval that estimators are flown on."""
    whole = _build_plan_scenario(plan, step, "series", False)
    profile = scenarios.build_profiles(whole)[FILTERED_INTERVALS[plan]]
    t = step * np.arange(int((profile.stop_s - profile.start_s) / step) + 1, dtype=np.float64)
    found = integrate_trajectory(profile, t)
    return t, convert_to_matrix(found.quaternions), found.angles / step


def build_plan_flight(plan: str, grade: str) -> Flight:
    """One interval of a plan as a flight for batches, filters and alignments, from zero seconds on."""
    t, A, rates = _simulate_flown_interval(plan, compute_sample_length(plan, grade))
    own = build_graded_scenario(plan, grade)
    arw = float(np.deg2rad(own.gyro.arw_deg_per_sqrt_s))
    return Flight(t, A, rates, get_true_parameters(own), arw, GyroParameters(get_true_parameters(own).G, np.zeros(3)))


def _set_noise_grade(base: Scenario, arw: float, sigma: float) -> Scenario:
    trackers = tuple(one.model_copy(update={"sigma_deg": (sigma, sigma, ALONG * sigma)}) for one in base.reference.tracker)
    reference = base.reference.model_copy(update={"sigma_deg": (sigma,) * 3, "tracker": trackers})
    gyro = base.gyro.model_copy(update={"arw_deg_per_sqrt_s": arw})
    return base.model_copy(update={"gyro": gyro, "reference": reference})


@lru_cache(maxsize=64)
def _build_plan_scenario(plan: str, step: float, references: References, array: bool) -> Scenario:
    """A plan without a grade."""
    base = scenarios.load("trmm_tetrahedron" if array else "trmm_series")
    document = base.model_dump(exclude_none=True)
    document["title"] = f"promises, {plan}"
    document["gyro"]["sample_s"] = step
    document["reference"] = {"at": "ends" if references == "ends" else "series", "sigma_deg": (1.0, 1.0, 1.0)}
    if references != "ends":
        document["reference"]["every_s"] = REFERENCE_SPACING_S[plan]
    if references == "trackers":
        document["reference"]["tracker"] = [
            {"name": f"st{k + 1}", "mounting": q, "sigma_deg": (1.0, 1.0, ALONG), "estimated": k == 1}
            for k, q in enumerate(MOUNTINGS)
        ]
    if plan == "agile":
        document["interval"] = scenarios.load("agile_trackers").model_dump(exclude_none=True)["interval"]
    elif plan != "TRMM":
        document["interval"] = list(_list_short_slews() if plan == "short slews" else _list_survey_intervals())
    return Scenario.model_validate(document)


def _list_short_slews() -> list[dict[str, Any]]:
    turns = [
        ((1, 0, 0), 90),
        ((0, 1, 0), -120),
        ((0, 0, 1), 180),
        ((1, 1, -1), 70),
        ((0, 1, 1), -100),
        ((1, 0, -1), 60),
        ((0, 0, 1), -90),
    ]
    return [
        _describe_interval(k, 600.0 * k, 300.0, "+x", [(axis, angle, 60.0, 150.0)]) for k, (axis, angle) in enumerate(turns)
    ]


def _list_survey_intervals() -> list[dict[str, Any]]:
    modes = ("+x", "-y", "-x", "+y", "+x", "-x", "-y", "+y")
    axes = ((1, 0, 0), (0, 0, 1), (0, 1, 0), (1, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 1), (1, 0, 1))
    return [
        _describe_interval(k, 1500.0 * k, 1200.0, mode, [(axis, 40, 100.0, 300.0), (axis, -40, 700.0, 300.0)])
        for k, (mode, axis) in enumerate(zip(modes, axes, strict=True))
    ]


def _describe_interval(
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
