"""The command ``gyrocal trend``: the parameters of a unit over its recordings, with an alarm where one has changed."""

from collections.abc import Sequence
from pathlib import Path

import click

from gyrocal.errors import InputError
from gyrocal.recording import load
from studies.cli.options import FOLDER_TYPE, PATH
from studies.montecarlo.files import write_csv, write_text
from studies.report.console import LINE_EVERY_S, make_console, show_stages


@click.command("trend")
@click.argument("folders", metavar="FOLDER...", type=PATH, nargs=-1, required=True)
@click.option(
    "--out", type=FOLDER_TYPE, help="Write trend.csv, all values, and trend.html, a page with the figures, to this folder."
)
@click.option(
    "--largest-walk",
    type=click.FloatRange(0),
    default=float("inf"),
    metavar="SIGMAS",
    help="Known limit of what a parameter varies from recording to recording beside its sigma; by default that of the data.",
)
def command(folders: tuple[Path, ...], out: Path | None, largest_walk: float) -> None:
    """Show the parameters of each gyro over a unit's recordings, and which of them have changed, and when.

    A FOLDER is a recording or holds recordings. Each is calibrated, and their epochs give the order. A unit without a change
    raises an alarm with a probability of 0.1 at most, however often its trend is looked at. See docs/trend.md.

    \b
    Examples:
      gyrocal simulate trmm /tmp/unit/one --seed 1
      gyrocal simulate trmm /tmp/unit/two --seed 2 --set 'epoch="1998-01-13T09:45:00Z"'
      gyrocal trend /tmp/unit --out /tmp/trend
      gyrocal trend /tmp/unit/one /tmp/unit/two --largest-walk 0
    """
    paths = find_recordings(folders)
    is_short = len({path.name for path in paths}) == len(paths)
    loaded = {path.name if is_short else str(path): load(path) for path in paths}

    from studies.compare.trend import estimate_trend
    from studies.report import trend

    with show_stages("trend", LINE_EVERY_S) as tell:
        found = estimate_trend(loaded, largest_walk, tell)
    if out:
        from studies.report.pages import build_provenance_footer

        write_csv(out / "trend.csv", found.tabulate_values())
        write_text(out / "trend.html", trend.build_trend_page(found, build_provenance_footer()))
    trend.show(make_console(), found)


def find_recordings(folders: Sequence[Path]) -> list[Path]:
    """Find the recordings that some folders are or hold.

    Raises
    ------
    InputError
        A folder holds none, or one is found twice.
    """
    found = []
    for folder in folders:
        inside = (
            [folder] if (folder / "recording.toml").exists() else sorted(one.parent for one in folder.glob("*/recording.toml"))
        )
        if not inside:
            raise InputError(f"{folder}: neither a recording nor a folder with recordings")
        found += inside
    places = [path.resolve() for path in found]
    twice = [path for path, place in zip(found, places, strict=True) if places.count(place) > 1]
    if twice:
        raise InputError(f"{twice[0]}: is given twice; give each recording once")
    return found
