"""The command ``gyrocal mission``: simulate the Mission Mode loop and write its tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from gyrocal.errors import InputError
from studies.cli.options import FOLDER_TYPE, STDOUT, add_json_option, add_seed_option
from studies.montecarlo.files import format_json, write_json, write_parquet
from studies.report.console import make_console, show_progress

if TYPE_CHECKING:
    import pandas as pd

    from simulator.mission_mode.config import MissionConfig
    from simulator.mission_mode.effects import MissionSetting
    from simulator.mission_mode.flight import MissionRun
    from simulator.mission_mode.mounting import Mounting

# The next three as of simulator.mission_mode and studies.robertson.
MOUNTING_NAMES = ("solved", "heads")
PERIODS = ("precalibration", "calibration1", "postcalibration")
EFFECT_NAMES = (
    *("boresight_elevation", "printed_coefficients", "late_filter_upload", "dss_transfer", "horizon_noise"),
    *("horizon_season", "gyro_walk", "bias_gain", "cross_track"),
)
DAY = 86400.0  # s
TABLES = ("telemetry", "updates", "slews", "orbits")
LONGEST_MISSION_DAYS = 1000.0
MOST_TELEMETRY_ROWS = 20_000_000  # of telemetry, 2 GB


@click.command("mission")
@click.argument("out", type=FOLDER_TYPE)
@click.option("--days", type=float, required=True, help="Simulated days from launch, November 27, 1997.")
@add_seed_option("Seed of the noise.")
@click.option(
    "--tables",
    type=click.Choice(["flight", *PERIODS]),
    default="flight",
    show_default=True,
    help="Tables on board: uploaded on the days of the flight, or those of one of R's periods throughout.",
)
@click.option(
    "--mounting",
    type=click.Choice(MOUNTING_NAMES),
    default="solved",
    show_default=True,
    help="How the sun sensors are mounted, which is not published; see docs/mission.md.",
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME[:AXIS]=SIZE[,PARAMETER=VALUE…]",
    help=f"Deviation from the nominal model; repeatable. There are {', '.join(EFFECT_NAMES)}; see docs/mission.md.",
)
@click.option("--every", "every_s", type=float, default=60.0, show_default=True, help="Interval between rows of telemetry, s.")
@add_json_option("the summary", stdout="the tables")
@click.option("--force", is_flag=True, help="Replace tables that are in OUT already.")
def command(
    out: Path,
    days: float,
    seed: int,
    tables: str,
    mounting: Mounting,
    effects: tuple[str, ...],
    every_s: float,
    as_json: Path | None,
    force: bool,
) -> None:
    """Simulate TRMM's Mission Mode from launch and write telemetry, yaw updates, slews and orbits as Parquet to the folder OUT.

    It turns by 180° whenever the Sun crosses the orbit plane, as the flight did. A day takes about half a
    second, the first run twenty more for compilation.

    \b
    Examples:
      gyrocal mission /tmp/mission --days 30
      gyrocal mission /tmp/day --days 1 --tables postcalibration --every 10 --json /tmp/day.json
      gyrocal mission /tmp/gap --days 30 --effect horizon_noise=0.03,tau_s=250 --effect gyro_walk:y=0.01
    """
    from simulator.mission_mode.effects import parse
    from simulator.mission_mode.flight import simulate_mission

    every = _count_cycles(days, every_s)
    settings = [parse(text) for text in effects]
    if not force and any((out / f"{name}.parquet").exists() for name in TABLES):
        raise InputError(f"{out}: tables of a run are there already; choose another folder, or replace them with --force")
    out.mkdir(parents=True, exist_ok=True)
    config = _build_config(days, tables, mounting, settings)
    with show_progress("mission, simulated days", math.ceil(days) - 1, quiet=days <= 1) as advance:
        run = simulate_mission(config, days=days, seed=seed, telemetry_every=every, progress=advance)
    for name in TABLES:
        write_parquet(out / f"{name}.parquet", getattr(run, name))
    stretches = summarise_periods(run, config, days)
    document: dict[str, Any] = {"days": days, "seed": seed, "tables": tables, "mounting": mounting, "effects": list(effects)}
    document |= {"stretches": stretches.to_dict("records"), "slews": run.slews.to_dict("records")}
    if as_json == STDOUT:
        click.echo(format_json(document))
        return
    _show(run, stretches, out)
    if as_json:
        write_json(as_json, document)


def _count_cycles(days: float, every_s: float) -> int:
    """Count the cycles between two rows of telemetry; `InputError` for times that cannot be simulated."""
    from simulator.mission_mode.config import MissionConfig

    cycle = MissionConfig().controller.cycle_s
    if not cycle / DAY <= days <= LONGEST_MISSION_DAYS:
        raise InputError(f"--days {days:g}: must be between one cycle, {cycle:g} s, and {LONGEST_MISSION_DAYS:g} days")
    if not math.isfinite(every_s / cycle) or every_s < cycle or abs(every_s / cycle - round(every_s / cycle)) > 1e-9:
        raise InputError(f"--every {every_s:g}: must be a multiple of the cycle, {cycle:g} s")
    if days * DAY / every_s > MOST_TELEMETRY_ROWS:
        raise InputError(f"--every {every_s:g}: {days * DAY / every_s:.0f} rows of telemetry are too many")
    return round(every_s / cycle)


def _build_config(days: float, tables: str, mounting: Mounting, settings: Sequence[MissionSetting]) -> MissionConfig:
    """Build the configuration of a mission with effects, and with the flight's uploads or the tables of one period."""
    from simulator.mission_mode.config import MissionConfig, build_period_tables
    from simulator.mission_mode.effects import apply_mission_settings
    from simulator.mission_mode.flight import build_flight_schedule
    from simulator.mission_mode.mounting import build_mounted_sensors

    base = apply_mission_settings(
        replace(MissionConfig(), mounting=mounting, sun_sensors=build_mounted_sensors(mounting)), settings
    )
    schedule = build_flight_schedule(base, days)
    if tables == "flight":
        return schedule
    return replace(schedule, uploads=(), tables=build_period_tables(base)[tables])


