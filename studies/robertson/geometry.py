"""Orientation of the sun sensors by R's own words, and the orientation that R's (c, d) imply.

"The bore-sight orientations were chosen so as to maximize the time during which DSS data was available": the share of an orbit
with the Sun in view of both heads of one sensor and not behind the Earth, averaged over the sun angles of a year, as a function
of the boresights' tilt toward −Y and elevation toward zenith.

Head angles act through tan α: with e₃ taken out by M, at one α,

    c − 1 = e₁ tan α,    d = ± e₂ tan α                             (`gyrocal.sensors.head_compensation`, (ii))

so that each published number gives a |tan α|. As printed they agree neither with each other nor with the geometry. DSS-1's
agree if zeros slipped in or out, which multiplies a number by a power of ten. The signs: tan α is positive for DSS-1 and
negative for DSS-2, and the printed c − 1 follow e₁ tan α in both. The printed d have the opposite sign of e₂ tan α in both, as
if e₂ were counted the other way round.
"""

import numpy as np
import pandas as pd

from gyrocal.arrays import Array
from gyrocal.sensors.head_compensation import HEAD_ANGLES, PUBLISHED_COMPENSATION
from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, MissionConfig, build_uploads, fit_crossing_compensation
from simulator.mission_mode.mounting import ELEVATION, PATH_STEP, compute_sun_path
from simulator.sensors.sun import SIMULATED_HALF_FOV, build_trmm_alignments

YEAR_DAYS = 365.25
TILTS_DEG = (10.0, 20.0, 30.0, 40.0)
SLIPS = (1.0, 10.0, 100.0)  # powers of ten by which zeros may have slipped into a printed number
ELEVATIONS_DEG = (0.0, 10.0, 20.0, 25.0, 29.4, 33.0, 40.0)


def compute_sun_availability(tilt: float, elevation: float, angles: Array) -> Array:
    """Compute the share of an orbit with data at each sun angle (n,); tilt toward −Y, elevation to zenith; all rad."""
    edge, alignments = np.tan(SIMULATED_HALF_FOV), build_trmm_alignments(tilt, -elevation)
    out = []
    for angle in np.rad2deg(angles):
        sun = compute_sun_path((float(angle),))
        is_visible = np.zeros(len(sun), dtype=bool)
        for N in alignments:
            s = sun @ N
            is_visible |= (s[:, 2] > 0) & (np.abs(s[:, :2]) <= edge * s[:, 2:]).all(axis=1)
        out.append(is_visible.sum() * PATH_STEP / 360.0)
    return np.array(out)


def build_availability_table() -> pd.DataFrame:
    """Build the table of the mean share over a year's sun angles, a row a tilt, a column an elevation."""
    config = MissionConfig()
    angles = np.abs(compute_sun_angle(config.epoch, config.orbit, np.arange(0.0, YEAR_DAYS, 5.0) * DAY))
    rows = []
    for tilt in TILTS_DEG:
        row: dict[str, float] = {"tilt_deg": tilt}
        for up in ELEVATIONS_DEG:
            row[f"up_{up:g}_deg"] = float(compute_sun_availability(np.deg2rad(tilt), np.deg2rad(up), angles).mean())
        rows.append(row)
    return pd.DataFrame(rows)


def compute_alpha_tangents() -> pd.DataFrame:
    """Compute |tan α| from each published number of R (6), as printed and with the slip nearest to the geometry."""
    expected = np.tan(-ELEVATION)
    config = MissionConfig()
    tables = build_uploads(config)[0]
    alignments = build_trmm_alignments(*config.boresights)
    rows = []
    for k, name in enumerate(HEAD_ANGLES):
        computed = fit_crossing_compensation(config.sun_sensors[k], tables.misalignments[k], alignments[k])
        published = PUBLISHED_COMPENSATION[name]
        for number, value, head_angle, computed_value in (
            ("c - 1", published.c - 1, HEAD_ANGLES[name][0], computed[0] - 1),
            ("d", published.d, HEAD_ANGLES[name][1], computed[1]),
        ):
            slip, tangent = find_nearest_slip(value / head_angle, expected)
            rows.append(
                {
                    "sensor": name,
                    "number": number,
                    "published_1e6": value * 1e6,
                    "computed_1e6": computed_value * 1e6,
                    "tan_alpha_as_printed": value / head_angle,
                    "slip": slip,
                    "tan_alpha": tangent,
                    "geometry": expected,
                }
            )
    return pd.DataFrame(rows)


def find_nearest_slip(ratio: float, expected: float) -> tuple[float, float]:
    """Find the power of ten of `SLIPS` that brings |ratio| nearest to the expected value, and the product."""
    values = [abs(ratio) * slip for slip in SLIPS]
    k = int(np.argmin([abs(np.log(value / expected)) for value in values]))
    return SLIPS[k], values[k]


def summarise_availability(table: pd.DataFrame) -> dict[str, float]:
    """Return the share of the orbit with data with level and raised boresights, and the largest share."""
    by_elevation = table.set_index("tilt_deg").loc[20.0]  # degrees, the simulated tilt
    best = table.drop(columns="tilt_deg").to_numpy().max()
    shares = {"level": by_elevation["up_0_deg"], "raised": by_elevation["up_29.4_deg"], "best": best}
    return {"elevation_deg": float(np.rad2deg(-ELEVATION))} | {f"share_{name}": float(x) for name, x in shares.items()}
