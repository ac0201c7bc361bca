"""The command line: ``gyrocal reproduce | calibrate | diagnose | plan | simulate | mission | effects | import | study | …``.

Tables go to standard output, progress and errors to standard error. Bad input ends in one line and exit status 2.
"""

import json
import sys
import tomllib
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd

from gyrocal import GyrocalError, GyroParameters, InputError, calibrate, load, save, select
from gyrocal.calibration.observability import PLAUSIBLE_G
from gyrocal.recording import toml_value
from simulator import scenario as scenarios
from simulator.effects import Effect
from simulator.effects.sensor import ALL_EFFECTS, SENSOR_EFFECTS, described
from simulator.effects.sensor import parse as parse_effect
from simulator.replay import replay
from simulator.simulate import simulate
from studies import catalogue
from studies.cli import diagnose as cli_diagnose
from studies.cli import import_ as cli_import
from studies.cli import mission as cli_mission
from studies.cli import plan as cli_plan
from studies.cli import reproduce as cli_reproduce
from studies.cli.effect_files import effects_option
from studies.montecarlo import engine
from studies.montecarlo.manifest import write_json
from studies.report import calibration as calibration_report
from studies.report import tables as render
from studies.report.console import check_writable, console
from studies.validation import baseline

PATH = click.Path(path_type=Path)


class _Group(click.Group):
    """Turns the project's errors into one line and exit status 2."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _warn
                return super().invoke(ctx)
        except engine.Interrupted as stop:
            click.echo(f"gyrocal: {stop}", err=True)
            ctx.exit(130)
        except GyrocalError as error:
            click.echo(f"gyrocal: {' '.join(str(error).split())}", err=True)
            ctx.exit(2)
        except OSError as error:
            click.echo(f"gyrocal: {error.filename or 'file'}: {error.strerror or error}", err=True)
            ctx.exit(2)


def _warn(message: Warning | str, *where: Any, **options: Any) -> None:
    """A warning as one line."""
    click.echo(f"gyrocal: warning: {' '.join(str(message).split())}", err=True)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="gyrocal")
def main() -> None:
    """In-flight gyro calibration: simulate it, run it, validate it."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal that cannot show ψ shows ? instead of a traceback
            stream.reconfigure(errors="replace")


@main.command("scenarios")
@click.argument("name", required=False)
def scenarios_command(name: str | None) -> None:
    """List the built-in scenarios, or print one as TOML, to be copied and changed.

    \b
    Example:
      gyrocal scenarios trmm > mine.toml
    """
    click.echo(scenarios.text(name) if name else "\n".join(scenarios.names()))


