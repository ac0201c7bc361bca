"""Diagnosis of R Table 3: causes of the misfit between the simulated and the flown Mission Mode, by the common inference.

Observations are flown minus simulated values of R Table 3's 18 numbers, in sigmas. The variance has three parts: the scatter of
the windows, once for the simulated and once for the flight's own finite record, and the printed digits. M0 is the nominal
Mission Mode under R's own statistic. A candidate's column is the change of the numbers when its effect is simulated in the same
windows with the same noise. Noises, and effects that change sign along the orbit, add in quadrature: their amplitude is the
square of their size, in which the numbers are nearest to linear. An effect of either sign whose two sides differ is two
candidates. An effect that is either present or absent is a shift.

The rival is "unknown", a random difference of any size in all numbers, in a period's, or in one number. Beside the search over
all 18 numbers, whole periods are held out: sizes from two periods predict the third.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from diagnosis.answer import Closure
from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.inference.closure import compute_closure
from diagnosis.model.linear import CandidateColumns, LinearModel, Parameters, read_first_amplitude
from diagnosis.posterior import Attribution, rank_without_naming
from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array
from studies.printed_table import UNKNOWN_NAME, build_model, make_candidate, make_rival, rank_explanations
from studies.robertson.calendar import PERIODS
from studies.robertson.ground import DEG_H_PER_RAD_S
from studies.robertson.ladder import (
    NOMINAL,
    TRIED_EFFECTS,
    WINDOW_NUMBERS,
    Number,
    TrialEffect,
    apply_mission_effects,
    compute_simulated_numbers,
    estimate_relative_error,
    read_published_numbers,
    simulate_bias_walk,
)

Windows = Mapping[tuple[str, ...], pd.DataFrame]

LAST_DIGITS = {"attitude_accuracy_deg": 1e-3, "yaw_update_deg": 1e-2, "gyro_bias_std_deg_h": 1e-4}  # R Table 3's last ones
UNKNOWN_LIMITS = (0.3, 300.0)  # sigmas of a random difference
MOST_MISSION_EFFECTS = 4


@dataclass(frozen=True)
class PerformanceDiagnosis:
    """The diagnosis of R Table 3."""

    attribution: Attribution  # of the common inference
    fitted: tuple[FittedEffect, ...]  # effects of the likeliest explanation
    closed: Closure | None  # with whole periods held out; None where nothing listed was found

    @property
    def probabilities(self) -> dict[str, float]:
        """Probability of each candidate, the likeliest first."""
        out: dict[str, float] = {}
        for explanation in self.attribution.ranked:
            for label in explanation.labels:
                out[label] = out.get(label, 0.0) + explanation.probability
        return dict(sorted(out.items(), key=lambda item: -item[1]))

    def summary(self) -> dict[str, Any]:
        """The verdict with its probabilities, for summary.json."""
        sure = [label for label, p in self.probabilities.items() if p >= DEFAULT.named and not label.startswith(UNKNOWN_NAME)]
        unknown, closed = self.attribution.unknown, self.closed
        return {
            "verdict": f"{' + '.join(sure) or 'nothing'} named; unknown beside it with probability {unknown:.2f}",
            "probabilities": self.probabilities,
            "unknown": unknown,
            "periods_held_out": closed and {"before": closed.before, "after": closed.after, "floor": closed.floor},
        }


def diagnose_table3(windows: Windows) -> PerformanceDiagnosis:
    """Diagnose R Table 3: search, attribution, sizes and closure."""
    model = build_performance_model(windows)
    explanations = rank_explanations(model, DEFAULT.unlisted_share)
    members = list(explanations[0].members)
    fitted = tuple(fit(model, members)) if members else ()
    listed = [effect for effect in fitted if not effect.effect.startswith(UNKNOWN_NAME)]
    closed = compute_closure(model, members) if listed else None
    return PerformanceDiagnosis(rank_without_naming(model, explanations), fitted, closed)


def build_performance_model(windows: Windows) -> LinearModel:
    """Build the model of R Table 3 about the nominal."""
    rows = windows[NOMINAL]
    base, flight, relative = (
        _order_numbers(values)
        for values in (compute_simulated_numbers(rows), read_published_numbers(), estimate_relative_error(rows))
    )
    digits = np.array([LAST_DIGITS[parameter] for parameter, _, _ in WINDOW_NUMBERS]) / np.sqrt(12.0)
    sigma = np.sqrt((relative * base) ** 2 + (relative * flight) ** 2 + digits**2)
    groups = []
    for trial in TRIED_EFFECTS:
        flown = windows[trial.setting] if trial.setting else add_bias_walk(rows, trial)
        change = (_order_numbers(compute_simulated_numbers(flown)) - base) / sigma
        groups.append(_make_effect_candidate(trial, change[:, None]))
    owner = np.array([number[2] for number in WINDOW_NUMBERS])
    groups += _list_random_differences(owner)
    y = (flight - base) / sigma
    return build_model(y, np.eye(len(y)), groups, owner, PERIODS, "a period at a time", MOST_MISSION_EFFECTS)


def _make_effect_candidate(trial: TrialEffect, change: Array) -> CandidateColumns:
    """Make the candidate of an effect from the change (18, 1) of the numbers, in sigmas, that its trial size makes."""
    if trial.switch:
        switch_options: dict[str, Any] = {"read": lambda _: (trial.size, {}), "shifted": True, "scales": np.ones(1)}
        return make_candidate(trial.effect, trial.axis, change, trial.unit, trial.limits, **switch_options)
    # An effect's amplitude is its size, or the square of it.
    power = 2 if trial.squared else 1
    limits = (trial.limits[0] ** power, trial.limits[1] ** power)
    read = _read_square_root if trial.squared else read_first_amplitude
    return make_candidate(trial.effect, trial.axis, change / trial.size**power, trial.unit, limits, positive=True, read=read)


def _read_square_root(amplitudes: Array) -> tuple[float, Parameters]:
    """Return the size of an effect whose amplitude is the square of its size, and no further parameters."""
    return float(np.sqrt(max(amplitudes[0], 0.0))), {}


def add_bias_walk(rows: pd.DataFrame, trial: TrialEffect) -> pd.DataFrame:
    """Add a random walk of the gyro's bias to the nominal's windows; it changes only the batch's bias."""
    config = apply_mission_effects([f"{trial.effect}:{trial.axis}={trial.size}"])
    column = f"bias_{trial.axis}_deg_h"
    bias = [simulate_bias_walk(config, day, 1998)["xyz".index(str(trial.axis))] * DEG_H_PER_RAD_S for day in rows["day"]]
    return rows.assign(**{column: rows[column] + bias})


