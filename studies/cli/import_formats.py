"""The commands of ``gyrocal import`` for files of a known form, whose columns need no names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gyrocal.angle_units import RATE_UNITS
from studies.cli.options import (
    EXCLUDE,
    FOLDER_TYPE,
    FORCE,
    GYRO_TABLE_OPTIONS,
    PATH,
    RATE,
    add_json_option,
    add_options,
    refuse_existing,
)
from studies.montecarlo.files import write_json
from studies.report.console import make_console

if TYPE_CHECKING:
    import pandas as pd

    from gyrocal.importing import ImportResult
    from gyrocal.importing.aem import Aem
    from gyrocal.recording import Recording

OUT = click.argument("out", type=FOLDER_TYPE)
GYRO_ARGUMENT = click.argument("gyro_file", type=PATH, metavar="GYRO.csv")
TEMPERATURE = click.option("--temperature", metavar="COLUMN", help="Gyro's temperature in its table, °C; becomes housekeeping.")


class WordsOrNumbers(click.ParamType):
    """One of some words, a number or three numbers, or with has_columns any other text."""

    name = "text"

    def __init__(self, words: tuple[str, ...], counts: tuple[int, ...], has_columns: bool = False):
        self.words, self.counts, self.has_columns = words, counts, has_columns

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a text to the word, a number, or a list of three numbers."""
        if value in self.words:
            return value
        try:
            numbers = [float(part) for part in str(value).split(",")]
        except ValueError:
            if self.has_columns:
                return value
            numbers = []
        if len(numbers) not in self.counts:
            known = [*self.words, *("three numbers, x,y,z" if count == 3 else "a number" for count in self.counts)]
            self.fail(f"{value!r} is not {' or '.join(known)}", param, ctx)
        return numbers[0] if len(numbers) == 1 else numbers


class Axes(click.ParamType):
    """Directions of gyros, or a word for them."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a text to the word, or to a list of three numbers for each gyro."""
        if value == "tetrahedron":
            return value
        try:
            rows = [[float(part) for part in row.split(",")] for row in str(value).split(";")]
        except ValueError:
            rows = []
        if not rows or any(len(row) != 3 for row in rows):
            self.fail(f"{value!r} is not tetrahedron, or three numbers a gyro, as in '1,0,0;0,1,0;0.6,0,0.8'", param, ctx)
        return rows


ATTITUDE_TABLE = (
    click.option(
        "--quat",
        metavar="COLUMNS:DIRECTION",
        help="E.g. qw,qx,qy,qz:body-to-inertial; add :scalar-last or :scalar-first if the names do not show it.",
    ),
    click.option("--euler", metavar="COLUMNS:…", help="E.g. yaw,pitch,roll:deg:ZYX:body-to-inertial."),
    click.option("--matrix", metavar="COLUMNS:DIRECTION", help="Nine columns, row by row."),
    click.option("--attitude-time", metavar="COLUMN:UNIT", help="Time column of the attitudes, if it differs from the gyro's."),
)
ALIGNMENT_OPTIONS = (
    click.option(
        "--align",
        type=click.Choice(["as given", "auto"]),
        help="auto: find time offset, clock rate, direction, mounting and, if needed, a factor of the rates, and apply them.",
    ),
    click.option("--attitude-offset", "attitude_offset_s", type=float, help="s added to the attitudes' time tags."),
    click.option("--time-factor", type=float, help="Factor of the gyro's time tags about the first."),
    click.option("--rate-factor", type=float, help="Factor of the rates."),
    click.option(
        "--axes",
        type=Axes(),
        metavar="'X,Y,Z;X,Y,Z;…'",
        help="Direction of each gyro in the body, or tetrahedron (three or four of its axes); x, y and z by default.",
    ),
    click.option(
        "--mounting",
        type=WordsOrNumbers(("as given", "estimate"), (3,)),
        metavar="estimate|X,Y,Z",
        help="Rotation from the gyro's axes to those of the attitudes: estimate, or a rotation vector in deg.",
    ),
    click.option(
        "--sigma",
        "sigma_deg",
        type=WordsOrNumbers((), (1, 3), has_columns=True),
        metavar="DEG|X,Y,Z|COLUMNS",
        help="1-sigma of the references, deg: a number, three about the body's axes, or a column of their table or three.",
    ),
    click.option("--spacing", "spacing_s", type=float, help="Least time between references, s."),
    EXCLUDE,
    click.option("--unchecked", is_flag=True, default=None, help="Import even if rates and attitudes do not fit each other."),
)
TAG = click.option(
    "--tag",
    type=click.Choice(["start", "middle", "end"]),
    help="Part of a sample that its time tag refers to; start by default.",
)
IMPORT_JSON_OPTION = add_json_option("what was made, and what was assumed,")
TABLE = (*GYRO_TABLE_OPTIONS, TEMPERATURE, TAG, *ALIGNMENT_OPTIONS, FORCE, IMPORT_JSON_OPTION)


