"""The command ``gyrocal next``: the last of a unit's recordings predicted from the earlier ones, and compared."""

from pathlib import Path

import click

from gyrocal.errors import InputError
from gyrocal.recording import load
from studies.cli.options import PATH, add_json_option, add_seed_option, compare_conditions, end, parse_condition, write_result
from studies.report.console import LINE_EVERY_S, make_console, show_stages


@click.command("next")
@click.argument("recordings", type=PATH, nargs=-1, required=True)
@click.option("--own-bias", is_flag=True, help="Each recording has a bias of its own, as after a restart of the gyros.")
@add_json_option(stdout="the table")
@click.option("--fail-on", multiple=True, metavar="CONDITION", help="End with status 3 if it holds, as p<0.001; repeatable.")
@add_seed_option()
def command(recordings: tuple[Path, ...], own_bias: bool, as_json: Path | None, fail_on: tuple[str, ...], seed: int) -> None:
    """Predict the residuals of the last of a unit's RECORDINGS from all earlier ones, and test the prediction.

    The earlier recordings are diagnosed together. G, b and the identified effects, with their uncertainty, give the expected
    residuals at the references of the last recording. A small p means that the last recording has an error that the earlier
    ones did not have, or lacks one of theirs. See docs/compare.md.

    \b
    Example:
      gyrocal simulate trmm_series /tmp/one --seed 1
      gyrocal simulate trmm_series /tmp/two --seed 2
      gyrocal simulate trmm_series /tmp/three --seed 3 --effect scale_asymmetry:z=600
      gyrocal next /tmp/one /tmp/two /tmp/three
    """
    for text in fail_on:
        parse_condition(text, ["p"])
    if len({path.resolve() for path in recordings}) < len(recordings):
        raise InputError("a recording is given twice; give each once, since a recording cannot test a prediction from itself")
    loaded = {str(path): load(path) for path in recordings}

    from diagnosis.next_recording import predict_next_recording
    from studies.report import next_recording

    with show_stages("next", LINE_EVERY_S) as progress:
        found = predict_next_recording(loaded, own_bias=own_bias, seed=seed, tell=progress)
    write_result(as_json, found.to_json(), lambda: next_recording.show(make_console(), found))
    end("next", found.following, compare_conditions(fail_on, {"p": found.predicted.p_value}), None)
