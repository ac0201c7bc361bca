"""The command ``gyrocal next``: the last of a unit's recordings predicted from those before it, and compared."""

from pathlib import Path

import click

from diagnosis.next_recording import foretell
from gyrocal import InputError, load
from gyrocal.recording.gyros import need_triad
from studies.cli.fail_on import compared, end, parsed
from studies.cli.options import PATH, STDOUT
from studies.cli.stages import stages
from studies.montecarlo.files import check_writable, json_text, write_json
from studies.report import next_recording
from studies.report.console import LINE_EVERY_S, console


@click.command("next")
@click.argument("recordings", type=PATH, nargs=-1, required=True)
@click.option("--own-bias", is_flag=True, help="Each recording has a bias of its own, as after a restart of the gyros.")
@click.option(
    "--json", "as_json", type=PATH, help="Write the result as JSON to this file; - for standard output in place of the table."
)
@click.option("--fail-on", multiple=True, metavar="CONDITION", help="End with status 3 if it holds, as p<0.001; repeatable.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the random draws.")
def command(recordings: tuple[Path, ...], own_bias: bool, as_json: Path | None, fail_on: tuple[str, ...], seed: int) -> None:
    """Predict the last of a unit's RECORDINGS from all those before it, and compare.

    Those before are diagnosed together: G, b and the effects that they name, with their uncertainty, say what the residuals of
    the last one should be at the times of its references. See docs/compare.md.

    \b
    Example:
      gyrocal simulate trmm_series /tmp/one --seed 1
      gyrocal simulate trmm_series /tmp/two --seed 2
      gyrocal simulate trmm_series /tmp/three --seed 3 --effect scale_asymmetry:z=600
      gyrocal next /tmp/one /tmp/two /tmp/three
    """
    for text in fail_on:
        parsed(text, ["p"])
    check_writable(as_json)
    if len({path.resolve() for path in recordings}) < len(recordings):
        raise InputError("a recording is given twice: one that predicts itself says nothing")
    loaded = {str(path): load(path) for path in recordings}
    for one in loaded.values():
        need_triad(one.gyro)
    with stages("next", LINE_EVERY_S) as progress:
        found = foretell(loaded, own_bias=own_bias, seed=seed, tell=progress)
    if as_json == STDOUT:
        click.echo(json_text(found.to_json()))
    else:
        next_recording.show(console(), found)
    if as_json and as_json != STDOUT:
        write_json(as_json, found.to_json())
    end("next", found.following, compared(fail_on, {"p": found.predicted.p_value}), None)
