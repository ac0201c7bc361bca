"""Slews that make an objective smallest, within limits: the worst sigma of G and b, or the size that separates two effects.

The objectives, and how the information of intervals adds, are those of `diagnosis.plan.objectives`. Free are the slews
(`diagnosis.plan.slew_design`), the lengths of intervals with references at their ends, whether a hold stays, and the
attitudes between intervals. The first and the last attitude stay.

The search begins with no slews, and with the scenario's own if they fit in the limits. An exchange over a list of designs
for each interval replaces those of two intervals at a time, and turns the attitudes between them, as long as this lowers a
smooth form of the objective, (1/p) ln Σ exp(p v_j) (Fedorov, Theory of Optimal Experiments, 1972, for the exchange). SLSQP
of `scipy.optimize.minimize` then moves axes, angles, times and lengths: it minimises t with t ≥ v_j for all j. The optimum
is a local one.

Samples are longer than the scenario's: a slew by 5 deg in a sample changes sigmas by less than 1e-3. The sigmas of the
result come from the scenario's own samples, by `gyrocal.calibrate`, and the sizes from its linear model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from diagnosis.plan.columns import linearise_noise_free
from diagnosis.plan.objectives import PlanObjective, SeparationObjective, SigmaObjective
from diagnosis.plan.result import Progress
from diagnosis.plan.separate import OWN_PLAN, Separation, evaluate_separation
from diagnosis.plan.settings import SETTINGS
from diagnosis.plan.slew_design import (
    QUARTER_MODES,
    IntervalDesign,
    SlewLimits,
    build_interval,
    build_slews,
    compute_slew_time,
    find_end_quarter,
)
from gyrocal import calibrate
from gyrocal.calibration.parameters import NAMES
from gyrocal.errors import InputError
from simulator.scenario import Scenario, build_profiles, override
from simulator.simulate import simulate

Array = NDArray[np.float64]

FIRST_SLEW_AXES = np.vstack([np.eye(3), -np.eye(3)])
FIRST_SLEW_ANGLES = np.deg2rad([20.0, 45.0, 90.0])  # of first slews that a second one ends
LENGTH_SHARES: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)  # of the scenario's interval
DIFFERENCE_STEP = 1e-5  # of finite differences, rad or share
SLEW_TIME_MARGIN = 1e-6  # share of the slew time that SLSQP leaves, for its tolerance
# Of a turn, its place and the length.
DESIGN_BOUNDS = np.array([[-2 * np.pi] * 3 + [0.0, 0.0, 0.01], [2 * np.pi] * 3 + [1.0, 1.0, 1.0]])


@dataclass(frozen=True)
class OptimisedPlan:
    """A scenario with other slews, and what they bring.

    Attributes
    ----------
    scenario, baseline : the plan that was found, and the one to improve on
    limits : within which it is
    sigma, baseline_sigma : (12,) of G and b (rad/s), as the calibrator states them for noise-free recordings
    slew_s, baseline_slew_s : time of all slews and transitions of holds
    separation : of two effects by the baseline and by the plan, if the slews were searched for that
    """

    scenario: Scenario
    baseline: Scenario
    limits: SlewLimits
    sigma: Array
    baseline_sigma: Array
    slew_s: float
    baseline_slew_s: float
    separation: tuple[Separation, Separation] | None = None

    @property
    def worst_ratio(self) -> float:
        """Largest ratio of a sigma to the baseline's."""
        return float((self.sigma / self.baseline_sigma).max())

    def to_json(self) -> dict[str, Any]:
        """Document of `gyrocal plan --optimise --json`, format 1; biases in rad/s."""
        return {
            "format": 1,
            "scenario": self.baseline.title,
            "slew_s": {"before": self.baseline_slew_s, "after": self.slew_s, "limit": self.limits.slew_s},
            "max_rate_deg_s": float(np.rad2deg(self.limits.rate)),
            "max_acceleration_deg_s2": float(np.rad2deg(self.limits.acceleration)),
            "worst_ratio": self.worst_ratio,
            "separation": self.separation and dict(zip(("before", "after"), map(vars, self.separation), strict=True)),
            "sigma": {
                name: {"before": float(before), "after": float(after)}
                for name, before, after in zip(NAMES, self.baseline_sigma, self.sigma, strict=True)
            },
            "intervals": [one.model_dump(mode="json", exclude_none=True) for one in self.scenario.interval],
        }


