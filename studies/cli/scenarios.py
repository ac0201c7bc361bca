"""The command ``gyrocal scenarios``: the built-in scenarios, listed or printed."""

import click

from simulator import scenario as scenarios


@click.command("scenarios")
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the built-in scenarios, or print one as TOML, to be copied and changed.

    \b
    Example:
      gyrocal scenarios trmm > mine.toml
    """
    click.echo(scenarios.text(name) if name else "\n".join(scenarios.names()))
