"""R Figures 6 to 13."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gyrocal.arrays import Array
from simulator.mission_mode.config import DAY, MissionConfig
from simulator.mission_mode.flight import build_flight_schedule
from simulator.mission_mode.mounting import compute_sun_path
from simulator.sensors.sun import SIMULATED_HALF_FOV, build_trmm_alignments
from studies.report.panels import DARK, RED, TEAL, Draw, Line, Panel, build_sheet, make_curves
from studies.robertson import published_tables
from studies.robertson.calendar import FIRST_DAYS, convert_to_mission_day
from studies.robertson.performance import GYRO_AXES, select_full_orbits
from studies.robertson.published_tables import ROTATION_NAMES
from studies.robertson.runs import Runs

YELLOW = "#f2c14e"
FORWARD_COLOURS = {"+x": RED, "-x": TEAL}
SHOWN_ORBITS = 4.0  # of the yaw runs, the last ones
MONTHS = ("1997-12-01", "1998-01-01", "1998-02-01", "1998-03-01", "1998-04-01", "1998-05-01")
STACKED: dict[str, Any] = {"columns": 1, "sharex": True, "legend": "outside upper right"}
MISSION_FIGURE_TITLES = {
    "figure6_geometry": "R Figure 6: fields of view of the sun sensors",
    "figure7_12_yaw": "R Figures 7 and 12: yaw on board and true through yaw updates",
    "figure8_spikes": "R Figure 8: position error while the Sun is in a quadrant's view",
    "figure9_accuracy": "R Figure 9: RMS of the on-board attitude's error",
    "figure10_yaw_update": "R Figure 10: size of the yaw updates",
    "figure11_bias": "R Figure 11: gyro bias found at ±1 RPO",
    "figure13_attitude": "R Figure 13: attitude over an orbit after calibration",
}


def draw_mission_figures(runs: Runs, daily: pd.DataFrame, updates: pd.DataFrame, days: float) -> dict[str, tuple[str, Draw]]:
    """Return titles and drawing functions of the figures, by file name."""
    drawings = (  # in the order of `MISSION_FIGURE_TITLES`
        draw_sensor_fields(),
        draw_yaw_figure(runs),
        draw_spike_figure(runs),
        draw_accuracy_figure(daily, days),
        draw_update_figure(updates, days),
        draw_bias_figure(daily, days),
        draw_attitude_figure(runs),
    )
    return {name: (title, draw) for (name, title), draw in zip(MISSION_FIGURE_TITLES.items(), drawings, strict=True)}


def draw_sensor_fields() -> Draw:
    """Draw R Figure 6: the fields of view in the orbit plane's angles, the Sun's paths and the limb."""
    config = MissionConfig()
    edge = np.tan(SIMULATED_HALF_FOV)
    edge_x = np.concatenate([np.linspace(-edge, edge, 40), np.full(40, edge), np.linspace(edge, -edge, 40), np.full(40, -edge)])
    edge_y = np.roll(edge_x, 40)  # a quarter of the square's outline later
    lines = []
    for k, (N, colour) in enumerate(zip(build_trmm_alignments(*config.boresights), (RED, TEAL), strict=True)):
        body = np.stack([edge_x, edge_y, np.ones_like(edge_x)], axis=-1) @ N.T
        x, y = compute_path_angles(body)
        lines.append(Line(np.append(x, x[0]), np.append(y, y[0]), f"field of DSS-{k + 1}", colour, "-"))
    for angle in (0.0, 10.0, 30.0, 58.4):
        x, y = compute_path_angles(compute_sun_path((angle,)))
        lines.append(Line(x, y, f"Sun, {angle:g}°", DARK, ":"))
    updates = np.array([[sign * np.cos(a), -np.sin(a), 0.0] for sign in (1, -1) for a in np.deg2rad([5.0, 20.0, 35.0, 50.0])])
    x, y = compute_path_angles(updates)
    lines.append(Line(x, y, "yaw updates", DARK, "o", size=4.0))
    panel = make_curves(lines, x="along the orbit from +X through zenith to −X (deg)", y="from the XZ plane toward −Y (deg)")
    return build_sheet(panel, size=(6.4, 4.4), columns=1, legend="outside lower center")


def compute_path_angles(body: Array) -> tuple[Array, Array]:
    """Compute the angles from +X through zenith, and from the XZ plane toward −Y, of directions (n, 3); deg."""
    # Angles along the orbit from -60 deg, so that the fields of view are not cut.
    along = np.rad2deg(np.unwrap(np.arctan2(-body[:, 2], body[:, 0]) + np.deg2rad(60.0), period=2 * np.pi)) - 60.0
    along = (along + 60.0) % 360.0 - 60.0
    return along, np.rad2deg(np.arcsin(-body[:, 1] / np.linalg.norm(body, axis=1)))


def draw_yaw_figure(runs: Runs) -> Draw:
    """Draw Figures 7 and 12: on-board and true yaw through several yaw updates, before any calibration and after all."""
    panels = []
    for period, title in {"precalibration": "before (R Figure 7)", "postcalibration": "after (R Figure 12)"}.items():
        rows, start = select_last_orbits(runs["yaw", period].telemetry)
        update_times = runs["yaw", period].updates["t_s"]
        at = ((update_times[update_times > start] - start) / 60).tolist()
        panels.append(
            make_curves(_build_error_lines(rows, "yaw", start), at=at, title=f"{title}; dotted: yaw updates", y="yaw (deg)")
        )
    return build_sheet(*_label_last_axis(panels), size=(6.4, 5.0), sharey=True, **STACKED)


def draw_spike_figure(runs: Runs) -> Draw:
    """Draw Figure 8: position error while the Sun passes an Earth sensor quadrant, S filter restarted wrongly and off."""
    panels = []
    for state, title in {"restarted": "S filter restarted from a wrong value", "off": "S filter off"}.items():
        rows = runs["spikes", state].telemetry
        error = make_curves(_build_error_lines(rows, "pitch", 0.0), title=title, y="error of pitch (deg)")
        panels.append(_mark_times(error, rows["t_s"] / 60, rows["quadrants"] < 4, "three quadrants, the Sun in the fourth"))
    return build_sheet(*_label_last_axis(panels), size=(6.4, 5.0), sharey=True, **STACKED)


def draw_attitude_figure(runs: Runs) -> Draw:
    """Draw Figure 13: attitude over an orbit after all calibrations."""
    rows, start = select_last_orbits(runs["yaw", "postcalibration"].telemetry, 1.0)
    panels = [make_curves(_build_error_lines(rows, axis, start), y=f"{axis} (deg)") for axis in ROTATION_NAMES]
    title = "attitude against the commanded one, one orbit"
    return build_sheet(*_label_last_axis(panels), size=(6.4, 4.6), sharey="all", title=title, **STACKED)


def draw_accuracy_figure(daily: pd.DataFrame, days: float) -> Draw:
    """Draw Figure 9: daily RMS of the on-board attitude's error, with the requirement's 1-sigma and R Table 3."""
    limit = published_tables.read_requirement("knowledge") / 3
    panels = []
    for axis in ROTATION_NAMES:
        line = Line(daily["day"], daily[f"rms_knowledge_{axis}_deg"], "simulated", DARK, ".-")
        panel = make_curves([line, Line([0, days], [limit, limit], "requirement, 1σ", RED, "--")], y=f"{axis}, RMS (deg)")
        panels.append(_add_calendar(panel, days, ("attitude_accuracy_deg", axis)))
    return build_sheet(*panels, size=(6.4, 5.4), title=CALENDAR_WORDS, **STACKED)


def draw_update_figure(updates: pd.DataFrame, days: float) -> Draw:
    """Draw Figure 10: size of every yaw update, with R Table 3's means."""
    parts = {forward: updates[updates["forward"] == forward] for forward in FORWARD_COLOURS}
    lines = [
        _build_orientation_line(rows["t_s"] / DAY, rows["update_deg"].abs(), forward, 3.0) for forward, rows in parts.items()
    ]
    panel = _add_calendar(make_curves(lines, y="size of yaw update (deg)"), days, ("yaw_update_deg", "yaw"))
    return build_sheet(panel, size=(6.4, 3.4), title=CALENDAR_WORDS, **STACKED)


