"""The command ``gyrocal simulate``: a scenario, or a recording once more, as a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from gyrocal.errors import InputError
from gyrocal.recording import Recording, load, save
from studies.cli.options import (
    FOLDER_TYPE,
    FORCE,
    add_json_option,
    add_output_option,
    add_seed_option,
    effects_option,
    parse_assignment,
    refuse_existing,
)
from studies.montecarlo.files import write_json

if TYPE_CHECKING:
    from gyrocal.calibration.parameters import GyroParameters
    from simulator.effects import Setting


@click.command("simulate")
@click.argument("scenario")
@click.argument("out", type=FOLDER_TYPE)
@add_seed_option("Seed of the random streams.")
@click.option("--case", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True, help="Case number under that seed.")
@click.option("--noise-free", is_flag=True, help="Without the white noise of gyro and references; effects still act.")
@click.option("--draw", is_flag=True, help="Draw the sizes of SCENARIO's own effects from their posterior, by seed and case.")
@click.option("--set", "changes", multiple=True, metavar="PATH=VALUE", help="Override a value of the scenario; repeatable.")
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME:AXIS=SIZE[,KEY=VALUE…]",
    help="Error that the baseline does not have, see 'gyrocal effects'; repeatable.",
)
@effects_option
@add_output_option("--truth", help="Also write the injected G, bias and effects as JSON to this file.")
@add_json_option("what was made")
@FORCE
def command(
    scenario: str,
    out: Path,
    seed: int,
    case: int,
    noise_free: bool,
    draw: bool,
    changes: tuple[str, ...],
    effects: tuple[str, ...],
    truth: Path | None,
    as_json: Path | None,
    force: bool,
) -> None:
    """Simulate SCENARIO (a built-in name or a TOML file) and write the recording to the folder OUT.

    Lists in a path count from zero: interval.1 is the second interval.

    SCENARIO may also be the folder of a recording. It is calibrated, and its motion simulated again with that calibration as
    truth: same sample tags, reference times, noise as stated and housekeeping. SCENARIO may hold effects of its own, such as
    one that 'gyrocal diagnose --adopt' has written; see docs/compare.md.

    \b
    Examples:
      gyrocal simulate trmm /tmp/rec --truth /tmp/truth.json
      gyrocal simulate trmm /tmp/gap --effect bias_orbital:y=0.2 --effect g_matrix_step:z=1300,toward=y,time_s=15000
      gyrocal simulate /tmp/rec /tmp/again --effect time_offset=0.5
      gyrocal simulate adopted.toml /tmp/flown --seed 3 --draw
      gyrocal simulate trmm_months /tmp/months --effect dss_head:2=0.28
      gyrocal simulate trmm /tmp/mine --effects mine.py --effect my_effect:z=0.5
      gyrocal simulate trmm_series /tmp/seven --seed 7 --set gyro.arw_deg_per_sqrt_s=1e-4 --set interval.1.slew.0.start_s=120
    """
    refuse_existing(out, force)

    from simulator import adopted_scenario
    from simulator import scenario as scenarios
    from simulator.adopted_scenario import ReplayPlan
    from simulator.effects.sensor import parse, tabulate_setting
    from simulator.simulate import simulate
    from simulator.streams import generator

    settings = [parse(text) for text in effects]
    noise = not noise_free
    if (Path(scenario) / "recording.toml").exists() and scenario not in scenarios.names():
        _refuse(changes, draw)
        recording, parameters = _replay(scenario, settings, seed, case, noise)
        G, bias_deg_s = parameters.G.tolist(), np.rad2deg(parameters.bias).tolist()
    else:
        adopted = adopted_scenario.load(scenario)
        stated = adopted.effects
        if draw:
            stated = adopted.replace_amplitudes(adopted.draw_amplitudes(generator(seed, case, "posterior")))
        settings = [*stated, *settings]
        if isinstance(adopted.plan, ReplayPlan):
            _refuse(changes)
            recording = adopted.fly(seed, case, settings, noise)
            G, bias_deg_s = adopted.plan.G.tolist(), np.rad2deg(adopted.plan.bias).tolist()
        else:
            plan = scenarios.override(adopted.plan, dict(parse_assignment(change) for change in changes))
            recording = simulate(plan, seed=seed, case=case, noise=noise, effects=settings)
            G, bias_deg_s = plan.gyro.true_G, plan.gyro.true_bias_deg_s
    save(recording, out)
    if truth:
        write_json(truth, {"G": G, "bias_deg_s": bias_deg_s, "effects": [tabulate_setting(setting) for setting in settings]})
    if as_json:
        counts = {"intervals": len(recording.intervals), "gyro_samples": recording.gyro.t_s.size}
        written_effects = [tabulate_setting(setting) for setting in settings]
        about = {"folder": str(out), "title": recording.title, "seed": seed, "case": case, "effects": written_effects}
        write_json(as_json, about | counts | {"reference_attitudes": recording.attitudes.t_s.size})
    click.echo(
        f"{out}: {len(recording.intervals)} intervals, {recording.gyro.t_s.size} gyro samples, "
        f"{recording.attitudes.t_s.size} reference attitudes"
    )


def _replay(folder: str, settings: list[Setting], seed: int, case: int, noise: bool) -> tuple[Recording, GyroParameters]:
    """Calibrate a recording and simulate its motion again with effects; returns the new recording and its true parameters."""
    from simulator.effects.sensor import SENSOR_EFFECTS
    from simulator.replay import replay

    on_sensors = [setting.effect for setting in settings if setting.effect in SENSOR_EFFECTS]
    if on_sensors:
        raise InputError(f"{on_sensors[0]}: acts on raw sensor tables, which a replay keeps as they are; give a scenario")
    original = load(folder)

    from gyrocal.calibration.davenport import calibrate

    parameters = calibrate(original).parameters
    return replay(original, parameters.G, parameters.bias, settings, seed=seed, case=case, noise=noise), parameters


def _refuse(changes: tuple[str, ...], draw: bool = False) -> None:
    """Raise `InputError` for options that a replay of a recording does not have."""
    if changes:
        raise InputError(f"--set {changes[0]}: a recording has no scenario to change; only --effect acts on a replay")
    if draw:
        raise InputError("--draw: a recording has no posterior to draw from; give the file of 'gyrocal diagnose --adopt'")
