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
R (6)
    c − 1 and d of both sensors, computed for the sensors as they sit. Sigma: the spread between three ways of computing them
    for the nominal spacecraft, over all sun angles, over those of −x forward, and the closed form at one α. As printed they
    may have lost zeros: powers of ten are candidates of their own.
Signs
    "Before uplink of these coefficients the yaw attitude was more accurate, and the yaw updates smaller, in the +X forward
    configuration." A set of effects gives each sign a probability, Φ of the mean logarithm of −x over +x in sigmas of the
    windows' scatter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import log_ndtr

from diagnosis.inference.search import Search
from diagnosis.model.candidates import Group
from diagnosis.model.linear import LinearModel
from diagnosis.settings import DEFAULT
from gyrocal.sensors.head_compensation import HEADS, PUBLISHED, at_alpha
from simulator.mission_mode.config import MissionConfig
from simulator.mission_mode.mounting import ELEVATION, R3_M
from studies.robertson import flown
from studies.robertson.calendar import PERIODS
from studies.robertson.diagnosis import (
    NOTHING,
    TRIALS,
    UNKNOWN,
    UNKNOWN_LIMITS,
    Beside,
    Diagnosis,
    Windows,
    concluded,
    linear_model,
)
from studies.robertson.end_to_end import rotation
from studies.robertson.further import BLOCKS, MANEUVER, NAMES, R3, R6, TABLE2, coefficients
from studies.robertson.ground import AXES
from studies.robertson.ladder import NOMINAL, RUNGS
from studies.robertson.slews import noise_free

Array = NDArray[np.float64]
Further = Mapping[tuple[str, ...], Mapping[str, float]]

DURATIONS_S = (600.0, 800.0, 1000.0, 1200.0)
SLIPS = (10.0, 100.0)
SIGNS = ("yaw accuracy", "yaw update")
MOST_EFFECTS = 8  # Table 3's and those of the others


def observed() -> Array:
    """What R prints, in the order of `NAMES`."""
    change = [flown.slew_error(axis, "precalibration") - flown.slew_error(axis, "postcalibration") for axis in AXES]
    turn = np.rad2deg(Rotation.from_matrix(rotation(R3_M)).as_rotvec())
    printed = [1e6 * value for one in PUBLISHED.values() for value in (one.c - 1, one.d)]
    return np.array([*change, *turn, *printed])


@lru_cache(maxsize=1)
def method_spread() -> tuple[Array, Array]:
    """Sigmas of R Table 2's change by what R leaves open, (3,) deg, and of (c, d) by how they are computed, (4,) 1e-6."""
    changes = [
        noise_free(MANEUVER, PERIODS[1], solved, one) - noise_free(MANEUVER, PERIODS[2], solved, one)
        for one, solved in product(DURATIONS_S, (True, False))
    ]
    alpha = {"DSS-1": -ELEVATION, "DSS-2": ELEVATION}
    closed = [at_alpha(HEADS[name], angle) for name, angle in alpha.items()]
    ways = [
        coefficients(MissionConfig()),
        coefficients(MissionConfig(), (15.0, 58.4)),
        1e6 * np.array([value for one in closed for value in (one.c - 1, one.d)]),
    ]
    return np.std(changes, axis=0, ddof=1), np.std(ways, axis=0, ddof=1)


def sigmas(nominal: Mapping[str, float]) -> Array:
    """1-sigma of flown minus simulated, in the order of `NAMES`; the printed digits hardly matter."""
    duration, method = method_spread()
    orbits = np.sqrt(2.0) * np.array([nominal[f"scatter_m_{axis}_deg"] for axis in "xyz"])
    return np.concatenate([duration, orbits, np.hypot(method, 1 / np.sqrt(12.0))])