def draw_bias_figure(daily: pd.DataFrame, days: float) -> Draw:
    """Draw Figure 11: daily means of the gyro bias as an attitude solution finds it."""
    parts = {forward: daily[daily["forward"] == forward] for forward in FORWARD_COLOURS}
    panels = []
    for axis, name in GYRO_AXES.items():
        lines = [
            _build_orientation_line(rows["day"], rows[f"apparent_bias_{name}_deg_h"], forward, 5.0)
            for forward, rows in parts.items()
        ]
        panels.append(_add_calendar(make_curves(lines, y=f"bias {axis} (deg/h)"), days))
    return build_sheet(*panels, size=(6.4, 5.4), title=CALENDAR_WORDS, **STACKED)


CALENDAR_WORDS = "dotted: yaw maneuvers; solid: uploads"


def select_last_orbits(telemetry: pd.DataFrame, orbits: float = SHOWN_ORBITS) -> tuple[pd.DataFrame, float]:
    """Select the telemetry of the last orbits, and return also its start, s."""
    start = float(telemetry["t_s"].iloc[-1]) - orbits * MissionConfig().orbit.period
    return telemetry[telemetry["t_s"] >= start], start


def average_by_day(orbits: pd.DataFrame, uploads: Sequence[float] = ()) -> pd.DataFrame:
    """Average an orbit table over each day and orientation, separately before and after each upload (s), in full orbits.

    The column day is the middle of the orbits' times, in days.
    """
    rows = select_full_orbits(orbits)
    numbers = [name for name in rows.columns if name.startswith(("rms_", "apparent_"))]
    tables = pd.Series(np.searchsorted(np.asarray(uploads, dtype=float), rows["t_s"]), index=rows.index, name="tables")
    day = np.floor(rows["t_s"] / DAY).astype(int).rename("of")
    means = rows.groupby([day, tables, "forward"], sort=True)[["t_s", *numbers]].mean().reset_index()
    means.insert(0, "day", means.pop("t_s") / DAY)
    return means.drop(columns=["of", "tables"]).sort_values("day", ignore_index=True)


