"""The command group ``gyrocal export``: recordings in other formats."""

from pathlib import Path

import click

from gyrocal import load
from gyrocal.importing.aem import write_aem
from studies.cli.options import PATH
from studies.montecarlo.files import check_writable


@click.group("export")
def command() -> None:
    """Write a recording in another format.

    \b
    Example:
      gyrocal export aem /tmp/rec /tmp/attitude.aem --object TRMM --id 1997-074A
    """


@command.command("aem")
@click.argument("recording", type=PATH)
@click.argument("out", type=PATH)
@click.option("--object", "object_name", default="UNKNOWN", show_default=True, help="OBJECT_NAME.")
@click.option("--id", "object_id", default="UNKNOWN", show_default=True, help="OBJECT_ID, e.g. 1997-074A.")
@click.option("--frame", default="ICRF", show_default=True, help="The inertial frame, REF_FRAME_A.")
def aem_command(recording: Path, out: Path, object_name: str, object_id: str, frame: str) -> None:
    """Write the reference attitudes of RECORDING as a CCSDS Attitude Ephemeris Message (version 2, KVN) to the file OUT."""
    check_writable(out)
    write_aem(load(recording), out, object_name=object_name, object_id=object_id, frame=frame)