def signs(rows: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """ln(−x over +x) of yaw accuracy and update with the alignment, and its sigma, from a set's windows."""
    own = rows[rows["period"] == PERIODS[1]]
    out = {}
    for name, column in zip(SIGNS, ("onboard_minus_ground_yaw_deg", "yaw_update_deg"), strict=True):
        plus, minus = (own.loc[own["forward"] == forward, column] for forward in ("+x", "-x"))
        variance = sum(one.var() / len(one) / one.mean() ** 2 for one in (plus, minus))
        out[name] = float(np.log(minus.mean() / plus.mean())), float(np.sqrt(variance))
    return out


def sign_evidence(rows: pd.DataFrame) -> float:
    """ln of the probability that both signs are R's."""
    return float(sum(log_ndtr(ratio / sigma) for ratio, sigma in signs(rows).values()))


def beside(further: Further) -> Beside:
    """Table 3's companions for the linear model: flown less nominal, sigmas, what each trial changes, slips and rivals."""
    nominal = further[NOMINAL]
    base, sigma = np.array([nominal[name] for name in NAMES]), sigmas(nominal)
    changes = {effects: (np.array([values[name] for name in NAMES]) - base) / sigma for effects, values in further.items()}
    return Beside(NAMES, tuple(BLOCKS[name] for name in NAMES), (observed() - base) / sigma, changes, tuple(_groups(sigma)))


def _groups(sigma: Array) -> list[Group]:
    """Zeros slipped in each number of R (6), and differences of any size in a block or a number."""
    each, printed = np.eye(len(NAMES)), observed() / sigma
    out = []
    for k, name in enumerate(NAMES):
        if BLOCKS[name] == R6:
            # Printed is the number over its slip: what is printed lies so far from the number.
            columns = [((1.0 - slip) * printed[k] * each[:, k])[:, None] for slip in SLIPS]
            out.append(_slip(name, columns))
    for block in (TABLE2, R3, R6):
        own = each[:, [k for k, name in enumerate(NAMES) if BLOCKS[name] == block]]
        out.append(_rival(f"{UNKNOWN} in data beside", block, own))
    return [*out, *(_rival(f"{UNKNOWN} in a number beside", name, each[:, [k]]) for k, name in enumerate(NAMES))]


def _slip(name: str, columns: list[Array]) -> Group:
    return Group(
        "slipped zeros",
        name,
        True,
        columns,
        [{"slip": slip} for slip in SLIPS],
        np.full(len(SLIPS), 1 / len(SLIPS)),
        (0.0, 1.0),
        "",
        shifted=True,
        scales=np.ones(1),
        read=lambda _: (1.0, {}),
    )


def _rival(effect: str, axis: str, columns: Array) -> Group:
    return Group(effect, axis, False, [columns], [{}], np.ones(1), UNKNOWN_LIMITS, "sigma", process=True)


def diagnose(windows: Windows, further: Further) -> Diagnosis:
    """The diagnosis of Table 3 with R's other data in the same model, and the signs in each explanation's posterior."""
    model, sigma = linear_model(windows, beside(further), MOST_EFFECTS)
    told = sign_odds(model, windows)
    found = [
        replace(one, log_posterior=one.log_posterior + sum(told[member.candidate] for member in one.members))
        for one in [*Search(model).explanations(), NOTHING]
    ]
    return concluded(model, sigma, sorted(found, key=lambda one: -one.log_posterior))


def sign_odds(model: LinearModel, windows: Windows) -> list[float]:
    """By how much each candidate's windows change ln P of both signs, about the nominal's."""
    by_label = {f"{one.effect}:{one.axis}" if one.axis else one.effect: one.setting for one in TRIALS if one.setting}
    nominal = sign_evidence(windows[NOMINAL])
    return [sign_evidence(windows[by_label[one.label]]) - nominal if one.label in by_label else 0.0 for one in model.candidates]


def probabilities_table(alone: Diagnosis, together: Diagnosis) -> pd.DataFrame:
    """Causes by their probability from Table 3 alone and with all data."""
    p, q = alone.probabilities, together.probabilities
    labels = [label for label in dict.fromkeys([*q, *p]) if max(p.get(label, 0.0), q.get(label, 0.0)) >= DEFAULT.group_share]
    return pd.DataFrame([{"cause": label, "table_3": p.get(label, np.nan), "all_data": q.get(label, 0.0)} for label in labels])


def rungs_table(windows: Windows, further: Further) -> pd.DataFrame:
    """R's other data on every rung of the ladder, on which no size was fitted: misses, and the signs' ratios."""
    printed, sigma = observed(), sigmas(further[NOMINAL])
    rows: list[dict[str, Any]] = []
    for rung in RUNGS:
        miss = printed - np.array([further[rung.effects][name] for name in NAMES])
        row: dict[str, Any] = {"effect": rung.name}
        for block, unit in ((TABLE2, "deg"), (R3, "deg"), (R6, "1e6")):
            own = [k for k, name in enumerate(NAMES) if BLOCKS[name] == block]
            row[f"{block} rms {unit}"] = float(np.sqrt(np.mean(miss[own] ** 2)))
            row[f"{block} rms sigmas"] = float(np.sqrt(np.mean((miss[own] / sigma[own]) ** 2)))
        for name, (ratio, error) in signs(windows[rung.effects]).items():
            row |= {f"{name}, −x over +x": float(np.exp(ratio)), f"{name}, sigmas": ratio / error}
        rows.append(row)
    return pd.DataFrame(rows)


def numbers_table(further: Further) -> pd.DataFrame:
    """Each number: R's, the nominal's and the last rung's, and sigma."""
    sigma = sigmas(further[NOMINAL])
    return pd.DataFrame(
        {
            "data": [BLOCKS[name] for name in NAMES],
            "number": NAMES,
            "R": observed(),
            "nominal": [further[NOMINAL][name] for name in NAMES],
            "last": [further[RUNGS[-1].effects][name] for name in NAMES],
            "sigma": sigma,
        }
    )