def _build_error_lines(rows: pd.DataFrame, axis: str, start: float) -> list[Line]:
    """Build the lines of an angle on board and true, over minutes from the start."""
    minutes = (rows["t_s"] - start) / 60
    return [
        Line(minutes, rows[f"estimate_{axis}_deg"], "on board", TEAL, "-"),
        Line(minutes, rows[f"error_{axis}_deg"], "true", RED, "-"),
    ]


def _build_orientation_line(x: pd.Series, y: pd.Series, forward: str, size: float) -> Line:
    """Build the points of one direction of flight."""
    return Line(x, y, f"{forward.replace('-', '−')} forward", FORWARD_COLOURS[forward], ".", size=size)


def _label_last_axis(panels: list[Panel]) -> list[Panel]:
    """Label the last of several panels below one another with the time axis."""
    return [*panels[:-1], replace(panels[-1], x="minutes")]


def _mark_times(panel: Panel, minutes: pd.Series, where: pd.Series, label: str) -> Panel:
    """Shade the times of a panel at which a condition holds."""

    def draw(on: Axes) -> None:
        panel.draw(on)
        style: dict[str, Any] = {"transform": on.get_xaxis_transform(), "color": YELLOW, "alpha": 0.5, "linewidth": 0}
        on.fill_between(minutes, 0, 1, where=where.to_numpy(), label=label, zorder=0, **style)

    return replace(panel, draw=draw)


def _add_calendar(panel: Panel, days: float, published: tuple[str, str] | None = None) -> Panel:
    """Add yaw maneuvers, uploads, and R Table 3's means of a parameter and axis to a panel over days from launch."""
    config = MissionConfig()
    schedule = build_flight_schedule(config, days)

    def draw(on: Axes) -> None:
        panel.draw(on)
        for k, (period, moments) in enumerate(FIRST_DAYS.items() if published else ()):
            start, stop = (convert_to_mission_day(moment, config) for moment in moments)
            mean = published_tables.read_published_performance(*published, period) if published else np.nan
            on.hlines(mean, start, stop, color=YELLOW, linewidth=2, zorder=3, label="_" if k else "R Table 3")
        if published:
            on.set_ylim(0, None)
        for upload_s, _ in schedule.uploads:
            if upload_s < days * DAY:
                on.axvline(upload_s / DAY, color="0.3", linewidth=1)
        ticks = [convert_to_mission_day(f"{month}T00:00:00+00:00", config) for month in MONTHS]
        on.set_xticks(ticks, [f"{pd.Timestamp(month):%b 1 %Y}" for month in MONTHS])
        on.set_xlim(0, days)
        on.grid(axis="x", visible=False)

    return replace(panel, draw=draw, at=[maneuver.start_s / DAY for maneuver in schedule.maneuvers])
