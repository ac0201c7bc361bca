"""The option ``--effects FILE.py`` of several commands: effects of one's own beside the built-in ones."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from simulator.effects import REGISTRY

PATH = click.Path(path_type=Path)


def effects_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the option; the effects are registered before it runs, and taken out again after it."""
    return click.option(
        "--effects",
        "effect_files",
        multiple=True,
        type=PATH,
        metavar="FILE.py",
        expose_value=False,
        is_eager=True,  # before options that name one of these effects
        callback=_registered,
        help="Python file with effects of your own, see docs/extending.md; repeatable.",
    )(command)


def _registered(context: click.Context, option: click.Parameter, files: tuple[Path, ...]) -> None:
    for path in files:
        for effect in REGISTRY.load_file(path):
            context.call_on_close(lambda name=effect.name: REGISTRY.remove(name))