def summarise_periods(run: MissionRun, config: MissionConfig, days: float) -> pd.DataFrame:
    """Build a row for each period between uploads: yaw updates, knowledge, pointing (3σ) and stability by axis, deg."""
    import pandas as pd

    from simulator.mission_mode.flight import ROTATION_NAMES

    end = days * DAY
    bounds = [0.0, *(upload_s for upload_s, _ in config.uploads if upload_s < end), end]
    rows = []
    for start, stop in pairwise(bounds):
        orbits = run.orbits[run.orbits["t_s"].between(start, stop, inclusive="left") & (run.orbits["samples"] > 0)]
        updates = run.updates.loc[run.updates["t_s"].between(start, stop, inclusive="left"), "update_deg"].abs()
        row: dict[str, Any] = {
            "from_day": start / DAY,
            "to_day": stop / DAY,
            "yaw_updates": len(updates),
            "yaw_update_deg": float(updates.mean()),
        }
        for axis in ROTATION_NAMES:
            for name, column in (("knowledge", "rms_knowledge"), ("pointing", "rms_error")):
                mean_square = (orbits[f"{column}_{axis}_deg"] ** 2 * orbits["samples"]).sum() / orbits["samples"].sum()
                row[f"{name}_{axis}_deg"] = 3 * float(np.sqrt(mean_square))
            row[f"stability_{axis}_deg"] = float(orbits[f"jitter_{axis}_deg"].max())
        rows.append(row)
    return pd.DataFrame(rows)


def _show(run: MissionRun, stretches: pd.DataFrame, out: Path) -> None:
    """Print the periods against R's limits, the yaw maneuvers, and the numbers of written rows."""
    import pandas as pd

    from simulator.mission_mode.flight import ROTATION_NAMES
    from studies.report import tables as render
    from studies.robertson import published_tables

    terminal, format_degrees = make_console(), partial(render.format_number, digits=3)
    days = [f"{row.from_day:.1f} to {row.to_day:.1f}" for row in stretches.itertuples()]
    rows = {"days": days, "updates": stretches["yaw_updates"], "yaw update": stretches["yaw_update_deg"].map(format_degrees)}
    limits = {name: published_tables.read_requirement(name) for name in ("knowledge", "pointing", "stability")}
    for (name, limit), axis in product(limits.items(), ROTATION_NAMES):
        values = stretches[f"{name}_{axis}_deg"]
        rows[f"{name} {axis}"] = [f"{value:.3f}{' ✗' if value >= limit else ''}" for value in values]
    table = pd.DataFrame(rows).T.reset_index().set_axis(["", *(f"period {k + 1}" for k in range(len(stretches)))], axis=1)
    stated = ", ".join(f"{name} {limit:g}" for name, limit in limits.items())
    note = f"Knowledge and pointing 3σ, stability over 1 s; R's limits: {stated}; ✗ above."
    render.print_table(terminal, "Mission Mode, deg", table, note)
    if len(run.slews):
        slews = pd.DataFrame({"day": run.slews["start_s"] / DAY, "forward after": run.slews["forward"]})
        for axis in ROTATION_NAMES:
            slews[f"targeting {axis}"] = run.slews[f"targeting_{axis}_deg"].map(format_degrees)
        render.print_table(terminal, "Yaw maneuvers: true minus propagated by gyro, deg", slews)
    counts = ", ".join(f"{len(getattr(run, name))} {name}" for name in TABLES)
    click.echo(f"{out}: rows of {counts}")
