"""The flight's own numbers as real input: predicted against flown pre-launch residuals, N Table 2.

Truth is the published calibration, R eq. (9); the six intervals are simulated without noise and processed with the pre-launch
parameters. What the simulator does not know are the timings of the slews. If it knew them, and R (9) were exact, the gap
would be the flight's residuals *after* calibration, cell by cell, since those are what R (9) could not explain. So their RMS
is the yardstick, the *floor*, for the gap.

Noise. Skipping samples leaves steps of f samples with the noise of one, so that the residual's noise variance is a²Tf for
f = 1, 2, 4, and the samples are nested: the residuals at the three steps are a random walk in f. Hence the 36 differences
between the columns of N Table 2 are independent, with variances a²T and 2a²T, and their mean square gives the angle random
walk a without knowing anything else.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize

from gyrocal import GyroParameters, InputError, residual_table
from simulator.scenario import Scenario, override
from simulator.simulate import motion, observe
from studies.natanson import flight

Array = NDArray[np.float64]

COARSE_SAMPLE_S = 2.0  # mean rates over longer samples: the prediction moves by less than 1e-4 deg, at a quarter of the cost
YAW_INTERVALS, MINUS_Y, HOLD = (1, 5), 3, 4


@dataclass(frozen=True)
class Timing:
    """Timings common to all maneuvers, where N and R leave them open.

    Attributes
    ----------
    delay_s : from an interval's start to its first slew
    slew_rate_deg_s : rate all slews coast at
    ramp_fraction : share of a slew spent on speeding up, and again on slowing down
    stay_s : from the middle of the slew into -y forward to the middle of the slew out of it
    """

    delay_s: float
    slew_rate_deg_s: float
    ramp_fraction: float
    stay_s: float

    def overrides(self, scenario: Scenario) -> dict[str, float]:
        """What to override in a TRMM scenario."""
        out: dict[str, float] = {}
        for k in (*YAW_INTERVALS, MINUS_Y):
            for j, slew in enumerate(scenario.interval[k].slew):
                duration = abs(slew.angle_deg) / (self.slew_rate_deg_s * (1 - self.ramp_fraction))
                path = f"interval.{k}.slew.{j}"
                out[f"{path}.start_s"] = self.delay_s + (self.stay_s if j else 0.0)
                out[f"{path}.duration_s"] = duration
                out[f"{path}.ramp_fraction"] = self.ramp_fraction
        return out


def timing_of(scenario: Scenario) -> Timing:
    """The common timing a TRMM scenario was written with, read off its -y forward interval."""
    into, back = scenario.interval[MINUS_Y].slew
    rate = abs(into.angle_deg) / (into.duration_s * (1 - into.ramp_fraction))
    return Timing(into.start_s, rate, into.ramp_fraction, back.start_s - into.start_s)


def predict(scenario: Scenario, truth: GyroParameters | None = None, initial: GyroParameters | None = None) -> Array:
    """Noise-free residuals under the initial parameters, (intervals, 3) deg.

    Parameters
    ----------
    scenario : the maneuvers
    truth : injected parameters, R eq. (9) by default
    initial : processed with these, N Table 3's pre-launch ones by default
    """
    truth, initial = truth or flight.calibration(), initial or flight.parameters("prelaunch")
    recording = observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None, G=truth.G, bias=truth.bias)
    table = residual_table(recording, initial)
    return table[[f"before_{name}_deg" for name in flight.ROTATIONS]].to_numpy()


def gap_rms(predicted: Array, intervals: Iterable[int] | None = None) -> float:
    """RMS of flown minus predicted at 0.5 s, over all 18 numbers or some intervals', deg."""
    difference = flight.residuals("prelaunch") - predicted
    rows = difference if intervals is None else difference[list(intervals)]
    return float(flight.rms(rows.ravel()))


def floor_rms() -> float:
    """RMS of the flight's calibrated residuals at 0.5 s, what the gap would be with the true timings, deg."""
    return float(flight.rms(flight.residuals("calibrated").ravel()))


def comparison(scenario: Scenario) -> pd.DataFrame:
    """The 18 numbers: flown, predicted, gap, and the flight's residual after calibration."""
    flown, predicted, after = flight.residuals("prelaunch"), predict(scenario), flight.residuals("calibrated")
    count, axes = len(flown), flight.ROTATIONS
    columns = {"flight": flown, "predicted": predicted, "gap": flown - predicted, "flight_calibrated": after}
    return pd.DataFrame(
        {
            "interval": np.repeat(np.arange(1, count + 1), len(axes)),
            "activity": np.repeat([interval.activity for interval in scenario.interval[:count]], len(axes)),
            "axis": list(axes) * count,
            **{f"{name}_deg": values.ravel() for name, values in columns.items()},
        }
    )


def residual_sign(scenario: Scenario) -> pd.DataFrame:
    """Gap with the residual's sign of N (16), and of N (29) as printed."""
    predicted = predict(scenario)
    return pd.DataFrame(
        {
            "residual": ["N (16): exp([θ×]) = A_obs A_propᵀ", "N (29) as printed, the opposite sign"],
            "gap_rms_deg": [gap_rms(predicted), gap_rms(-predicted)],
        }
    )


