"""The command group ``gyrocal import``: recordings from other formats."""

from pathlib import Path
from typing import Any

import click

from gyrocal.errors import InputError
from gyrocal.recording import save
from studies.cli import import_formats
from studies.cli.import_formats import (
    ATTITUDE_TABLE,
    IMPORT_JSON_OPTION,
    OUT,
    TABLE,
    WordsOrNumbers,
    collect_entries,
    show,
    write_import,
)
from studies.cli.options import FORCE, PATH, add_options, refuse_existing


@click.group("import")
def command() -> None:
    """Turn data of another format into a recording.

    \b
    Example:
      gyrocal import csv gyro.csv mocap.csv /tmp/rec --time timestamp_ms:ms --gyro gx,gy,gz:deg/s \\
        --quat qw,qx,qy,qz:body-to-inertial
      gyrocal import broad 05_undisturbed_slow_rotation_with_breaks_B.parquet /tmp/trial
    """


for format_command in import_formats.IMPORT_COMMANDS:
    command.add_command(format_command)


@command.command("csv")
@click.argument("files", type=PATH, nargs=-1, required=True)
@add_options(*ATTITUDE_TABLE)
@click.option("--gyro-by", metavar="COLUMN", help="Column with the gyro of each row; --gyro then names one column.")
@click.option("--attitude-by", metavar="COLUMN", help="Column with the attitude sensor of each row.")
@click.option("--sensor", metavar="NAME", help="The only one of them that is read; by default they are joined.")
@click.option("--interval", "interval_s", type=float, help="Longest interval, s.")
@click.option("--title", help="Title of the recording.")
@add_options(*TABLE)
def import_csv_command(files: tuple[Path, ...], file: Path | None, force: bool, as_json: Path | None, **options: Any) -> None:
    """Import GYRO.csv and ATTITUDE.csv, or one table with both, and write the recording to the folder OUT: FILES are these.

    What is not stated is estimated, and what was assumed stands in OUT/import.toml. A mapping that does not fit is refused, and
    the one that would is named. See docs/import.md.

    \b
    Examples:
      gyrocal import csv gyro.csv mocap.csv /tmp/rec --time timestamp_ms:ms --gyro gx,gy,gz:deg/s \\
        --quat qw,qx,qy,qz:body-to-inertial
      gyrocal import csv log.csv /tmp/again --mapping mapping.toml --json /tmp/import.json
    """
    if len(files) not in (2, 3):
        raise InputError("give GYRO.csv, ATTITUDE.csv and the folder OUT, or one table with both and OUT")
    *tables, out = files
    refuse_existing(out, force)
    from gyrocal import importing

    entries = importing.load_mapping(file) if file else {}
    mapping = importing.validate_mapping(entries | collect_entries(options), str(file) if file else "options")
    write_import(importing.import_csv(*tables, mapping=mapping), out, as_json)


@command.command("broad")
@click.argument("file", type=PATH)
@OUT
@click.option(
    "--intervals",
    type=WordsOrNumbers(("motion", "whole"), (1,)),
    default="motion",
    show_default=True,
    help="motion: rest, motion, rest for each motion phase, a long one in pieces; whole: all in one; or a length in s.",
)
@click.option("--spacing", "spacing_s", type=float, default=1.0, show_default=True, help="s between reference attitudes.")
@click.option("--attitude-offset", "attitude_offset_s", type=float, default=0.0, help="s added to the attitudes' time tags.")
@FORCE
@IMPORT_JSON_OPTION
def import_broad_command(
    file: Path, out: Path, intervals: str | float, spacing_s: float, attitude_offset_s: float, force: bool, as_json: Path | None
) -> None:
    """Import FILE, a trial of BROAD as one Parquet file, and write the recording to the folder OUT.

    Raw gyro and optical orientations go in as they are; noise and sigmas are estimated from the trial. See docs/validation.md.

    \b
    Examples:
      gyrocal import broad 05_undisturbed_slow_rotation_with_breaks_B.parquet /tmp/rec
      gyrocal calibrate /tmp/rec
    """
    refuse_existing(out, force)
    import pandas as pd

    from studies.validation import broad

    trial = broad.read(file)
    imported = broad.build_recording(trial, intervals, spacing_s, attitude_offset_s)
    save(imported.recording, out)
    offset = broad.describe_time_offset(trial, attitude_offset_s)
    summary = pd.concat([imported.summary(), pd.DataFrame([("assumed", text) for text in offset], columns=["what", "value"])])
    show(imported.recording, summary, offset, out, as_json)
    click.echo(broad.BROAD_ATTRIBUTION)
