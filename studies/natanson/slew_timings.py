"""Timings of the slews, which N and R leave open: those assumed, a scan over others, and those that fit the flight.

Timings are fitted to the clean gap (see `studies.natanson.flight_gap`): the residuals before calibration hold noise, which
timings would fit as well.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize

from gyrocal import InputError
from simulator.scenario import IntervalSection, Scenario, override
from studies.natanson import flight
from studies.natanson.flight_diagnosis.table import simulate_residuals
from studies.natanson.flight_diagnosis.timings import replace_slew_timings
from studies.natanson.flight_gap import (
    COARSE_SAMPLE_S,
    HOLD,
    MINUS_Y,
    YAW_INTERVALS,
    compute_clean_gap_rms,
    compute_gap_rms,
    compute_noise_free_residuals,
    predict_residuals,
)

Array = NDArray[np.float64]

SLEWING = (*YAW_INTERVALS, MINUS_Y)
TIMED = (*SLEWING, HOLD)


@dataclass(frozen=True)
class CommonTiming:
    """Timings common to all maneuvers, where N and R leave them open."""

    delay_s: float  # from an interval's start to its first slew
    slew_rate_deg_s: float  # rate all slews coast at
    ramp_fraction: float  # share of a slew spent on speeding up, and again on slowing down
    stay_s: float  # from the middle of the slew into -y forward to the middle of the slew out of it

    def overrides(self, scenario: Scenario) -> dict[str, float]:
        """Overrides of a TRMM scenario."""
        out: dict[str, float] = {}
        for k in SLEWING:
            for j, slew in enumerate(scenario.interval[k].slew):
                duration = abs(slew.angle_deg) / (self.slew_rate_deg_s * (1 - self.ramp_fraction))
                path = f"interval.{k}.slew.{j}"
                out[f"{path}.start_s"] = self.delay_s + (self.stay_s if j else 0.0)
                out[f"{path}.duration_s"] = duration
                out[f"{path}.ramp_fraction"] = self.ramp_fraction
        return out


def read_common_timing(scenario: Scenario) -> CommonTiming:
    """The common timing a TRMM scenario was written with, read off its -y forward interval."""
    into, back = scenario.interval[MINUS_Y].slew
    rate = abs(into.angle_deg) / (into.duration_s * (1 - into.ramp_fraction))
    return CommonTiming(into.start_s, rate, into.ramp_fraction, back.start_s - into.start_s)


SCANNED = {
    "delay_s": (0.0, 30.0, 60.0, 90.0, 120.0),
    "slew_rate_deg_s": (0.2, 0.25, 0.3, 0.35),
    "ramp_fraction": (0.02, 0.1, 0.3, 0.5),
    "stay_s": (3400.0, 3600.0, 3800.0),
}


def scan_common_timings(scenario: Scenario) -> pd.DataFrame:
    """Gap and clean gap over a grid of all four common timings together; slews that do not fit their interval are left out.

    It says how much the numbers without a fit owe to the guess. An interval without slews keeps its residuals, and those of the
    yaw maneuvers do not depend on the stay.
    """
    flown, clean = flight.read_published_residuals("prelaunch"), compute_noise_free_residuals()
    still = [k for k in range(len(scenario.interval)) if k not in SLEWING]
    kept = predict_residuals(scenario)[still]
    timings = [
        timing
        for timing in product(*SCANNED.values())
        if all(_is_flyable(scenario.interval[k], CommonTiming(*timing)) for k in SLEWING)
    ]
    # Sums of squares of both gaps, over the intervals without slews and over each with them.
    of_still = np.array([np.sum((cells[still] - kept) ** 2) for cells in (flown, clean)])
    of_slewing = {}
    for k in SLEWING:
        own = {timing: timing if k == MINUS_Y else timing[:3] for timing in timings}
        different = list(dict.fromkeys(own.values()))
        theta, _ = simulate_residuals(
            [_apply_common_timing(scenario.interval[k], CommonTiming(*(*values, 0.0)[:4])) for values in different]
        )
        found = dict(zip(different, theta, strict=True))
        values = np.array([found[own[timing]] for timing in timings])
        of_slewing[k] = np.array([np.sum((cells[k] - values) ** 2, axis=1) for cells in (flown, clean)])
    gap, clean_gap = np.sqrt((of_still[:, None] + sum(of_slewing.values())) / flown.size)
    table = pd.DataFrame(timings, columns=list(SCANNED)).assign(gap_rms_deg=gap, clean_gap_rms_deg=clean_gap)
    return table.assign(**{_name_gap_column(k): np.sqrt(both[1] / len(flight.ROTATIONS)) for k, both in of_slewing.items()})


def _name_gap_column(k: int) -> str:
    return f"clean_gap_{k + 1}_rms_deg"


def score_held_out_intervals(scan: pd.DataFrame, assumed: CommonTiming) -> dict[str, float]:
    """Clean gap of the three slewing intervals, each with the scanned timing that is best for the other two; RMS, deg.

    The stay in -y forward is left as assumed where that interval is the one held out. "before" has the assumed timings.
    """
    mine = np.all([scan[name] == getattr(assumed, name) for name in SCANNED], axis=0)
    before, after = [], []
    for k in SLEWING:
        rest = [_name_gap_column(other) for other in SLEWING if other != k]
        candidates = scan[scan["stay_s"] == assumed.stay_s] if k == MINUS_Y else scan
        best = np.square(candidates[rest]).sum(axis=1).idxmin()
        before.append(float(scan.loc[mine, _name_gap_column(k)].iloc[0]) if mine.any() else float("nan"))
        after.append(float(scan.loc[best, _name_gap_column(k)]))
    return {"before": float(flight.compute_rms(np.array(before))), "after": float(flight.compute_rms(np.array(after)))}


def summarise_scan_by_value(scan: pd.DataFrame) -> pd.DataFrame:
    """The scan for people: the smallest and largest clean gap at each value of each timing, whatever the others are."""
    return pd.DataFrame(
        [
            {"timing": name, "value": value, "clean_gap_min_deg": gaps.min(), "clean_gap_max_deg": gaps.max()}
            for name in SCANNED
            for value, gaps in scan.groupby(name)["clean_gap_rms_deg"]
        ]
    )


def _compute_slew_duration(section: IntervalSection, timing: CommonTiming) -> float:
    return abs(section.slew[0].angle_deg) / (timing.slew_rate_deg_s * (1 - timing.ramp_fraction))


def _is_flyable(section: IntervalSection, timing: CommonTiming) -> bool:
    """Whether the slews fit into their interval, and the stay between them."""
    duration = _compute_slew_duration(section, timing)
    stay = timing.stay_s if len(section.slew) > 1 else duration
    return duration <= stay and timing.delay_s + duration + (len(section.slew) - 1) * stay <= section.stop_s - section.start_s


def _apply_common_timing(section: IntervalSection, timing: CommonTiming) -> IntervalSection:
    return replace_slew_timings(
        section, timing.delay_s, _compute_slew_duration(section, timing), timing.ramp_fraction, timing.stay_s
    )


@dataclass(frozen=True)
class TimingFit:
    """A fit of timings to the 18 numbers free of noise."""

    scenario: Scenario  # with the fitted timings
    timings: Mapping[str, float]  # fitted values by name
    at_bound: tuple[str, ...]  # names of those that stopped at a bound
    clean_gap_rms_deg: float  # clean_gap_rms_deg, gap_rms_deg: what is left of both
    gap_rms_deg: float

    @property
    def count(self) -> int:
        """Number of fitted values."""
        return len(self.timings)


# What can be flown: slews from 0.1 to 0.6 deg/s on average, and a stay in -y forward of "about one hour".
BOUNDS = {"delay_s": (0.0, 300.0), "slew_rate_deg_s": (0.15, 0.6), "ramp_fraction": (0.02, 0.5), "stay_s": (3000.0, 4000.0)}
MEAN_RATES_DEG_S = (0.1, 0.6)
TRANSITION_BOUNDS_S = (10.0, 600.0)
UNFLYABLE = 1.0  # deg, what timings that do not fit into their interval cost
START_FRACTIONS = (0.2, 0.5, 0.8)  # of the way through the bounds, beside the scenario's own timings


@dataclass(frozen=True)
class _TimingSearch:
    """Timings to fit: their names, where to start, (n, 2) bounds, and the overrides that set them."""

    names: tuple[str, ...]
    start: Array
    bounds: Array
    changes: Callable[[Array], dict[str, float]]

    def list_stopped_at_bound(self, x: Array) -> tuple[str, ...]:
        """Names of those within a thousandth of their range of a bound."""
        near = np.min(np.abs(x[:, None] - self.bounds), axis=1) < 1e-3 * np.ptp(self.bounds, axis=1)
        return tuple(name for name, stopped in zip(self.names, near, strict=True) if stopped)


def fit_common_timings(scenario: Scenario) -> TimingFit:
    """Fit the four timings common to all maneuvers."""
    base = read_common_timing(scenario)
    names = tuple(field.name for field in fields(CommonTiming))
    search = _TimingSearch(
        names=names,
        start=np.array([getattr(base, name) for name in names]),
        bounds=np.array([BOUNDS[name] for name in names]),
        changes=lambda x: CommonTiming(*map(float, x)).overrides(scenario),
    )
    with_slews = sorted(SLEWING)
    return _build_timing_fit(
        scenario, [(search, _fit_to_clean_gap(scenario, search, with_slews, compute_noise_free_residuals()[with_slews]))]
    )


def fit_each_maneuver(scenario: Scenario) -> TimingFit:
    """Fit the timings of each maneuver by itself, nine values for the twelve numbers of four intervals.

    It shows how far timing alone can go: an interval's three numbers leave one degree of freedom, or none, and a timing that
    stops at its bound has been asked for more than it can give.
    """
    return _build_timing_fit(scenario, [(_list_interval_timings(scenario, k), _fit_cached_timings(scenario, k)) for k in TIMED])


def fit_interval_timings(scenario: Scenario, k: int) -> Scenario:
    """The scenario with the timings of interval k fitted to its three numbers, within what can be flown."""
    return override(scenario, _list_interval_timings(scenario, k).changes(_fit_cached_timings(scenario, k)))


Alone = tuple[Scenario, int]  # a scenario that has one interval only, and which of N's it is
TIMING_CACHE: dict[
    Alone, Array
] = {}  # timings fitted to single intervals: those of the direction that was flown are needed twice


def list_missing_fits(candidates: Sequence[tuple[Scenario, int]]) -> list[Alone]:
    """What `fit_isolated_interval` has to be called with for the timings of interval k of each scenario to be kept."""
    return [
        key
        for key in dict.fromkeys(_select_single_interval(scenario, k) for scenario, k in candidates)
        if key not in TIMING_CACHE
    ]


def _select_single_interval(scenario: Scenario, k: int) -> Alone:
    return scenario.model_copy(update={"interval": scenario.interval[k : k + 1]}), k


def _fit_cached_timings(scenario: Scenario, k: int) -> Array:
    """Timings of interval k fitted to its three numbers."""
    key = _select_single_interval(scenario, k)
    if key not in TIMING_CACHE:
        TIMING_CACHE[key] = fit_isolated_interval(*key)
    return TIMING_CACHE[key]


def fit_isolated_interval(scenario: Scenario, k: int) -> Array:
    """The timings of a scenario that has interval k only."""
    return _fit_to_clean_gap(scenario, _list_interval_timings(scenario, 0), [0], compute_noise_free_residuals()[[k]])


def _list_interval_timings(scenario: Scenario, k: int) -> _TimingSearch:
    """Timings to fit of one interval: of its slews, which last equally long, or of its hold."""
    interval, path = scenario.interval[k], f"interval.{k}"
    if interval.hold:
        return _TimingSearch(
            names=(f"{interval.name} hold start_s", f"{interval.name} hold transition_s"),
            start=np.array([interval.hold.start_s, interval.hold.transition_s]),
            bounds=np.array([(0.0, 300.0), TRANSITION_BOUNDS_S]),
            changes=lambda x: {f"{path}.hold.start_s": float(x[0]), f"{path}.hold.transition_s": float(x[1])},
        )
    slews = interval.slew
    slowest, fastest = (abs(slews[0].angle_deg) / rate for rate in MEAN_RATES_DEG_S)
    names = [f"{interval.name} slew start_s", f"{interval.name} slew duration_s"]
    start, bounds = [slews[0].start_s, slews[0].duration_s], [BOUNDS["delay_s"], (fastest, slowest)]
    if len(slews) > 1:
        names.append(f"{interval.name} stay_s")
        start.append(slews[1].start_s - slews[0].start_s)
        bounds.append(BOUNDS["stay_s"])

    def changes(x: Array) -> dict[str, float]:
        out = {f"{path}.slew.{j}.duration_s": float(x[1]) for j in range(len(slews))}
        return out | {f"{path}.slew.{j}.start_s": float(x[0] + (x[2] if j else 0.0)) for j in range(len(slews))}

    return _TimingSearch(tuple(names), np.array(start), np.array(bounds), changes)


def _build_timing_fit(scenario: Scenario, parts: list[tuple[_TimingSearch, Array]]) -> TimingFit:
    timings: dict[str, float] = {}
    at_bound: tuple[str, ...] = ()
    for search, x in parts:
        scenario = override(scenario, search.changes(x))
        timings |= dict(zip(search.names, map(float, x), strict=True))
        at_bound += search.list_stopped_at_bound(x)
    predicted = predict_residuals(scenario)
    return TimingFit(scenario, timings, at_bound, compute_clean_gap_rms(predicted), compute_gap_rms(predicted))


def _fit_to_clean_gap(scenario: Scenario, search: _TimingSearch, intervals: Sequence[int], flown: Array) -> Array:
    """Nelder–Mead on the clean gap of some intervals from several starts; timings that cannot be flown count as a degree."""
    coarse = override(scenario, {"gyro.sample_s": COARSE_SAMPLE_S})
    low, high = search.bounds.T

    def cost(y: Array) -> float:
        try:
            changed = override(coarse, search.changes(low + y * (high - low)))
            some = changed.model_copy(update={"interval": tuple(changed.interval[k] for k in intervals)})
            return float(flight.compute_rms((predict_residuals(some) - flown).ravel()))
        except InputError:
            return UNFLYABLE

    count = len(search.names)
    # Between bounds, the scenario's own timings first; then along the box's diagonal, for a valley elsewhere.
    starts = [np.clip((search.start - low) / (high - low), 0, 1), *(np.full(count, share) for share in START_FRACTIONS)]
    options = {"xatol": 1e-4, "fatol": 1e-6, "maxfev": 60 * count}
    best = min(
        (minimize(cost, y, method="Nelder-Mead", bounds=[(0, 1)] * count, options=options) for y in starts),
        key=lambda found: found.fun,
    )
    if best.fun >= UNFLYABLE:
        raise InputError(f"no timing of {', '.join(search.names)} that can be flown was found")
    return np.asarray(low + np.clip(best.x, 0, 1) * (high - low))
