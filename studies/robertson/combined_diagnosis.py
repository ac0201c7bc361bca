"""R's data beside Table 3 in the linear model of its diagnosis: Table 2, R (3), R (6), and the two orientation signs.

Table 2
    Before minus after calibration, in which the noise of the one flown maneuver cancels: three numbers, of the maneuver from
    +x to −x, which fits R better. An effect acts on it through the yaw bias that is solved for on board. Their sigma is the
    spread over what R does not say: the maneuver's duration, 600 to 1200 s, and whether the bias of yaw is the published one
    of before launch or the one solved for on board.
R (3)
    The rotation vector of DSS-2's misalignment, as R's first algorithm finds it of flown telemetry of the early orbits. The
    spacecraft's mounting was solved for so that a fit of the Sun's path finds R (3): these three numbers tell effects apart by
    what they add, and are no test of the mounting. Sigma: the scatter between the early orbits, once here and once in flight.
Signs
    "Before uplink of these coefficients the yaw attitude was more accurate, and the yaw updates smaller, in the +X forward
    configuration." A set of effects gives each sign a probability, Φ of the mean logarithm of −x over +x in sigmas of the
    windows' scatter.
R (6)
    As printed it may have lost zeros, and how well it can be computed depends on how the sensors sit: a density of its own,
    `studies.robertson.printed_coefficients`. Signs and R (6) are weighed with the candidates that turn them round or move them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import log_ndtr

from diagnosis.model.linear import LinearModel
from diagnosis.settings import DEFAULT
from simulator.mission_mode.mounting import R3_M
from studies.robertson import printed_coefficients, published_tables
from studies.robertson.calendar import PERIODS
from studies.robertson.diagnosis import (
    TRIED_EFFECTS,
    FurtherObservations,
    PerformanceDiagnosis,
    Windows,
    build_performance_model,
)
from studies.robertson.diagnosis import diagnose as diagnose_model
from studies.robertson.end_to_end import find_nearest_rotation
from studies.robertson.further_data import MANEUVER, NUMBER_SOURCES, R3, TABLE2
from studies.robertson.ladder import NOMINAL, RUNGS
from studies.robertson.published_tables import ROTATION_NAMES
from studies.robertson.slews import compute_noise_free_miss

Array = NDArray[np.float64]
Further = Mapping[tuple[str, ...], Mapping[str, float]]

DURATIONS_S = (600.0, 800.0, 1000.0, 1200.0)
COMPARED = tuple(NUMBER_SOURCES)
SIGNS = ("yaw accuracy", "yaw update")
MOST_JOINT_EFFECTS = 8  # Table 3's and those of the others


def read_further_observations() -> Array:
    """Read the printed values of R, in the order of `COMPARED`."""
    change = [
        published_tables.read_published_slew_error(axis, "precalibration")
        - published_tables.read_published_slew_error(axis, "postcalibration")
        for axis in ROTATION_NAMES
    ]
    turn = np.rad2deg(Rotation.from_matrix(find_nearest_rotation(R3_M)).as_rotvec())
    return np.array([*change, *turn])


@lru_cache(maxsize=1)
def estimate_unstated_sigma() -> Array:
    """Sigma of R Table 2's change by what R leaves open, (3,) deg."""
    changes = [
        compute_noise_free_miss(MANEUVER, PERIODS[1], solved, one) - compute_noise_free_miss(MANEUVER, PERIODS[2], solved, one)
        for one, solved in product(DURATIONS_S, (True, False))
    ]
    return np.asarray(np.std(changes, axis=0, ddof=1))


def compute_observation_sigmas(nominal: Mapping[str, float]) -> Array:
    """1-sigma of flown minus simulated, in the order of `COMPARED`; the printed digits hardly matter."""
    orbits = np.sqrt(2.0) * np.array([nominal[f"scatter_m_{axis}_deg"] for axis in "xyz"])
    return np.concatenate([estimate_unstated_sigma(), orbits])