def optimise_plan(
    scenario: Scenario, limits: SlewLimits, progress: Progress | None = None, separate: tuple[str, str] | None = None
) -> OptimisedPlan:
    """Find slews with the smallest worst sigma of G and b over that of the scenario, or those that separate two effects best.

    Parameters
    ----------
    scenario : the plan to improve on, of three gyros x, y and z
    limits : of rate, acceleration, time and the Sun
    progress : called with a text and the share done
    separate : names of two effects; then the size of the first that separates it from the second is made smallest

    Raises
    ------
    InputError
        The scenario has other gyros or no references, an effect has no fixed shape or cannot be shown, or no plan within
        the limits was found.
    """
    tell = progress or (lambda text, share: None)
    if scenario.gyro.array is not None:
        raise InputError("an optimised plan is for three gyros x, y and z; take the scenario without [gyro.array]")
    if scenario.reference.at == "none":
        raise InputError("the scenario has no reference attitudes to calibrate with; set [reference] at to ends or series")
    objective = SeparationObjective(scenario, limits, *separate) if separate else SigmaObjective(scenario, limits)
    starts = [_build_start(objective), *_list_own_designs(objective)]
    found = []
    for number, start in enumerate(starts):
        tell("refinement of axes, angles and times", 0.9 * number / len(starts))
        found.append(refine_designs(objective, start))
        tell("exchange of slews", 0.9 * (number + 0.2) / len(starts))
        found.append(refine_designs(objective, exchange_designs(objective, start)))
    best = min(found, key=lambda designs: float(objective.compute_values(designs).max()))
    tell("sigmas from the scenario's own samples", 0.95)
    sections = [build_interval(one, best[k], limits) for k, one in enumerate(scenario.interval)]
    improved = override(
        scenario.model_copy(update={"title": f"{scenario.title}, optimised slews"}),
        {"interval": [one.model_dump(mode="json", exclude_none=True) for one in sections]},
    )
    before, after = (calibrate(simulate(one, noise=False)).sigma for one in (scenario, improved))
    separation = None
    if separate:
        own, found_one = (
            evaluate_separation(OWN_PLAN, linearise_noise_free(one), *separate, None) for one in (scenario, improved)
        )
        separation = own, replace(found_one, plan=improved.title)
    slew_s = compute_slew_time(improved), compute_slew_time(scenario)
    return OptimisedPlan(improved, scenario, limits, after, before, *slew_s, separation)


def list_designs(objective: PlanObjective, k: int, start: int, end: int, left: float) -> list[IntervalDesign]:
    """The designs of the exchange for an interval between two modes that fit in it and take at most `left` seconds of slews.

    With references at the ends of intervals the designs have several lengths, down to the shortest one for their slews.
    """
    rest, section = IntervalDesign(start, end), objective.scenario.interval[k]
    if start == end:
        turns, ends = [2 * np.pi * axis for axis in FIRST_SLEW_AXES], [0.0]
        found, pairs = [rest], [angle * axis for axis in FIRST_SLEW_AXES for angle in FIRST_SLEW_ANGLES]
    else:
        (short,), ends = rest.turns, [0.0, 1.0]
        turns, found, pairs = [short, short * (1 - 2 * np.pi / np.linalg.norm(short))], [], []
    found += [replace(rest, turn=_freeze(turn), place=(share, 0.0)) for turn in turns for share in ends]
    found += [replace(rest, turn=_freeze(turn), place=place) for turn in pairs for place in SETTINGS.slew_places]
    out = [replace(rest, hold=True)] if section.hold and start == end else []
    length = section.stop_s - section.start_s
    for one in found:
        slews, spare = build_slews(one, length, objective.limits)
        shortest = 1 - spare / length
        if slews and (shortest > 1 or sum(slew.duration_s for slew in slews) > left):
            continue
        shares = list(LENGTH_SHARES[:: max(1, len(slews))] if objective.scenario.reference.at == "ends" else LENGTH_SHARES[:1])
        if len(slews) == 1 and len(shares) > 1 and one.place == (0.0, 0.0):
            shares.append(shortest)
        out += [replace(one, length=share) for share in shares if share >= shortest]
    measured = [objective.measure(k, one) for one in out]
    return [one for one, seen in zip(out, measured, strict=True) if seen.is_allowed and seen.slew_s <= left]