@main.command("simulate")
@click.argument("scenario")
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Root of the random streams.")
@click.option("--case", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True, help="Case number under that seed.")
@click.option("--noise-free", is_flag=True, help="Neither gyro nor reference noise.")
@click.option("--set", "changes", multiple=True, metavar="PATH=VALUE", help="Override a value of the scenario; repeatable.")
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME:AXIS=SIZE[,KEY=VALUE…]",
    help="Something that the baseline does not do, see 'gyrocal effects'; repeatable.",
)
@effects_option
@click.option("--truth", type=PATH, help="Also write the injected G, bias and effects as JSON to this file.")
@click.option("--force", is_flag=True, help="Replace a recording that is in OUT already.")
def simulate_command(
    scenario: str,
    out: Path,
    seed: int,
    case: int,
    noise_free: bool,
    changes: tuple[str, ...],
    effects: tuple[str, ...],
    truth: Path | None,
    force: bool,
) -> None:
    """Simulate SCENARIO (a built-in name or a TOML file) and write the recording to the folder OUT.

    Lists in a path count from zero: interval.1 is the second interval.

    SCENARIO may also be the folder of a recording. It is calibrated, and its motion simulated again with that calibration as
    truth: same sample tags, reference times, noise as stated and housekeeping.

    \b
    Examples:
      gyrocal simulate trmm /tmp/rec --truth /tmp/truth.json
      gyrocal simulate trmm /tmp/gap --effect bias_orbital:y=0.2 --effect g_matrix_step:z=1300,toward=y,time_s=15000
      gyrocal simulate /tmp/rec /tmp/again --effect time_offset=0.5
      gyrocal simulate trmm_months /tmp/months --effect dss_head:2=0.28
      gyrocal simulate trmm /tmp/mine --effects mine.py --effect my_effect:z=0.5
      gyrocal simulate trmm_series /tmp/rec --seed 7 --set gyro.arw_deg_per_sqrt_s=1e-4 --set interval.1.slew.0.start_s=120
    """
    if (out / "recording.toml").exists() and not force:
        raise InputError(f"{out}: a recording is there already; choose another folder, or replace it with --force")
    settings = [parse_effect(text) for text in effects]
    check_writable(truth)
    noise = not noise_free
    if (Path(scenario) / "recording.toml").exists() and scenario not in scenarios.names():
        if changes:
            raise InputError(f"--set {changes[0]}: a recording has no scenario to change; only --effect acts on a replay")
        on_sensors = [one.effect for one in settings if one.effect in SENSOR_EFFECTS]
        if on_sensors:
            raise InputError(f"{on_sensors[0]}: acts on raw sensor tables, which a replay keeps as they are; give a scenario")
        original = load(scenario)
        fitted = calibrate(original).parameters
        recording = replay(original, fitted.G, fitted.bias, settings, seed=seed, case=case, noise=noise)
        G, bias_deg_s = fitted.G.tolist(), np.rad2deg(fitted.bias).tolist()
    else:
        chosen = scenarios.load(scenario)
        if changes:
            chosen = scenarios.override(chosen, dict(_assignment(change) for change in changes))
        recording = simulate(chosen, seed=seed, case=case, noise=noise, effects=settings)
        G, bias_deg_s = chosen.gyro.true_G, chosen.gyro.true_bias_deg_s
    save(recording, out)
    if truth:
        write_json(truth, {"G": G, "bias_deg_s": bias_deg_s, "effects": [described(setting) for setting in settings]})
    click.echo(
        f"{out}: {len(recording.intervals)} intervals, {recording.gyro.t_s.size} gyro samples, "
        f"{recording.attitudes.t_s.size} reference attitudes"
    )


main.add_command(cli_import.import_group)
main.add_command(cli_diagnose.diagnose_command)
main.add_command(cli_plan.plan_command)
main.add_command(cli_mission.mission_command)
main.add_command(cli_reproduce.reproduce_command)


def _parameters(effect: Effect) -> str:
    """An effect's parameters with their defaults, or that they have one; without "=" those that must be given."""
    shown = [one.name if one.default is None else f"{one.name}={one.default}" for one in effect.parameters]
    if len(shown) <= 2:
        return ", ".join(shown)
    names = [one.name if one.default is None else f"{one.name}=…" for one in effect.parameters]
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} to {names[-1]}"


@main.command("effects")
@effects_option
@click.option("--json", "as_json", type=PATH, help="Write the list as JSON to this file.")
def effects_command(as_json: Path | None) -> None:
    """List what a gyro, a reference or an attitude sensor can do beyond the baseline; a positive size makes the gyro read high.

    A parameter without "=" must be given. Effects of the sensors (dss_…, esa_…) need a scenario with [sensors], such as
    trmm_months; where they have several angles, the size is their norm and the angles say the direction.

    \b
    Example:
      gyrocal effects
    """
    check_writable(as_json)
    rows = [
        {
            "effect": effect.name,
            "unit": effect.unit,
            "axis": ", ".join(effect.axes) + (" or all" if effect.axis_optional else ""),
            "parameters": _parameters(effect),
            "plausible": f"{effect.prior[0]:g} to {effect.prior[1]:g}",
            "what": effect.summary,
        }
        for effect in ALL_EFFECTS.values()
    ]
    render.terminal(console(), "Effects", pd.DataFrame(rows))
    if as_json:
        write_json(as_json, {"effects": rows})


