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
from studies.robertson import flown, printed_coefficients
from studies.robertson.calendar import PERIODS
from studies.robertson.diagnosis import TRIALS, Beside, Diagnosis, Windows, linear_model
from studies.robertson.diagnosis import diagnose as diagnose_model
from studies.robertson.end_to_end import rotation
from studies.robertson.flown import AXES
from studies.robertson.further import BLOCKS, MANEUVER, R3, TABLE2
from studies.robertson.ladder import NOMINAL, RUNGS
from studies.robertson.slews import noise_free

Array = NDArray[np.float64]
Further = Mapping[tuple[str, ...], Mapping[str, float]]

DURATIONS_S = (600.0, 800.0, 1000.0, 1200.0)
COMPARED = tuple(BLOCKS)
SIGNS = ("yaw accuracy", "yaw update")
MOST_EFFECTS = 8  # Table 3's and those of the others


def observed() -> Array:
    """What R prints, in the order of `COMPARED`."""
    change = [flown.slew_error(axis, "precalibration") - flown.slew_error(axis, "postcalibration") for axis in AXES]
    turn = np.rad2deg(Rotation.from_matrix(rotation(R3_M)).as_rotvec())
    return np.array([*change, *turn])


@lru_cache(maxsize=1)
def unstated_spread() -> Array:
    """Sigma of R Table 2's change by what R leaves open, (3,) deg."""
    changes = [
        noise_free(MANEUVER, PERIODS[1], solved, one) - noise_free(MANEUVER, PERIODS[2], solved, one)
        for one, solved in product(DURATIONS_S, (True, False))
    ]
    return np.asarray(np.std(changes, axis=0, ddof=1))


def sigmas(nominal: Mapping[str, float]) -> Array:
    """1-sigma of flown minus simulated, in the order of `COMPARED`; the printed digits hardly matter."""
    orbits = np.sqrt(2.0) * np.array([nominal[f"scatter_m_{axis}_deg"] for axis in "xyz"])
    return np.concatenate([unstated_spread(), orbits])


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
    """Table 3's companions for the linear model: flown less nominal, sigmas, and what each trial changes."""
    sigma, base = sigmas(further[NOMINAL]), _array(further[NOMINAL])
    changes = {effects: (_array(values) - base) / sigma for effects, values in further.items()}
    return Beside(COMPARED, tuple(BLOCKS[name] for name in COMPARED), (observed() - base) / sigma, changes)


def _array(values: Mapping[str, float]) -> Array:
    return np.array([values[name] for name in COMPARED])


def diagnose(windows: Windows, further: Further) -> Diagnosis:
    """The diagnosis of Table 3 with R's other data: in the same model, or, signs and R (6), in each explanation's posterior."""
    model = linear_model(windows, beside(further), MOST_EFFECTS)
    return diagnose_model(model, further_odds(model, windows))


def further_odds(model: LinearModel, windows: Windows) -> list[float]:
    """By how much each candidate as it was flown changes ln P of both signs and of R (6), about the nominal."""
    by_label = {f"{one.effect}:{one.axis}" if one.axis else one.effect: one.setting for one in TRIALS if one.setting}

    def told(effects: tuple[str, ...]) -> float:
        return sign_evidence(windows[effects]) + printed_coefficients.evidence(effects)

    nominal = told(NOMINAL)
    return [told(by_label[one.label]) - nominal if one.label in by_label else 0.0 for one in model.candidates]


def probabilities_table(alone: Diagnosis, together: Diagnosis) -> pd.DataFrame:
    """Causes by their probability from Table 3 alone and with all data."""
    p, q = alone.probabilities, together.probabilities
    labels = [label for label in dict.fromkeys([*q, *p]) if max(p.get(label, 0.0), q.get(label, 0.0)) >= DEFAULT.group_share]
    return pd.DataFrame([{"cause": label, "table_3": p.get(label, np.nan), "all_data": q.get(label, 0.0)} for label in labels])


def rungs_table(windows: Windows, further: Further) -> pd.DataFrame:
    """R's other data on every rung of the ladder, on which no size was fitted: misses, and the signs' ratios."""
    published, sigma = observed(), sigmas(further[NOMINAL])
    likely = printed_coefficients.evidence(NOMINAL)
    rows: list[dict[str, Any]] = []
    for rung in RUNGS:
        miss = published - _array(further[rung.effects])
        row: dict[str, Any] = {"effect": rung.name}
        for block in (TABLE2, R3):
            own = [k for k, name in enumerate(COMPARED) if BLOCKS[name] == block]
            row[f"{block} rms deg"] = float(np.sqrt(np.mean(miss[own] ** 2)))
            row[f"{block} rms sigmas"] = float(np.sqrt(np.mean((miss[own] / sigma[own]) ** 2)))
        row["R (6) ln B"] = printed_coefficients.evidence(rung.effects) - likely
        for name, (ratio, error) in signs(windows[rung.effects]).items():
            row |= {f"{name}, −x over +x": float(np.exp(ratio)), f"{name}, sigmas": ratio / error}
        rows.append(row)
    return pd.DataFrame(rows)


def numbers_table(further: Further) -> pd.DataFrame:
    """Each number: R's, the nominal's and the last rung's, and sigma."""
    return pd.DataFrame(
        {
            "data": [BLOCKS[name] for name in COMPARED],
            "number": COMPARED,
            "R": observed(),
            "nominal": _array(further[NOMINAL]),
            "last": _array(further[RUNGS[-1].effects]),
            "sigma": sigmas(further[NOMINAL]),
        }
    )
