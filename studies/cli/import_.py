"""The command group ``gyrocal import``: recordings from other formats."""

from pathlib import Path

import click

from gyrocal import InputError, save
from studies.report import tables as render
from studies.report.console import console
from studies.validation import broad

PATH = click.Path(path_type=Path)


@click.group("import")
def import_group() -> None:
    """Turn data of another format into a recording.

    \b
    Example:
      gyrocal import broad 05_undisturbed_slow_rotation_with_breaks_B.parquet /tmp/rec
    """


@import_group.command("broad")
@click.argument("file", type=PATH)
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--intervals",
    default="motion",
    show_default=True,
    help="motion: rest, motion, rest for each motion phase, a long one in pieces; whole: all in one; or a length in s.",
)
@click.option("--spacing", "spacing_s", type=float, default=1.0, show_default=True, help="s between reference attitudes.")
@click.option("--force", is_flag=True, help="Replace a recording that is in OUT already.")
def broad_command(file: Path, out: Path, intervals: str, spacing_s: float, force: bool) -> None:
    """Import FILE, a trial of BROAD as one Parquet file, and write the recording to the folder OUT.

    Raw gyro and optical orientations go in as they are; noise and sigmas are estimated from the trial. See docs/broad.md.

    \b
    Examples:
      gyrocal import broad 05_undisturbed_slow_rotation_with_breaks_B.parquet /tmp/rec
      gyrocal calibrate /tmp/rec
    """
    if (out / "recording.toml").exists() and not force:
        raise InputError(f"{out}: a recording is there already; choose another folder, or replace it with --force")
    imported = broad.to_recording(broad.read(file), _intervals(intervals), spacing_s)
    save(imported.recording, out)
    render.terminal(console(), str(out), imported.summary())
    click.echo(broad.ATTRIBUTION)


def _intervals(text: str) -> str | float:
    if text in ("motion", "whole"):
        return text
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--intervals {text}: give motion, whole, or a length in s") from None
