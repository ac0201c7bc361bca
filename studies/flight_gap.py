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

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize

from gyrocal import GyroParameters, InputError, residual_table
from simulator.scenario import Scenario, override
from simulator.simulate import motion, observe
from studies import flight

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
    predicted, flown, after = predict(scenario), flight.residuals("prelaunch"), flight.residuals("calibrated")
    rows = [
        {
            "interval": k + 1,
            "activity": scenario.interval[k].activity,
            "axis": axis,
            "flight_deg": flown[k, j],
            "predicted_deg": predicted[k, j],
            "gap_deg": flown[k, j] - predicted[k, j],
            "flight_calibrated_deg": after[k, j],
        }
        for k in range(len(flown))
        for j, axis in enumerate(flight.ROTATIONS)
    ]
    return pd.DataFrame(rows)


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


def minus_y_rate_test(scenario: Scenario) -> pd.DataFrame:
    """Gap of interval 4 for either sign of its rate, with the scenario's timings and with its own fitted to that sign."""
    rows = []
    for sign in (-1, 1):
        candidate = with_minus_y_rate(scenario, sign)
        fitted = fit_interval(candidate, MINUS_Y)
        rows.append(
            {
                "rate_rpo": sign,
                "mode": "-y forward" if sign < 0 else "+y forward",
                "gap_rms_deg": gap_rms(predict(candidate), [MINUS_Y]),
                "fitted_gap_rms_deg": gap_rms(predict(fitted), [MINUS_Y]),
                **dict(zip(("gap_roll_deg", "gap_pitch_deg", "gap_yaw_deg"), _gap(candidate)[MINUS_Y], strict=True)),
            }
        )
    return pd.DataFrame(rows)


def yaw_direction_test(scenario: Scenario) -> pd.DataFrame:
    """Gap of intervals 2 and 6 for each direction of their yaw maneuvers, with and without fitted timings."""
    rows = []
    for k in YAW_INTERVALS:
        for sign in (1, -1):
            candidate = with_yaw_directions(scenario, sign, sign)
            fitted = fit_interval(candidate, k)
            rows.append(
                {
                    "interval": k + 1,
                    "yaw_deg": 180 * sign,
                    "gap_rms_deg": gap_rms(predict(candidate), [k]),
                    "fitted_gap_rms_deg": gap_rms(predict(fitted), [k]),
                }
            )
    return pd.DataFrame(rows)


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
            gap = _gap_or_none(scenario, timing.overrides(scenario))
            if gap is not None:
                rows.append({"delay_s": delay, "slew_rate_deg_s": rate, "gap_rms_deg": gap})
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class TimingFit:
    """A fit of timings to the 18 numbers.

    Attributes
    ----------
    scenario : with the fitted timings
    timings : fitted values by name
    gap_rms_deg : what is left
    dof : numbers less fitted values
    """

    scenario: Scenario
    timings: Mapping[str, float]
    gap_rms_deg: float
    dof: int

    @property
    def count(self) -> int:
        """How many values were fitted."""
        return len(self.timings)


BOUNDS = {"delay_s": (0.0, 300.0), "slew_rate_deg_s": (0.15, 0.6), "ramp_fraction": (0.02, 0.5), "stay_s": (3000.0, 4000.0)}


def fit_common(scenario: Scenario) -> TimingFit:
    """Fit the four timings common to all maneuvers."""
    coarse = _coarse(scenario)
    names = [field.name for field in fields(Timing)]
    start = np.array([getattr(timing_of(scenario), name) for name in names])
    best = _minimise(
        lambda x: _gap_or_none(coarse, Timing(*map(float, x)).overrides(coarse)), start, [BOUNDS[name] for name in names]
    )
    fitted = override(scenario, Timing(*map(float, best)).overrides(scenario))
    return TimingFit(fitted, dict(zip(names, map(float, best), strict=True)), gap_rms(predict(fitted)), 18 - len(names))


def fit_each(scenario: Scenario) -> TimingFit:
    """Fit the timings of each maneuver by itself: start and duration of every slew and of the hold's transitions.

    Ten values for the twelve numbers of four intervals: shows how far timing alone can go, and fits noise as well.
    """
    values: dict[str, float] = {}
    for k in (*YAW_INTERVALS, MINUS_Y, HOLD):
        alone = fit_interval(scenario, k)
        changed = _interval_timing(alone, k)
        values |= changed
        scenario = override(scenario, changed)
    return TimingFit(scenario, values, gap_rms(predict(scenario)), 18 - len(values))


def fit_interval(scenario: Scenario, k: int) -> Scenario:
    """Fit the timings of interval k alone, within the interval."""
    coarse = _coarse(scenario)
    alone = coarse.model_copy(update={"interval": (coarse.interval[k],)})
    target = flight.residuals("prelaunch")[k]
    names = list(_interval_timing(scenario, k))
    start = np.array(list(_interval_timing(scenario, k).values()))
    length = scenario.interval[k].stop_s - scenario.interval[k].start_s

    def gap(x: Array) -> float | None:
        changes = {name.replace(f"interval.{k}.", "interval.0."): float(value) for name, value in zip(names, x, strict=True)}
        try:
            return float(flight.rms(predict(override(alone, changes))[0] - target))
        except InputError:
            return None

    best = _minimise(gap, start, [(0.0, length)] * len(names))
    return override(scenario, dict(zip(names, map(float, best), strict=True)))


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


def _gap(scenario: Scenario) -> Array:
    return np.asarray(flight.residuals("prelaunch") - predict(scenario))


def _coarse(scenario: Scenario) -> Scenario:
    return override(scenario, {"gyro.sample_s": COARSE_SAMPLE_S})


def _interval_timing(scenario: Scenario, k: int) -> dict[str, float]:
    """Free timings of an interval by their paths."""
    interval = scenario.interval[k]
    out = {}
    for j, slew in enumerate(interval.slew):
        out[f"interval.{k}.slew.{j}.start_s"] = slew.start_s
        out[f"interval.{k}.slew.{j}.duration_s"] = slew.duration_s
    if interval.hold:
        out[f"interval.{k}.hold.start_s"] = interval.hold.start_s
        out[f"interval.{k}.hold.transition_s"] = interval.hold.transition_s
    return out


def _gap_or_none(scenario: Scenario, changes: Mapping[str, float]) -> float | None:
    try:
        return gap_rms(predict(override(scenario, changes)))
    except InputError:  # slews that do not fit into their interval
        return None


def _minimise(gap: Callable[[Array], float | None], start: Array, bounds: list[tuple[float, float]]) -> Array:
    """Nelder–Mead from the start, restarted once; timings that cannot be flown count as a gap of one degree."""
    scale = np.maximum(0.1 * np.abs(start), 1e-3)
    low, high = (np.array(side) / scale for side in zip(*bounds, strict=True))

    def cost(y: Array) -> float:
        value = gap(y * scale)
        return 1.0 if value is None else value

    y = start / scale
    for _ in range(2):
        simplex = np.clip(np.vstack([y, y + np.where(y + 1 < high, 1, -1) * np.eye(len(y))]), low, high)
        options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-6, "maxfev": 150}
        y = minimize(cost, y, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)), options=options).x
    return np.asarray(y * scale)