def _freeze(turn: Array) -> tuple[float, float, float]:
    return (float(turn[0]), float(turn[1]), float(turn[2]))


def _build_start(objective: PlanObjective) -> list[IntervalDesign]:
    """The plan with the fewest slews: none, or one from the first attitude to the last one.

    Raises
    ------
    InputError
        No interval has room for that slew.
    """
    profiles = build_profiles(objective.scenario)
    first, last = QUARTER_MODES.index(objective.scenario.interval[0].mode), find_end_quarter(profiles[-1])
    last = first if last is None else last
    for turned in reversed(range(len(profiles))):
        designs = [IntervalDesign(first, first)] * turned + [IntervalDesign(last, last)] * (len(profiles) - turned)
        for one in list_designs(objective, turned, first, last, objective.limits.slew_s):
            return [*designs[:turned], one, *designs[turned + 1 :]]
    raise InputError(
        f"no interval has room for a slew from the first attitude to the last one within {objective.limits.slew_s:g} s of "
        "slews; allow more with --slew-time, --max-rate or --max-acceleration"
    )


def _list_own_designs(objective: PlanObjective) -> list[list[IntervalDesign]]:
    """The scenario's own slews, as short as the limits allow; none if they take too long or an interval has more than two."""
    designs = []
    for section, profile in zip(objective.scenario.interval, build_profiles(objective.scenario), strict=True):
        start, end = QUARTER_MODES.index(section.mode), find_end_quarter(profile)
        if end is None or len(profile.slews) > 2 or (profile.hold and profile.slews):
            return []
        turns = [slew.angle * slew.axis for slew in profile.slews]
        one = IntervalDesign(start, end, _freeze(turns[0] if turns else np.zeros(3)), hold=profile.hold is not None)
        spare = build_slews(one, section.stop_s - section.start_s, objective.limits)[1]
        if turns and spare > 0:
            before = float(np.clip((profile.slews[0].start - objective.limits.settle_s) / spare, 0, 1))
            gap = profile.slews[-1].start - profile.slews[0].stop
            one = replace(one, place=(before, float(np.clip(gap / max(spare * (1 - before), 1e-9), 0, 1))))
        designs.append(one)
    measured = [objective.measure(k, one) for k, one in enumerate(designs)]
    joined = all(first.end == second.start for first, second in pairwise(designs))
    allowed = all(one.is_allowed for one in measured) and sum(one.slew_s for one in measured) <= objective.limits.slew_s
    return [designs] if joined and allowed else []


def find_best_exchange(
    objective: PlanObjective, designs: Sequence[IntervalDesign], places: Sequence[int], turned: int
) -> tuple[float, list[IntervalDesign]]:
    """Find the best of all designs of one or two intervals together, with the modes between them yawed by quarter turns.

    Returns
    -------
    Smooth worst sigma, infinite where the limits allow nothing; the plan.
    """
    first, last = places[0], places[-1]
    plan = [
        replace(one, start=(one.start + turned) % 4, end=(one.end + turned) % 4) if first < k < last else one
        for k, one in enumerate(designs)
    ]
    rest = [objective.measure(k, one) for k, one in enumerate(plan) if k not in places]
    if not all(one.is_allowed for one in rest):
        return np.inf, plan
    left = objective.limits.slew_s - sum(one.slew_s for one in rest) + 1e-9
    lists = []
    for k in places:
        start = (designs[k].start + turned * (k != first)) % 4
        end = (designs[k].end + turned * (k != last)) % 4
        lists.append(list_designs(objective, k, start, end, left))
    measured = [[objective.measure(k, one) for one in found] for k, found in zip(places, lists, strict=True)]
    slew_s = reduce(np.add.outer, [np.array([one.slew_s for one in found]) for found in measured])
    rows = np.argwhere(slew_s <= left)
    if not len(rows):
        return np.inf, plan
    total = sum((one.information for one in rest), np.zeros(()))
    for n, found in enumerate(measured):
        total = total + np.array([one.information for one in found])[rows[:, n]]
    values = objective.compute_smooth_worst(total)
    best = int(values.argmin())
    for n, k in enumerate(places):
        plan[k] = lists[n][rows[best, n]]
    return float(values[best]), plan


