"""The command group ``gyrocal export``: recordings in other formats."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from gyrocal.recording import Recording, load
from studies.cli.options import FOLDER_TYPE, PATH, add_json_option, read_json
from studies.montecarlo.files import check_writable, write_json

CALIBRATION = click.option(
    "--calibration", type=PATH, metavar="RESULT.json", help="Result of gyrocal calibrate --json, whose values are written too."
)
EXPORT_JSON_OPTION = add_json_option("which files were made, and of what,")
RECORDING = click.argument("recording", type=PATH)
MESSAGE = (
    click.option("--object", "object_name", default="UNKNOWN", show_default=True, help="OBJECT_NAME."),
    click.option("--id", "object_id", default="UNKNOWN", show_default=True, help="The object's designator, e.g. 1997-074A."),
    click.option("--frame", default="ICRF", show_default=True, help="The inertial frame, REF_FRAME_A."),
    click.option(
        "--form", type=click.Choice(["kvn", "xml"]), default="kvn", show_default=True, help="Notation of the message."
    ),
)


def add_message_options(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of a CCSDS message."""
    for option in MESSAGE:
        function = option(function)
    return function


def add_file_argument(name: str) -> Any:
    """An argument with a file to write, refused before the work if it cannot be written."""

    def check(_: click.Context, __: click.Parameter, path: Path) -> Path:
        check_writable(path)
        return path

    return click.argument(name, type=PATH, callback=check)


@click.group("export")
def command() -> None:
    """Write a recording in another format.

    \b
    Example:
      gyrocal export aem /tmp/rec /tmp/attitude.aem --object TRMM --id 1997-074A
      gyrocal export ck /tmp/rec /tmp/attitude.bc /tmp/clock.tsc --instrument -95000 --json /tmp/export.json
    """


@command.command("aem")
@RECORDING
@add_file_argument("out")
@EXPORT_JSON_OPTION
@add_message_options
def export_aem_command(recording: Path, out: Path, as_json: Path | None, **options: Any) -> None:
    """Write the reference attitudes of RECORDING as a CCSDS Attitude Ephemeris Message (version 2) to the file OUT."""
    loaded = load(recording)

    from gyrocal.importing import aem

    aem.write_aem(loaded, out, **options)
    _tell(as_json, loaded, out)


@command.command("acm")
@RECORDING
@add_file_argument("out")
@CALIBRATION
@EXPORT_JSON_OPTION
@add_message_options
def export_acm_command(recording: Path, out: Path, calibration: Path | None, as_json: Path | None, **options: Any) -> None:
    """Write the reference attitudes of RECORDING with their variances as a CCSDS Attitude Comprehensive Message to OUT.

    With --calibration the gyro's bias and its variances are in it.
    """
    found, loaded = _read_calibration(calibration), load(recording)

    from gyrocal.importing import acm

    acm.write_acm(loaded, out, bias=found.get("bias"), bias_sigma=found.get("sigma"), **options)
    _tell(as_json, loaded, out)


@command.command("ck")
@RECORDING
@add_file_argument("out")
@add_file_argument("sclk")
@click.option("--instrument", type=int, default=-999000, show_default=True, help="NAIF number; its clock is instrument / 1000.")
@click.option("--frame", type=int, default=1, show_default=True, help="NAIF number of the inertial frame; 1 is J2000.")
@EXPORT_JSON_OPTION
def export_ck_command(recording: Path, out: Path, sclk: Path, instrument: int, frame: int, as_json: Path | None) -> None:
    """Write the reference attitudes of RECORDING as a SPICE C-kernel of type 3 to OUT, and its spacecraft clock to SCLK."""
    loaded = load(recording)

    from gyrocal.importing import ck

    ck.write_ck(loaded, out, sclk, instrument=instrument, frame=frame)
    _tell(as_json, loaded, out, sclk)


@command.command("kalibr")
@RECORDING
@add_file_argument("out")
@CALIBRATION
@click.option(
    "--random-walk", type=float, help="Random walk of the bias, rad/s/sqrt(s), which Kalibr needs and no recording states."
)
@click.option("--topic", default="/imu0", show_default=True, help="rostopic.")
@EXPORT_JSON_OPTION
def export_kalibr_command(recording: Path, out: Path, calibration: Path | None, as_json: Path | None, **options: Any) -> None:
    """Write the noise of the gyro of RECORDING as Kalibr's imu.yaml to OUT; with --calibration its matrices too."""
    found, loaded = _read_calibration(calibration), load(recording)

    from gyrocal.importing import kalibr

    kalibr.write_imu_yaml(loaded, out, G=found.get("G"), bias=found.get("bias"), **options)
    _tell(as_json, loaded, out)


@command.command("csv")
@RECORDING
@click.argument("out", type=FOLDER_TYPE)
@EXPORT_JSON_OPTION
def export_csv_command(recording: Path, out: Path, as_json: Path | None) -> None:
    """Write RECORDING as gyro.csv, attitude.csv and the mapping.toml that reads them to the folder OUT."""
    loaded = load(recording)

    from gyrocal.importing import csv_files

    csv_files.write_csv(loaded, out)
    _tell(as_json, loaded, *(out / name for name in ("gyro.csv", "attitude.csv", "mapping.toml")))


def _tell(as_json: Path | None, recording: Recording, *files: Path) -> None:
    """Write the outcome of an export as JSON."""
    if as_json:
        made = {"title": recording.title, "epoch": recording.epoch, "references": recording.attitudes.t_s.size}
        write_json(as_json, {"recording": made, "files": [str(path) for path in files]})


def _read_calibration(path: Path | None) -> dict[str, NDArray[np.float64]]:
    """G, bias and its sigma of a result, in rad/s; nothing without one."""
    if path is None:
        return {}
    names = ("G", "bias_deg_s", "sigma_bias_deg_s")
    what = "a result of gyrocal calibrate --json"
    numbers = read_json(path, what, lambda found: {name: np.array(found[name], dtype=np.float64) for name in names})
    return {
        "G": numbers["G"],
        "bias": np.deg2rad(numbers["bias_deg_s"]),
        "sigma": np.deg2rad(numbers["sigma_bias_deg_s"]),
    }