def compare_orientation_signs(rows: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """ln(−x over +x) of yaw accuracy and update with the alignment, and its sigma, from a set's windows."""
    own = rows[rows["period"] == PERIODS[1]]
    out = {}
    for name, column in zip(SIGNS, ("onboard_minus_ground_yaw_deg", "yaw_update_deg"), strict=True):
        plus, minus = (own.loc[own["forward"] == forward, column] for forward in ("+x", "-x"))
        variance = sum(one.var() / len(one) / one.mean() ** 2 for one in (plus, minus))
        out[name] = float(np.log(minus.mean() / plus.mean())), float(np.sqrt(variance))
    return out


def compute_sign_evidence(rows: pd.DataFrame) -> float:
    """ln of the probability that both signs are R's."""
    return float(sum(log_ndtr(ratio / sigma) for ratio, sigma in compare_orientation_signs(rows).values()))


def build_further_observations(further: Further) -> FurtherObservations:
    """Table 3's companions for the linear model: flown less nominal, sigmas, and what each trial changes."""
    sigma, base = compute_observation_sigmas(further[NOMINAL]), _order_observations(further[NOMINAL])
    changes = {effects: (_order_observations(values) - base) / sigma for effects, values in further.items()}
    return FurtherObservations(
        COMPARED, tuple(NUMBER_SOURCES[name] for name in COMPARED), (read_further_observations() - base) / sigma, changes
    )


def _order_observations(values: Mapping[str, float]) -> Array:
    return np.array([values[name] for name in COMPARED])


def diagnose_all_data(windows: Windows, further: Further) -> PerformanceDiagnosis:
    """The diagnosis of Table 3 with R's other data: in the same model, or, signs and R (6), in each explanation's posterior."""
    model = build_performance_model(windows, build_further_observations(further), MOST_JOINT_EFFECTS)
    return diagnose_model(model, compute_further_odds(model, windows))


def compute_further_odds(model: LinearModel, windows: Windows) -> list[float]:
    """Compute the change of ln P of both signs and of R (6) by each candidate as it was flown, about the nominal."""
    by_label = {f"{one.effect}:{one.axis}" if one.axis else one.effect: one.setting for one in TRIED_EFFECTS if one.setting}

    def sum_log_evidence(effects: tuple[str, ...]) -> float:
        return compute_sign_evidence(windows[effects]) + printed_coefficients.compute_coefficient_evidence(effects)

    nominal = sum_log_evidence(NOMINAL)
    return [sum_log_evidence(by_label[one.label]) - nominal if one.label in by_label else 0.0 for one in model.candidates]


def compare_cause_probabilities(alone: PerformanceDiagnosis, together: PerformanceDiagnosis) -> pd.DataFrame:
    """Causes by their probability from Table 3 alone and with all data."""
    p, q = alone.probabilities, together.probabilities
    labels = [label for label in dict.fromkeys([*q, *p]) if max(p.get(label, 0.0), q.get(label, 0.0)) >= DEFAULT.group_share]
    return pd.DataFrame([{"cause": label, "table_3": p.get(label, np.nan), "all_data": q.get(label, 0.0)} for label in labels])


def build_rungs_table(windows: Windows, further: Further) -> pd.DataFrame:
    """R's other data on every rung of the ladder, on which no size was fitted: misses, and the signs' ratios."""
    published, sigma = read_further_observations(), compute_observation_sigmas(further[NOMINAL])
    likely = printed_coefficients.compute_coefficient_evidence(NOMINAL)
    rows: list[dict[str, Any]] = []
    for rung in RUNGS:
        miss = published - _order_observations(further[rung.effects])
        row: dict[str, Any] = {"effect": rung.name}
        for block in (TABLE2, R3):
            own = [k for k, name in enumerate(COMPARED) if NUMBER_SOURCES[name] == block]
            row[f"{block} rms deg"] = float(np.sqrt(np.mean(miss[own] ** 2)))
            row[f"{block} rms sigmas"] = float(np.sqrt(np.mean((miss[own] / sigma[own]) ** 2)))
        row["R (6) ln B"] = printed_coefficients.compute_coefficient_evidence(rung.effects) - likely
        for name, (ratio, error) in compare_orientation_signs(windows[rung.effects]).items():
            row |= {f"{name}, −x over +x": float(np.exp(ratio)), f"{name}, sigmas": ratio / error}
        rows.append(row)
    return pd.DataFrame(rows)


def build_observations_table(further: Further) -> pd.DataFrame:
    """Each number: R's, the nominal's and the last rung's, and sigma."""
    return pd.DataFrame(
        {
            "data": [NUMBER_SOURCES[name] for name in COMPARED],
            "number": COMPARED,
            "R": read_further_observations(),
            "nominal": _order_observations(further[NOMINAL]),
            "last": _order_observations(further[RUNGS[-1].effects]),
            "sigma": compute_observation_sigmas(further[NOMINAL]),
        }
    )
