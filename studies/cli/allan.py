"""The command ``gyrocal allan``: Allan deviation of a recording's noise, with the terms of IEEE Std 952."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from gyrocal.errors import InputError
from gyrocal.recording import Recording, load
from studies.cli.options import GYRO_TABLE_OPTIONS, PATH, add_json_option, add_options, add_output_option, write_result

OPTION_NAMES = {"file": "mapping", "rate_hz": "rate", "sample_number": "sample-number"}  # of those with another word


@click.command("allan")
@click.argument("recording", type=PATH)
@click.option("--interval", metavar="NAME", help="Analyse this interval only.")
@add_options(*GYRO_TABLE_OPTIONS)
@add_json_option("deviation, bands and terms")
@add_output_option("--report", help="Write a page with the figure (HTML, needs no network) to this file.")
@add_output_option("--figure", help="Write the figure alone to this file, .svg or .png.", endings=(".svg", ".png"))
def command(
    recording: Path, interval: str | None, as_json: Path | None, report: Path | None, figure: Path | None, **options: Any
) -> None:
    """Compute the overlapping Allan deviation of the noise in RECORDING, with the noise terms of IEEE Std 952.

    The raw rates of rests are used. Elsewhere the motion is estimated from the references and subtracted. The table has the
    size of each term that is seen with its sigma, beside the value stated in the recording.
    RECORDING may be a CSV table of a gyro alone, with --time, --gyro and further options of import csv. See
    docs/allan.md.

    \b
    Examples:
      gyrocal simulate trmm_series /tmp/rec --effect noise_flicker:z=0.5
      gyrocal allan /tmp/rec --report /tmp/allan.html
      gyrocal allan /tmp/rec --interval m1 --json /tmp/allan.json
      gyrocal allan gyro.csv --time timestamp_ms:ms --gyro gx,gy,gz:deg/s
    """
    loaded = _load_recording_or_table(recording, options)

    from studies.allan.analysis import estimate_noise_terms
    from studies.allan.report import build_allan_page, draw_allan_figure

    analysis = estimate_noise_terms(loaded, interval)
    write_result(analysis.to_json(), as_json, partial(build_allan_page, analysis), report, loaded)
    if figure:
        from studies.report.panels import save

        save(draw_allan_figure(analysis), figure)


def _load_recording_or_table(path: Path, options: dict[str, Any]) -> Recording:
    """Load a recording, which may have no references, or build one from a table of the gyro alone."""
    given_options = {name: value for name, value in options.items() if value is not None}
    if not path.is_file():
        if given_options:
            raise InputError(
                f"{', '.join(f'--{OPTION_NAMES.get(name, name)}' for name in given_options)}: for a CSV table; {path} is none"
            )
        return load(path, without_references=True)

    from gyrocal import importing

    file = given_options.pop("file", None)
    loaded, assumed = importing.import_gyro_log(path, (importing.load_mapping(file) if file else {}) | given_options)
    for text in assumed:
        click.echo(f"Assumed: {text}.")
    return loaded
