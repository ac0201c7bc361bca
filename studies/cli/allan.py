"""The command ``gyrocal allan``: Allan deviation of a recording's noise, with the terms of IEEE Std 952."""

from pathlib import Path

import click

from gyrocal import InputError, load
from studies.allan import report as allan_report
from studies.allan.analysis import analyse
from studies.cli.options import PATH
from studies.montecarlo.files import check_writable, write_json, write_text
from studies.report.console import console
from studies.report.made import made_of
from studies.report.panels import save

FORMATS = (".svg", ".png")


@click.command("allan")
@click.argument("recording", type=PATH)
@click.option("--interval", metavar="NAME", help="Look at this interval only.")
@click.option("--json", "as_json", type=PATH, help="Write deviation, bands and terms as JSON to this file.")
@click.option("--report", type=PATH, help="Write a page with the figure (HTML, needs no network) to this file.")
@click.option("--figure", type=PATH, help="Write the figure alone to this file, .svg or .png.")
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
    files = [path for path in (as_json, report, figure) if path is not None]
    for path in files:
        check_writable(path)
    if len({path.resolve() for path in files}) < len(files):
        raise InputError("--json, --report and --figure need files of their own")
    if figure is not None and figure.suffix not in FORMATS:
        raise InputError(f"--figure {figure}: the name must end in {' or '.join(FORMATS)}")
    loaded = load(recording)
    found = analyse(loaded, interval)
    allan_report.show(console(), found)
    if as_json:
        write_json(as_json, found.to_json())
    if report:
        write_text(report, allan_report.page(found, made_of(loaded)))
    if figure:
        save(allan_report.figure(found), figure)