def with_minus_y_rate(scenario: Scenario, sign: int) -> Scenario:
    """The scenario with ω_x = sign RPO in interval 4: −1 is −y forward, +1 needs +y forward, the slews reversed."""
    slews = scenario.interval[MINUS_Y].slew
    return override(
        scenario, {f"interval.{MINUS_Y}.slew.{j}.angle_deg": -sign * -abs(s.angle_deg) * (-1) ** j for j, s in enumerate(slews)}
    )


def with_yaw_directions(scenario: Scenario, second: int, sixth: int) -> Scenario:
    """The scenario with the given signs of the 180 deg yaws in intervals 2 and 6."""
    return override(
        scenario,
        {f"interval.{k}.slew.0.angle_deg": 180.0 * sign for k, sign in zip(YAW_INTERVALS, (second, sixth), strict=True)},
    )


def _gaps(candidate: Scenario, k: int) -> dict[str, float]:
    """Gap of interval k with the scenario's timings, and with its own fitted to its three numbers."""
    fitted = fit_interval(candidate, k)
    return {"gap_rms_deg": gap_rms(predict(candidate), [k]), "fitted_gap_rms_deg": gap_rms(predict(fitted), [k])}


def minus_y_rate_test(scenario: Scenario) -> pd.DataFrame:
    """Gap of interval 4 for either sign of its rate, with the scenario's timings and with its own fitted to that sign.

    The fitted gap of the favoured sign says little, three timings being fitted to three numbers; that of the other says that
    no timing that can be flown saves it.
    """
    rows = []
    for sign in (-1, 1):
        candidate = with_minus_y_rate(scenario, sign)
        gap = flight.residuals("prelaunch")[MINUS_Y] - predict(candidate)[MINUS_Y]
        row = {"rate_rpo": sign, "mode": "-y forward" if sign < 0 else "+y forward", **_gaps(candidate, MINUS_Y)}
        rows.append(row | {f"gap_{name}_deg": value for name, value in zip(flight.ROTATIONS, gap, strict=True)})
    return pd.DataFrame(rows)


def yaw_direction_test(scenario: Scenario) -> pd.DataFrame:
    """Gap of intervals 2 and 6 for each direction of their yaw maneuvers, with and without fitted timings."""
    return pd.DataFrame(
        [
            {"interval": k + 1, "yaw_deg": 180 * sign, **_gaps(with_yaw_directions(scenario, sign, sign), k)}
            for k in YAW_INTERVALS
            for sign in (1, -1)
        ]
    )


def timing_scan(
    scenario: Scenario,
    delays_s: Iterable[float] = (30.0, 60.0, 90.0, 120.0),
    rates_deg_s: Iterable[float] = (0.2, 0.25, 0.3, 0.35),
) -> pd.DataFrame:
    """Gap over a grid of common timings: how much the unfitted number owes to the guess. Slews that do not fit are left out."""
    scenario, base = _coarse(scenario), timing_of(scenario)
    rows = []
    for delay in delays_s:
        for rate in rates_deg_s:
            timing = replace(base, delay_s=delay, slew_rate_deg_s=rate)
            with suppress(InputError):
                gap = gap_rms(predict(override(scenario, timing.overrides(scenario))))
                rows.append({"delay_s": delay, "slew_rate_deg_s": rate, "gap_rms_deg": gap})
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class TimingFit:
    """A fit of timings to the 18 numbers.

    Attributes
    ----------
    scenario : with the fitted timings
    timings : fitted values by name
    at_bound : names of those that stopped at a bound
    gap_rms_deg : what is left
    dof : numbers less fitted values
    """

    scenario: Scenario
    timings: Mapping[str, float]
    at_bound: tuple[str, ...]
    gap_rms_deg: float
    dof: int

    @property
    def count(self) -> int:
        """How many values were fitted."""
        return len(self.timings)


# What can be flown: slews from 0.1 to 0.6 deg/s on average, and a stay in -y forward of "about one hour".
BOUNDS = {"delay_s": (0.0, 300.0), "slew_rate_deg_s": (0.15, 0.6), "ramp_fraction": (0.02, 0.5), "stay_s": (3000.0, 4000.0)}
MEAN_RATES_DEG_S = (0.1, 0.6)
TRANSITION_BOUNDS_S = (10.0, 600.0)
UNFLYABLE = 1.0  # deg, what timings that do not fit into their interval cost
STARTS = (0.2, 0.5, 0.8)  # of the way through the bounds, beside the scenario's own timings


@dataclass(frozen=True)
class _Search:
    """Timings to fit: their names, where to start, (n, 2) bounds, and the overrides that set them."""

    names: tuple[str, ...]
    start: Array
    bounds: Array
    changes: Callable[[Array], dict[str, float]]

    def at_bound(self, x: Array) -> tuple[str, ...]:
        """Names of those within a thousandth of their range of a bound."""
        near = np.min(np.abs(x[:, None] - self.bounds), axis=1) < 1e-3 * np.ptp(self.bounds, axis=1)
        return tuple(name for name, stopped in zip(self.names, near, strict=True) if stopped)