@main.command("calibrate")
@click.argument("recording", type=PATH)
@click.option("--json", "as_json", type=PATH, help="Write the result as JSON to this file.")
@click.option("--truth", type=PATH, help="Injected G and bias_deg_s as JSON: show the errors.")
@click.option(
    "--psi", type=click.Choice(["full", "linear"]), default="full", show_default=True, help="Error sensitivity, N (11)."
)
@click.option("--iterations", type=click.IntRange(1), default=None, help="Exactly so many; to the tolerance by default.")
@click.option(
    "--solve-for",
    default="all",
    show_default=True,
    help="Parameters (G_xx … b_z) or groups (all, bias, scale, misalignment, gyro_x: row x of G with b_x), comma separated; "
    "'-' takes out: 'all,-misalignment'.",
)
@click.option("--step", "step_s", type=float, default=None, help="Propagation step in s, a multiple of the sample.")
@click.option(
    "--resampling", type=click.Choice(["skip", "average"]), default="average", show_default=True, help="How a step is made."
)
@click.option(
    "--covariance",
    type=click.Choice(["full", "references-only"]),
    default="full",
    show_default=True,
    help="With gyro noise and shared references, or the paper's C.",
)
@click.option("--prior-sigma-g", type=float, default=None, help="A-priori 1-sigma of each element of G.")
@click.option("--prior-sigma-bias", type=float, default=None, help="A-priori 1-sigma of each bias, deg/s.")
@click.option("--plausible-g", type=float, default=PLAUSIBLE_G, show_default=True, help="How far G may plausibly be off.")
@click.option("--plausible-bias", type=float, default=10.0, show_default=True, help="How far b may plausibly be off, deg/h.")
@click.option(
    "--max-gap", "max_gap_s", type=float, default=None, help="Hold the last rate over up to so many s of missing samples."
)
def calibrate_command(
    recording: Path,
    as_json: Path | None,
    truth: Path | None,
    covariance: str,
    prior_sigma_g: float | None,
    prior_sigma_bias: float | None,
    plausible_g: float,
    plausible_bias: float,
    solve_for: str,
    **options: Any,
) -> None:
    """Calibrate the gyro of RECORDING, a folder with recording.toml, gyro and attitude tables.

    \b
    Example:
      gyrocal simulate trmm /tmp/rec --truth /tmp/truth.json
      gyrocal calibrate /tmp/rec --truth /tmp/truth.json --json /tmp/result.json
    """
    check_writable(as_json)
    known = _read_truth(truth) if truth else None
    result = calibrate(
        load(recording),
        solve_for=solve_for,
        apriori_covariance=_prior(select(solve_for), prior_sigma_g, prior_sigma_bias),
        covariance_model="full" if covariance == "full" else "references only",
        plausible_G=plausible_g,
        plausible_bias=float(np.deg2rad(plausible_bias / 3600)),
        **options,
    )
    calibration_report.show(console(), result, options["iterations"] is None, known)
    if as_json:
        write_json(as_json, result.to_json())


@main.command("baseline")
@click.option("--write", "regenerate", is_flag=True, help="Replace the stored baseline.")
@click.option(
    "--file", "path", type=click.Path(path_type=Path), default=None, help="The baseline; results/baseline/recovered.csv."
)
def baseline_command(regenerate: bool, path: Path | None) -> None:
    """Recompute the baseline of recovered parameters and show what moved; exit status 1 if something did.

    \b
    Example:
      gyrocal baseline --write
    """
    path = path or baseline.default_path()
    new = baseline.recovered()
    if path.exists():
        table = baseline.moved(baseline.read(path), new)
        if table.empty:
            click.echo(f"{path}: nothing moved by more than {baseline.RTOL:g} of itself")
        else:
            render.terminal(
                console(), f"{len(table)} values moved by more than {baseline.RTOL:g} of themselves", table.head(40)
            )
    elif not regenerate:
        raise InputError(f"{path}: no baseline there; run in the project's folder, or write one with --write")
    if regenerate:
        baseline.write(new, path)
        click.echo(f"{path}: written")
    elif not table.empty:
        raise SystemExit(1)


