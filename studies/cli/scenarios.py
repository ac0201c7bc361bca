"""The command ``gyrocal scenarios``: the built-in scenarios, listed or printed."""

from pathlib import Path

import click

from studies.cli.options import add_json_option
from studies.montecarlo.files import write_json


@click.command("scenarios")
@click.argument("name", required=False)
@add_json_option("names and titles, or the scenario of that name,")
def command(name: str | None, as_json: Path | None) -> None:
    """List the built-in scenarios, or print one as TOML, to be copied and changed.

    \b
    Example:
      gyrocal scenarios
      gyrocal scenarios trmm > mine.toml
    """
    from simulator import scenario as scenarios

    if name:
        click.echo(scenarios.read_text(name))
        if as_json:
            from simulator import adopted_scenario
            from simulator.effects import tabulate_setting

            flown = adopted_scenario.load(name)
            assert isinstance(flown.plan, scenarios.Scenario)  # none that is built in flies a recording again
            effects = {"effect": [tabulate_setting(effect) for effect in flown.effects]} if flown.effects else {}
            write_json(as_json, flown.plan.model_dump(mode="json") | effects)
        return
    titles = {key: str(scenarios.load_document(key).get("title", "")) for key in scenarios.names()}
    width = max(map(len, titles))
    click.echo("\n".join(f"{key:{width}}  {title}" for key, title in titles.items()))
    if as_json:
        write_json(as_json, {"scenarios": [{"name": key, "title": title} for key, title in titles.items()]})
