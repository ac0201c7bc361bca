"""The command group ``gyrocal export``: recordings in other formats."""

from pathlib import Path

import click

from gyrocal.recording import load
from studies.cli.options import FOLDER_TYPE, PATH, add_json_option
from studies.montecarlo.files import write_json


@click.group("export")
def command() -> None:
    """Write a recording in another format.

    \b
    Example:
      gyrocal export csv /tmp/rec /tmp/out --json /tmp/export.json
    """


@command.command("csv")
@click.argument("recording", type=PATH)
@click.argument("out", type=FOLDER_TYPE)
@add_json_option("which files were made, and of what,")
def export_csv_command(recording: Path, out: Path, as_json: Path | None) -> None:
    """Write RECORDING as gyro.csv, attitude.csv and the mapping.toml that reads them to the folder OUT."""
    loaded = load(recording)

    from gyrocal.importing import csv_files

    csv_files.write_csv(loaded, out)
    if as_json:
        description = {"title": loaded.title, "epoch": loaded.epoch, "references": loaded.attitudes.t_s.size}
        files = [str(out / name) for name in ("gyro.csv", "attitude.csv", "mapping.toml")]
        write_json(as_json, {"recording": description, "files": files})