def show(
    recording: Recording,
    summary: pd.DataFrame,
    assumed: Sequence[str],
    out: Path,
    as_json: Path | None,
    warnings: Sequence[str] = (),
) -> None:
    """Show the imported recording on the terminal, after the warnings, and write it as JSON with units in the names."""
    from studies.report import tables as render

    for text in warnings:
        click.echo(f"implausible: {text}")
    render.print_table(make_console(), str(out), summary)
    if as_json:
        gyro = recording.gyro
        intervals = [{"name": span.name, "start_s": span.start_s, "stop_s": span.stop_s} for span in recording.intervals]
        content = {
            "folder": str(out),
            "title": recording.title,
            "epoch": recording.epoch,
            "time_scale": recording.time_scale,
            "gyro_samples": gyro.t_s.size,
            "sample_s": gyro.sample_s,
            "arw_deg_per_sqrt_s": gyro.arw_deg_per_sqrt_s,
            "apriori_bias_deg_s": gyro.apriori_bias_deg_s,
            "references": recording.attitudes.t_s.size,
            "intervals": intervals,
            "assumed": assumed,
            "implausible": list(warnings),
        }
        write_json(as_json, content)


def write_import(imported: ImportResult, out: Path, as_json: Path | None) -> None:
    """Write the recording and the notes of an import, and show it."""
    from gyrocal import importing

    importing.write(imported, out)
    show(imported.recording, imported.summary(), imported.assumed, out, as_json, imported.warnings)


def _import_with_attitudes(gyro_file: Path, attitudes: Aem, out: Path, options: dict[str, Any]) -> None:
    """Import a gyro's table with the attitudes of a message or kernel."""
    from gyrocal import importing
    from gyrocal.importing import aem
    from gyrocal.importing.streams import read_csv

    attitude, attitude_entries = aem.tabulate_attitudes(attitudes)
    file, as_json = options.pop("file"), options.pop("as_json")
    file_entries = importing.load_mapping(file) if file else {}
    entries = {"title": attitudes.title} | file_entries | attitude_entries | collect_entries(options)
    mapping = importing.validate_mapping(entries, str(file) if file else "options")
    write_import(importing.import_tables(read_csv(gyro_file), attitude, mapping), out, as_json)


@click.command("aem")
@GYRO_ARGUMENT
@click.argument("message", type=PATH, metavar="ATTITUDE.aem")
@OUT
@add_options(*TABLE)
def import_aem_command(gyro_file: Path, message: Path, out: Path, force: bool, **options: Any) -> None:
    """Import a gyro's table and a CCSDS Attitude Ephemeris Message (version 1 or 2, KVN or XML). See docs/formats.md.

    \b
    Example:
      gyrocal import aem gyro.csv attitude.aem /tmp/rec --time time:iso --gyro gx,gy,gz:deg/s
    """
    refuse_existing(out, force)
    from gyrocal.importing import aem

    _import_with_attitudes(gyro_file, aem.read_aem(message), out, options)


