"""The command ``gyrocal diagnose``: where a recording departs from the baseline simulator, and which effect explains it."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from gyrocal.errors import InputError, suggest_names
from gyrocal.recording import load
from studies.cli.options import (
    EXCLUDE,
    JUNIT,
    PAGE,
    PATH,
    STDOUT,
    add_json_option,
    add_output_option,
    add_seed_option,
    effects_option,
    end,
    write_result,
)
from studies.montecarlo.files import write_text
from studies.report.console import LINE_EVERY_S, show_stages
from studies.report.junit import Verdict


@click.command("diagnose")
@click.argument("recording", type=PATH)
@effects_option
@add_json_option(stdout="the summary")
@add_output_option("--report", help=PAGE)
@add_output_option("--adopt", help="Write a scenario with the recording's motion, the identified effects and the remainder.")
@click.option(
    "--without",
    multiple=True,
    metavar="EFFECT",
    help="Exclude an effect from the diagnosis, see 'gyrocal effects'; repeatable.",
)
@EXCLUDE
@click.option(
    "--fail-on",
    type=click.Choice(["gap", "unknown"]),
    multiple=True,
    help="End with status 3 if there is a gap, or if its cause is unknown; repeatable.",
)
@add_output_option("--junit", help=JUNIT)
@add_seed_option()
def command(
    recording: Path,
    as_json: Path | None,
    report: Path | None,
    adopt: Path | None,
    without: tuple[str, ...],
    exclude: list[list[float]] | None,
    seed: int,
    fail_on: tuple[str, ...],
    junit: Path | None,
) -> None:
    """Test RECORDING against the baseline simulator, identify the cause of a misfit, and measure how far it closes the gap.

    The baseline has a constant G and b, white gyro noise and white reference noise, both as stated. The gap is the misfit
    beyond them. Without --fail-on the exit status is 0 whatever the answer. Raw tables of sun and Earth sensors with an
    ephemeris are diagnosed too. See docs/diagnosis.md.

    \b
    Examples:
      gyrocal simulate trmm_series /tmp/rec --effect bias_orbital:z=0.3
      gyrocal diagnose /tmp/rec --report /tmp/report.html --json /tmp/diagnosis.json
      gyrocal diagnose /tmp/rec --without bias_orbital
      gyrocal diagnose /tmp/rec --adopt /tmp/adopted.toml
      gyrocal diagnose /tmp/rec --fail-on unknown --junit /tmp/diagnosis.xml
    """
    library = _select_library(without)
    loaded = load(recording)

    from diagnosis.adopt import write_adopted_scenario
    from diagnosis.diagnose import diagnose
    from studies.report.diagnosis import build_diagnosis_page

    with show_stages("diagnose", LINE_EVERY_S) as progress:
        spans = [(first, stop) for first, stop in exclude or ()]
        result = diagnose(loaded, progress=progress, seed=seed, library=library, exclude=spans)
    write_result(result.to_json(), as_json, partial(build_diagnosis_page, result), report, loaded)
    if adopt:
        text, adoption = write_adopted_scenario(result, loaded, recording, adopt)
        write_text(adopt, text)
        click.echo(f"{adopt}: {adoption.sentence()}", err=as_json == STDOUT)
    holds = {"gap": result.present, "unknown": result.verdict == "unknown"}
    answer = f"{result.verdict}, p = {result.p_value:.2g}"
    end("diagnose", str(recording), [Verdict(name, answer if holds[name] else "") for name in fail_on], junit)


def _select_library(without: Sequence[str]) -> list[str] | None:
    """List the effects that may be identified; None for all."""
    if not without:
        return None
    from simulator.effects.sensor import ALL_EFFECTS

    for name in without:
        if name not in ALL_EFFECTS:
            raise InputError(f"--without {name}: no such effect; {suggest_names(name, ALL_EFFECTS)}")
    return [name for name in ALL_EFFECTS if name not in without]