def exchange_designs(objective: PlanObjective, designs: Sequence[IntervalDesign]) -> list[IntervalDesign]:
    """Exchange designs until no exchange lowers the smooth worst sigma."""
    places: list[tuple[int, ...]] = [*combinations(range(len(designs)), 2)] or [(0,)]
    current, value, before = list(designs), np.inf, np.nan
    while not value >= before - SETTINGS.improvement:
        before = value
        for pair, turned in product(places, range(len(QUARTER_MODES))):
            found, plan = find_best_exchange(objective, current, pair, turned)
            if found < value - SETTINGS.improvement:
                value, current = found, plan
    return current


def refine_designs(objective: PlanObjective, designs: Sequence[IntervalDesign]) -> list[IntervalDesign]:
    """Move axes, angles, times and lengths to the smallest worst sigma; the designs as they are where that fails."""
    start, moved = np.array([_pack(one) for one in designs]), np.array([_list_free(objective, one) for one in designs])
    if not moved.any():
        return list(designs)

    def place(x: Array) -> list[IntervalDesign]:
        values = start.copy()
        values[moved] = x
        return [_unpack(one, row) for one, row in zip(designs, values, strict=True)]

    def compute_slack(xt: Array) -> Array:
        plan = place(xt[:-1])
        measured = [objective.measure(k, one) for k, one in enumerate(plan)]
        left = 1 - SLEW_TIME_MARGIN - sum(one.slew_s for one in measured) / objective.limits.slew_s
        own = [(one.spare_s / 100.0, 10 * one.sun_margin) for one in measured]
        return np.concatenate([xt[-1] - objective.compute_values(plan), [left], np.ravel(own)])

    low, high = (np.broadcast_to(side, start.shape)[moved] for side in DESIGN_BOUNDS)
    worst = float(objective.compute_values(designs).max())
    found = minimize(
        lambda xt: float(xt[-1]),
        np.append(start[moved], worst),
        method="SLSQP",
        bounds=[*zip(low, high, strict=True), (None, None)],
        constraints={"type": "ineq", "fun": compute_slack},
        options={"maxiter": 100, "ftol": SETTINGS.improvement / 10, "eps": DIFFERENCE_STEP},
    )
    plan = place(np.clip(found.x[:-1], low, high))
    allowed = all(objective.measure(k, one).is_allowed for k, one in enumerate(plan))
    allowed &= objective.compute_slew_time(plan) <= objective.limits.slew_s
    return plan if allowed and objective.compute_values(plan).max() < worst else list(designs)


def _pack(design: IntervalDesign) -> Array:
    """(6,) the numbers of a design that can be moved."""
    return np.array([*design.turn, *design.place, design.length])


def _unpack(design: IntervalDesign, values: Array) -> IntervalDesign:
    return replace(design, turn=_freeze(values), place=(float(values[3]), float(values[4])), length=float(values[5]))


def _list_free(objective: PlanObjective, design: IntervalDesign) -> list[bool]:
    """(6,) which of them may move: with one slew its turn is that from attitude to attitude."""
    slews, ends = len(design.turns), objective.scenario.reference.at == "ends"
    return [slews == 2] * 3 + [slews > 0, slews == 2, ends and not design.hold]
