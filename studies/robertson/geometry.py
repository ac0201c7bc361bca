"""Where the sun sensors look, by R's own words, and what R's (c, d) say of it.

"The bore-sight orientations were chosen so as to maximize the time during which DSS data was available": the share of an orbit
with the Sun in view of both heads of one sensor and not behind the Earth, averaged over the sun angles of a year, as a function
of the boresights' tilt toward −Y and elevation toward zenith.

Head angles act through tan α: with e₃ taken out by M, at one α,

    c − 1 = e₁ tan α,    d = ± e₂ tan α                             (`gyrocal.sensors.head_compensation`, (ii))

so that each published number gives a |tan α|. As printed they do not agree with each other nor with the geometry; with zeros
slipped in or out, a number times a power of ten, DSS-1's do. The signs: tan α is positive for DSS-1 and negative for DSS-2, and
the printed c − 1 follow e₁ tan α in both. The printed d have the other sign than e₂ tan α in both, as if e₂ were counted the
other way round.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.sensors.head_compensation import HEAD_ANGLES, PUBLISHED_COMPENSATION
from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, MissionConfig, build_uploads, fit_crossing_compensation
from simulator.mission_mode.mounting import ELEVATION, PATH_STEP, compute_sun_path
from simulator.sensors.sun import SIMULATED_HALF_FOV, build_trmm_alignments
from studies.report.panels import DARK, RED, TEAL, Draw, Line, build_sheet, make_curves
from studies.robertson.printed_coefficients import SLIPS

Array = NDArray[np.float64]

YEAR_DAYS = 365.25
TILTS_DEG = (10.0, 20.0, 30.0, 40.0)
ELEVATIONS_DEG = (0.0, 10.0, 20.0, 25.0, 29.4, 33.0, 40.0)


def compute_sun_availability(tilt: float, elevation: float, angles: Array) -> Array:
    """Share of an orbit with data, at each sun angle (n,) rad; tilt toward −Y and elevation toward zenith, rad."""
    edge, alignments = np.tan(SIMULATED_HALF_FOV), build_trmm_alignments(tilt, -elevation)
    out = []
    for angle in np.rad2deg(angles):
        sun = compute_sun_path((float(angle),))
        seen = np.zeros(len(sun), dtype=bool)
        for N in alignments:
            s = sun @ N
            seen |= (s[:, 2] > 0) & (np.abs(s[:, :2]) <= edge * s[:, 2:]).all(axis=1)
        out.append(seen.sum() * PATH_STEP / 360.0)
    return np.array(out)


def build_availability_table() -> pd.DataFrame:
    """Mean share of the orbit over a year's sun angles, a row a tilt, a column an elevation."""
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
    """|tan α| that each published number of R (6) stands for, as printed and with the slip nearest to the geometry."""
    expected = np.tan(-ELEVATION)
    config = MissionConfig()
    tables = build_uploads(config)[0]
    alignments = build_trmm_alignments(*config.boresights)
    rows = []
    for k, name in enumerate(HEAD_ANGLES):
        computed = fit_crossing_compensation(config.sun_sensors[k], tables.misalignments[k], alignments[k])
        one = PUBLISHED_COMPENSATION[name]
        for what, value, e, own in (
            ("c - 1", one.c - 1, HEAD_ANGLES[name][0], computed[0] - 1),
            ("d", one.d, HEAD_ANGLES[name][1], computed[1]),
        ):
            slip, tangent = find_nearest_slip(value / e, expected)
            rows.append(
                {
                    "sensor": name,
                    "number": what,
                    "published_1e6": value * 1e6,
                    "computed_1e6": own * 1e6,
                    "tan_alpha_as_printed": value / e,
                    "slip": slip,
                    "tan_alpha": tangent,
                    "geometry": expected,
                }
            )
    return pd.DataFrame(rows)