def _list_random_differences(owner: NDArray[np.str_]) -> list[CandidateColumns]:
    """List random differences, in sigmas: of all numbers, a period's, or one number."""
    identity = np.eye(len(owner))
    periods = [make_rival("a period", name, identity[:, owner == name], "sigma", UNKNOWN_LIMITS) for name in PERIODS]
    numbers = [
        make_rival("a number", name_number(number), identity[:, [k]], "sigma", UNKNOWN_LIMITS)
        for k, number in enumerate(WINDOW_NUMBERS)
    ]
    return [make_rival("all numbers", None, identity, "sigma", UNKNOWN_LIMITS), *periods, *numbers]


def name_number(number: Number) -> str:
    """Name a number of R Table 3 in words."""
    parameter, axis, period = number
    quantity = {"attitude_accuracy_deg": axis, "yaw_update_deg": "update", "gyro_bias_std_deg_h": f"b_{axis}"}[parameter]
    return f"{quantity} {period}"


def _order_numbers(values: Mapping[Number, float]) -> Array:
    """Order values (18,) as `WINDOW_NUMBERS`."""
    return np.array([values[number] for number in WINDOW_NUMBERS])


def build_size_table(diagnosis: PerformanceDiagnosis) -> pd.DataFrame:
    """Build the table of the sizes of the likeliest explanation's effects."""
    sizes = [
        {"cause": effect.label, "size": effect.size, "sigma": compute_size_sigma(effect), "unit": effect.unit}
        for effect in diagnosis.fitted
    ]
    return pd.DataFrame(sizes)


def compute_size_sigma(fitted: FittedEffect) -> float:
    """Compute the sigma of a size; σ_a/(2 √a) if the amplitude a is the square of the size."""
    is_squared = any(trial.squared and trial.effect == fitted.effect and not trial.switch for trial in TRIED_EFFECTS)
    return float(fitted.sigmas[0] / (2 * fitted.size)) if is_squared and fitted.size > 0 else fitted.sigma
