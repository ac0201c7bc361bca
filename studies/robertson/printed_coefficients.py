"""How likely R (6) makes sensors that sit in some way: c and d as printed, with zeros slipped, or something else.

The four numbers c − 1 and d are computed for the sensors as they sit, in three ways: over all sun angles, over those of −x
forward, and in the closed form at one α. The first is what is expected, x; their spread, with the rounding, is its sigma σ,
and belongs to the mounting: level sensors have next to nothing to compensate, in any way. A printed number p has the density

    Σ_s w_s s N(s p; x, σ)  +  w_u /(2 |p| ln D)

over s = 1, 10 and 100, the zeros that slipped in, and anything of either sign within the decades D. The shares w are chosen
and stand on nothing but that most numbers are printed as they are; one in five is left for what is not thought of.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import norm

from gyrocal.sensors.head_compensation import HEAD_ANGLES, PUBLISHED_COMPENSATION, compute_compensation
from simulator.mission_mode.config import MissionConfig, build_uploads, fit_crossing_compensation
from simulator.sensors.sun import build_trmm_alignments
from studies.robertson.windows import apply_mission_effects

Array = NDArray[np.float64]

COEFFICIENT_NAMES = tuple(f"{number} of {sensor}" for sensor in PUBLISHED_COMPENSATION for number in ("c - 1", "d"))
SLIPS = (1.0, 10.0, 100.0)
SLIP_PROBABILITIES = (0.6, 0.1, 0.1)
ELSE = 0.2
DECADES = 1e4
ALL_ANGLES_DEG = (0.0, 58.4)
LATE_ANGLES_DEG = (15.0, 58.4)  # of −x forward between the uploads
ROUNDING_SIGMA = 1 / np.sqrt(12.0)  # 1e-6


def read_printed_coefficients() -> Array:
    """c − 1 and d of both sensors, (4,) 1e-6."""
    return 1e6 * np.array([value for one in PUBLISHED_COMPENSATION.values() for value in (one.c - 1, one.d)])


def compute_coefficients(config: MissionConfig, angles_deg: tuple[float, float] = ALL_ANGLES_DEG) -> Array:
    """c − 1 and d of DSS-1 and DSS-2, (4,) 1e-6, for the sensors as they sit; angles as of `fit_crossing_compensation`."""
    tables, nominal = build_uploads(config)[0], build_trmm_alignments(*config.boresights)
    parts = zip(config.sun_sensors, tables.misalignments, nominal, strict=True)
    pairs = [fit_crossing_compensation(*one, tables.coefficients_beta[k], angles_deg) for k, one in enumerate(parts)]
    return 1e6 * np.array([value for c, d in pairs for value in (c - 1, d)])


def predict_coefficients(config: MissionConfig) -> tuple[Array, Array]:
    """Predict R (6) for the sensors as mounted, and its sigma; (4,) 1e-6 each."""
    tangent = -config.boresights[1]
    closed = [
        compute_compensation(HEAD_ANGLES[name], sign * tangent)
        for name, sign in zip(PUBLISHED_COMPENSATION, (1.0, -1.0), strict=True)
    ]
    ways = [
        compute_coefficients(config),
        compute_coefficients(config, LATE_ANGLES_DEG),
        1e6 * np.array([value for one in closed for value in (one.c - 1, one.d)]),
    ]
    return ways[0], np.hypot(np.std(ways, axis=0, ddof=1), ROUNDING_SIGMA)


def compute_log_densities(config: MissionConfig) -> Array:
    """(4, 4) ln of each term of the density: of a number, by its slip and, last, of anything else."""
    p, (x, sigma) = read_printed_coefficients(), predict_coefficients(config)
    slipped = [np.log(share * s) + norm.logpdf(s * p, x, sigma) for s, share in zip(SLIPS, SLIP_PROBABILITIES, strict=True)]
    return np.column_stack([*slipped, np.log(ELSE / (2 * np.abs(p) * np.log(DECADES)))])


def compute_coefficient_evidence(effects: Sequence[str]) -> float:
    """ln of the density of R (6) under a set of effects."""
    return float(logsumexp(compute_log_densities(apply_mission_effects(effects)), axis=1).sum())


def build_reading_table(effects: Sequence[str]) -> pd.DataFrame:
    """Each number as printed and computed, and how probably it is as printed, has lost zeros, or is something else."""
    config = apply_mission_effects(effects)
    parts, (x, sigma) = compute_log_densities(config), predict_coefficients(config)
    shares = np.exp(parts - logsumexp(parts, axis=1, keepdims=True))
    rows = {"number": COEFFICIENT_NAMES, "printed_1e6": read_printed_coefficients(), "computed_1e6": x, "sigma_1e6": sigma}
    names = ("as_printed", "one_zero", "two_zeros", "something_else")
    return pd.DataFrame(rows | dict(zip(names, shares.T, strict=True)))