@main.command("study")
@click.argument("name", required=False)
@click.option(
    "--out", type=PATH, default=None, help="Folder to write; results/studies/NAME by default. An unfinished study resumes."
)
@click.option("--config", type=PATH, default=None, help="Settings as TOML.")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="One setting by its dotted path; repeatable.")
@click.option("--cases", type=click.IntRange(1), default=None, help="Number of cases; the study's own by default.")
@click.option("--entropy", type=click.IntRange(0), default=None, help="Root of all random streams.")
@click.option("--backend", type=click.Choice(["serial", "threads", "loky", "dask"]), default="loky", show_default=True)
@click.option("--jobs", type=click.IntRange(1), default=None, help="Workers; the CPU count by default.")
@click.option("--scheduler", default=None, help="Address of a dask scheduler, with --backend dask.")
@click.option("--rerun", "again", type=click.IntRange(0), default=None, help="Repeat this one case and keep its recording.")
@click.option("--keep", multiple=True, type=click.IntRange(0), help="Keep the recording of this case; repeatable.")
@click.option("--retry-failed", is_flag=True, help="Run failed cases of an earlier run again.")
@click.option("--json", "as_json", type=PATH, help="Write counts and failures as JSON; what was found is in the report.")
def study_command(
    name: str | None,
    out: Path | None,
    config: Path | None,
    changes: tuple[str, ...],
    cases: int | None,
    entropy: int | None,
    again: int | None,
    as_json: Path | None,
    **options: Any,
) -> None:
    """Run the study NAME; without a name, list the studies.

    Rows do not depend on backend or jobs. Ctrl-C stops cleanly, and the same command goes on where it stopped.

    \b
    Examples:
      gyrocal study
      gyrocal study psi --set 'steps_s=[0.5,2.0]' --out /tmp/psi
      gyrocal study paper --cases 1000 --set overrides.gyro.arw_deg_per_sqrt_s=1e-4
      gyrocal study paper --rerun 17
    """
    if name is None:
        table = pd.DataFrame([{"study": key, "what": catalogue.entry(key).summary} for key in catalogue.MODULES])
        render.terminal(console(), "Studies", table)
        return
    check_writable(as_json)
    folder = out or Path("results") / "studies" / name
    settings = dict(_assignment(change) for change in changes)
    settings |= {key: value for key, value in (("cases", cases), ("entropy", entropy)) if value is not None}
    if again is not None:
        _show_rerun(catalogue.rerun(name, folder, settings, again, config), folder)
        return
    terminal = console()
    outcome = catalogue.run(name, folder, settings, terminal, config, catalogue.Where(**options))
    terminal.print(outcome.summary(), highlight=False, markup=False)
    for message, count in outcome.warnings.items():
        click.echo(f"gyrocal: warning, {count} times: {message}", err=True)
    if as_json:
        failures = {str(case): error for case, error in outcome.failures.items()}
        write_json(as_json, {"study": name, "folder": str(folder), "cases": outcome.cases, "failures": failures})


def _show_rerun(result: engine.Rerun, folder: Path) -> None:
    render.terminal(console(), "Rows of the case", result.rows.T.reset_index().astype(str))
    if result.traceback:
        click.echo(result.traceback, err=True)
    if result.recording:
        click.echo(f"Its recording is in {result.recording}")
    if result.same is not None:
        click.echo(f"The rows are {'those' if result.same else 'NOT those'} of the study in {folder}, bit for bit.")


def _assignment(text: str) -> tuple[str, Any]:
    path, separator, value = text.partition("=")
    if not separator or not path:
        raise InputError(f"--set {text}: give it as PATH=VALUE, e.g. gyro.arw_deg_per_sqrt_s=1e-4")
    try:
        return path, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return path, tomllib.loads(f"value = {toml_value(value)}")["value"]  # a bare word is text


def _prior(names: tuple[str, ...], sigma_G: float | None, sigma_bias: float | None) -> np.ndarray | None:
    if sigma_G is None and sigma_bias is None:
        return None
    if sigma_G is None or sigma_bias is None:
        raise InputError("give both --prior-sigma-g and --prior-sigma-bias, or neither")
    if not (1e-15 < sigma_G < 1e6 and 1e-15 < sigma_bias < 1e6):
        raise InputError("--prior-sigma-g and --prior-sigma-bias must be positive and below 1e6")
    return np.diag([(sigma_G if name.startswith("G") else np.deg2rad(sigma_bias)) ** 2 for name in names])


def _read_truth(path: Path) -> GyroParameters:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return GyroParameters(np.array(document["G"], dtype=float), np.deg2rad(np.array(document["bias_deg_s"], dtype=float)))
    except (KeyError, TypeError, ValueError) as fault:
        raise InputError(f"{path}: not a truth file with G and bias_deg_s: {fault}") from None