def fit_common(scenario: Scenario) -> TimingFit:
    """Fit the four timings common to all maneuvers."""
    base = timing_of(scenario)
    names = tuple(field.name for field in fields(Timing))
    search = _Search(
        names=names,
        start=np.array([getattr(base, name) for name in names]),
        bounds=np.array([BOUNDS[name] for name in names]),
        changes=lambda x: Timing(*map(float, x)).overrides(scenario),
    )
    return _fitted(
        scenario, [(search, _minimise(scenario, search, sorted((*YAW_INTERVALS, MINUS_Y))))]
    )  # the others hold no slew


def fit_each(scenario: Scenario) -> TimingFit:
    """Fit the timings of each maneuver by itself, nine values for the twelve numbers of four intervals.

    It shows how far timing alone can go, and fits noise as well: an interval's three numbers leave one degree of freedom, or
    none, and a timing that stops at its bound has been asked for more than it can give.
    """
    parts = []
    for k in (*YAW_INTERVALS, MINUS_Y, HOLD):
        search = _timings_of(scenario, k)
        parts.append((search, _minimise(scenario, search, [k])))
    return _fitted(scenario, parts)


def fit_interval(scenario: Scenario, k: int) -> Scenario:
    """The scenario with the timings of interval k fitted to its three numbers, within what can be flown."""
    search = _timings_of(scenario, k)
    return override(scenario, search.changes(_minimise(scenario, search, [k])))


def _timings_of(scenario: Scenario, k: int) -> _Search:
    """Timings to fit of one interval: of its slews, which last equally long, or of its hold."""
    interval, path = scenario.interval[k], f"interval.{k}"
    if interval.hold:
        return _Search(
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

    return _Search(tuple(names), np.array(start), np.array(bounds), changes)


def _fitted(scenario: Scenario, parts: list[tuple[_Search, Array]]) -> TimingFit:
    timings: dict[str, float] = {}
    at_bound: tuple[str, ...] = ()
    for search, x in parts:
        scenario = override(scenario, search.changes(x))
        timings |= dict(zip(search.names, map(float, x), strict=True))
        at_bound += search.at_bound(x)
    return TimingFit(scenario, timings, at_bound, gap_rms(predict(scenario)), 18 - len(timings))


def _minimise(scenario: Scenario, search: _Search, intervals: Sequence[int]) -> Array:
    """Nelder–Mead on the gap of some intervals from several starts; timings that cannot be flown count as a degree."""
    coarse = _coarse(scenario)
    flown = flight.residuals("prelaunch")[list(intervals)]
    low, high = search.bounds.T

    def cost(y: Array) -> float:
        try:
            changed = override(coarse, search.changes(low + y * (high - low)))
            some = changed.model_copy(update={"interval": tuple(changed.interval[k] for k in intervals)})
            return float(flight.rms((predict(some) - flown).ravel()))
        except InputError:
            return UNFLYABLE

    count = len(search.names)
    # Between bounds, the scenario's own timings first; then along the box's diagonal, for a valley elsewhere.
    starts = [np.clip((search.start - low) / (high - low), 0, 1), *(np.full(count, share) for share in STARTS)]
    options = {"xatol": 1e-4, "fatol": 1e-6, "maxfev": 60 * count}
    best = min(
        (minimize(cost, y, method="Nelder-Mead", bounds=[(0, 1)] * count, options=options) for y in starts),
        key=lambda found: found.fun,
    )
    if best.fun >= UNFLYABLE:
        raise InputError(f"no timing of {', '.join(search.names)} that can be flown was found")
    return np.asarray(low + np.clip(best.x, 0, 1) * (high - low))


def noise_from_steps() -> dict[str, float]:
    """The flight's angle random walk from the spread between step sizes, and what it means for one residual.

    Returns
    -------
    arw_deg_per_sqrt_s with its relative_sigma, rate_noise_deg_s of one 0.5 s sample, and residual_rms_deg, the RMS noise of the
    18 residuals at 0.5 s that comes from the gyro.
    """
    columns = [flight.residuals("prelaunch", step) for step in flight.STEPS]
    T = flight.durations()[:, None]
    samples = np.concatenate([((columns[1] - columns[0]) ** 2 / T).ravel(), ((columns[2] - columns[1]) ** 2 / (2 * T)).ravel()])
    arw = float(np.sqrt(samples.mean()))
    return {
        "arw_deg_per_sqrt_s": arw,
        "relative_sigma": float(1 / np.sqrt(2 * samples.size)),
        "rate_noise_deg_s": arw / np.sqrt(0.5),
        "residual_rms_deg": float(arw * np.sqrt(T.mean())),
    }


def _coarse(scenario: Scenario) -> Scenario:
    return override(scenario, {"gyro.sample_s": COARSE_SAMPLE_S})
