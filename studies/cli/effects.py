"""The command ``gyrocal effects``: errors of gyros, references and sensors that the baseline does not have."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from studies.cli.options import add_json_option, effects_option
from studies.montecarlo.files import write_json
from studies.report.console import make_console

if TYPE_CHECKING:
    from simulator.effects import Effect


@click.command("effects")
@effects_option
@add_json_option("the list")
def command(as_json: Path | None) -> None:
    """List the effects: errors of a gyro or a reference that the baseline simulator does not have.

    A positive size makes the gyro read high.

    A parameter that is listed without a value has no default and must be given. Effects of the sensors
    (dss_…, esa_…) need a scenario with [sensors], such as trmm_months; where they have several angles, the size is their norm
    and the angles say the direction.

    \b
    Example:
      gyrocal effects
    """
    import pandas as pd

    from simulator.effects.sensor import ALL_EFFECTS
    from studies.report import tables as render

    rows = [
        {
            "effect": effect.name,
            "what": effect.summary if effect.is_nameable else f"{effect.summary} (simulated only, never named as a cause)",
            "unit": effect.unit,
            "axis": ", ".join(effect.axes) + (" or all" if effect.axis_optional else ""),
            "parameters": _format_parameters(effect),
            "plausible": f"{effect.prior[0]:g} to {effect.prior[1]:g}",
        }
        for effect in ALL_EFFECTS.values()
    ]
    render.print_table(make_console(), "Effects", pd.DataFrame(rows))
    if as_json:
        write_json(as_json, {"effects": rows})


def _format_parameters(effect: Effect) -> str:
    """Format an effect's parameters with defaults, or "=…" for each if they are many; those without must be given."""
    texts = [
        parameter.name if parameter.default is None else f"{parameter.name}={parameter.default}"
        for parameter in effect.parameters
    ]
    if len(texts) <= 2:
        return ", ".join(texts)
    names = [text.partition("=")[0] + "=…" * ("=" in text) for text in texts]
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} to {names[-1]}"