def find_nearest_slip(ratio: float, expected: float) -> tuple[float, float]:
    """Power of ten of `SLIPS` that brings |ratio| nearest to the expected one, and the result."""
    values = [abs(ratio) * slip for slip in SLIPS]
    k = int(np.argmin([abs(np.log(value / expected)) for value in values]))
    return SLIPS[k], values[k]


def compute_chance_probability() -> dict[str, float]:
    """Probability that random digits do as well as the flight's, slips allowed: DSS-1's two numbers, and all four.

    A random number's logarithm is uniform within the decade that slips leave, ± ln 10/2 about the expected one, so that n
    independent ones are all within m of it with the probability (2 m/ln 10)ⁿ.
    """
    off = np.abs(np.log(compute_alpha_tangents()["tan_alpha"].to_numpy() / np.tan(-ELEVATION)))
    return {name: float((2 * off[:n].max() / np.log(10.0)) ** n) for name, n in (("dss_1", 2), ("all_four", 4))}


def draw_sensor_fields() -> Draw:
    """R Figure 6: the fields of view in the orbit plane's angles, the Sun's paths and the limb."""
    config = MissionConfig()
    edge = np.tan(SIMULATED_HALF_FOV)
    side = np.concatenate([np.linspace(-edge, edge, 40), np.full(40, edge), np.linspace(edge, -edge, 40), np.full(40, -edge)])
    up = np.roll(side, 40)
    lines = []
    for k, (N, colour) in enumerate(zip(build_trmm_alignments(*config.boresights), (RED, TEAL), strict=True)):
        body = np.stack([side, up, np.ones_like(side)], axis=-1) @ N.T
        x, y = compute_path_angles(body)
        lines.append(Line(np.append(x, x[0]), np.append(y, y[0]), f"field of DSS-{k + 1}", colour, "-"))
    for angle in (0.0, 10.0, 30.0, 58.4):
        x, y = compute_path_angles(compute_sun_path((angle,)))
        lines.append(Line(x, y, f"Sun, {angle:g}°", DARK, ":"))
    updates = np.array([[side * np.cos(a), -np.sin(a), 0.0] for side in (1, -1) for a in np.deg2rad([5.0, 20.0, 35.0, 50.0])])
    x, y = compute_path_angles(updates)
    lines.append(Line(x, y, "yaw updates", DARK, "o", size=4.0))
    panel = make_curves(lines, x="along the orbit from +X through zenith to −X (deg)", y="from the XZ plane toward −Y (deg)")
    return build_sheet(panel, size=(8.0, 4.4), columns=1, legend="outside lower center")


def compute_path_angles(body: Array) -> tuple[Array, Array]:
    """Angle from +X through zenith, and from the XZ plane toward −Y, of directions (n, 3); deg."""
    along = np.rad2deg(np.unwrap(np.arctan2(-body[:, 2], body[:, 0]) + np.deg2rad(60.0), period=2 * np.pi)) - 60.0
    along = (along + 60.0) % 360.0 - 60.0
    return along, np.rad2deg(np.arcsin(-body[:, 1] / np.linalg.norm(body, axis=1)))


def summarise_geometry(table: pd.DataFrame, numbers: pd.DataFrame) -> dict[str, Any]:
    """The best elevation, what it gains, and what (c, d) say."""
    by_tilt = table.set_index("tilt_deg").max(axis=1)
    own = table.set_index("tilt_deg").loc[20.0].to_dict()
    return {
        "elevation_deg": float(np.rad2deg(-ELEVATION)),
        "share_level": float(own["up_0_deg"]),
        "share_raised": float(own["up_29.4_deg"]),
        "share_best": float(by_tilt.max()),
        "best_tilt_deg": float(table["tilt_deg"][int(by_tilt.argmax())]),
        "tan_alpha": {
            f"{row['sensor']} {row['number']}": {"slip": row["slip"], "tan_alpha": row["tan_alpha"]}
            for row in numbers.to_dict("records")
        },
        "chance": compute_chance_probability(),
    }