@click.command("ck")
@GYRO_ARGUMENT
@click.argument("kernel", type=PATH, metavar="ATTITUDE.bc")
@click.argument("sclk", type=PATH, metavar="CLOCK.tsc")
@OUT
@click.option("--instrument", type=int, help="NAIF number of the instrument, e.g. -82000; that of the kernel if it has one.")
@click.option("--spacecraft", type=int, help="NAIF number of the spacecraft whose clock it is; instrument / 1000 by default.")
@add_options(*TABLE)
def import_ck_command(gyro_file: Path, kernel: Path, sclk: Path, out: Path, force: bool, **options: Any) -> None:
    """Import a gyro's table and SPICE attitudes, a C-kernel with its spacecraft clock. See docs/formats.md.

    \b
    Example:
      gyrocal import ck gyro.csv attitude.bc clock.tsc /tmp/rec --time time:iso --gyro gx,gy,gz:deg/s
    """
    refuse_existing(out, force)
    from gyrocal.importing import ck

    attitudes = ck.read_ck(kernel, sclk, options.pop("instrument"), options.pop("spacecraft"))
    _import_with_attitudes(gyro_file, attitudes, out, options)


@click.command("euroc")
@click.argument("folder", type=PATH)
@OUT
@click.option(
    "--reference",
    help="Folder with the attitudes; by default the first that exists of vicon0, state_groundtruth_estimate0, mocap0.",
)
@click.option("--estimate-noise", is_flag=True, help="Estimate the noise although the folder states it.")
@RATE
@add_options(*ALIGNMENT_OPTIONS)
@FORCE
@IMPORT_JSON_OPTION
def import_euroc_command(
    folder: Path, out: Path, reference: str | None, estimate_noise: bool, force: bool, as_json: Path | None, **options: Any
) -> None:
    """Import FOLDER of the EuRoC form (mav0/imu0 and mav0/vicon0 or another reference). See docs/formats.md.

    \b
    Example:
      gyrocal import euroc V1_01_easy /tmp/rec
    """
    refuse_existing(out, force)
    from gyrocal.importing import euroc

    write_import(euroc.import_euroc(folder, reference, not estimate_noise, **collect_entries(options)), out, as_json)


@click.command("bag")
@click.argument("bag", type=PATH)
@OUT
@click.option("--imu-topic", help="Topic of the Imu messages; the only one by default.")
@click.option("--pose-topic", help="Topic of the attitudes: PoseStamped, Odometry and the like; the only one by default.")
@click.option("--gyro-unit", type=click.Choice(list(RATE_UNITS)), default="rad/s", help="Unit of the rates, if not rad/s.")
@add_options(TAG, RATE, *ALIGNMENT_OPTIONS, FORCE, IMPORT_JSON_OPTION)
def import_bag_command(
    bag: Path,
    out: Path,
    imu_topic: str | None,
    pose_topic: str | None,
    gyro_unit: str,
    force: bool,
    as_json: Path | None,
    **options: Any,
) -> None:
    """Import BAG of ROS 1 or 2: Imu messages, and PoseStamped, Odometry or the like. See docs/formats.md.

    \b
    Example:
      gyrocal import bag flight.bag /tmp/rec --imu-topic /imu0 --pose-topic /vicon/pose
    """
    refuse_existing(out, force)
    from gyrocal.importing import rosbag

    write_import(rosbag.import_bag(bag, imu_topic, pose_topic, gyro_unit, **collect_entries(options)), out, as_json)


def collect_entries(options: dict[str, Any]) -> dict[str, Any]:
    """Collect the options that are given."""
    return {name: value for name, value in options.items() if value is not None}


IMPORT_COMMANDS = (import_aem_command, import_ck_command, import_euroc_command, import_bag_command)
