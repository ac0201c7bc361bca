"""The command ``gyrocal allan``: Allan deviation of a recording's noise, with the terms of IEEE Std 952."""

from pathlib import Path

import click

from gyrocal import load
from studies.allan import report as allan_report
from studies.allan.analysis import analyse
from studies.cli.options import PATH, json_option, output_option
from studies.montecarlo.files import write_json, write_text
from studies.report.console import console
from studies.report.pages import made_of
from studies.report.panels import save


@click.command("allan")
@click.argument("recording", type=PATH)
@click.option("--interval", metavar="NAME", help="Look at this interval only.")
@json_option("deviation, bands and terms")
@output_option("--report", help="Write a page with the figure (HTML, needs no network) to this file.")
@output_option("--figure", help="Write the figure alone to this file, .svg or .png.", endings=(".svg", ".png"))
def command(recording: Path, interval: str | None, as_json: Path | None, report: Path | None, figure: Path | None) -> None:
    """Overlapping Allan deviation of the noise in RECORDING, with confidence bands and the noise terms of IEEE Std 952.

    Rests are used as recorded; where the body moves, the motion that the references show is taken out. Each term has its size
    with sigma, or a bound if it is not seen, beside what the recording states. See docs/allan.md.

    \b
    Examples:
      gyrocal simulate trmm_series /tmp/rec --effect noise_flicker:z=0.5
      gyrocal allan /tmp/rec --report /tmp/allan.html
      gyrocal allan /tmp/rec --interval m1 --json /tmp/allan.json
    """
    loaded = load(recording)
    found = analyse(loaded, interval)
    allan_report.show(console(), found)
    if as_json:
        write_json(as_json, found.to_json())
    if report:
        write_text(report, allan_report.page(found, made_of(loaded)))
    if figure:
        save(allan_report.figure(found), figure)
