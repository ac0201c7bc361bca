"""What the docs show to be typed, in its order: blocks of the pages, and the examples of every ``--help``."""

import re

import click

from studies.cli.main import main
from tests import ROOT

PAGES = ("README.md", "CONTRIBUTING.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")))
FENCE = re.compile(r"^```(\S*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"(\.venv/bin/)?(gyrocal|pip|python|make|pre-commit) ")


def blocks(page, language):
    """The fences of a page in a language."""
    return [body for name, body in FENCE.findall((ROOT / page).read_text(encoding="utf-8")) if name == language]


def list_steps(page):
    """Lines of shell and whole blocks of Python; a fence without a language may show what a command answers, too."""
    for name, body in FENCE.findall((ROOT / page).read_text(encoding="utf-8")):
        if name == "python":
            yield name, body
        elif name in ("", "sh"):
            yield from (("sh", line) for line in _split_lines(body) if name == "sh" or COMMAND.match(line))


def list_examples(command=main, name="gyrocal"):
    """The examples of a command and of those below it, by its name."""
    found = {}
    if example := re.search(r"Examples?:\n(.*)", command.help or "", flags=re.DOTALL):
        found[f"{name} --help"] = [("sh", line) for line in _split_lines(example[1])]
    if isinstance(command, click.Group):
        context = click.Context(command)
        for one in command.list_commands(context):
            found |= list_examples(command.get_command(context, one), f"{name} {one}")
    return found


def _split_lines(body):
    """Lines without those that are continued, comments or empty."""
    lines = re.sub(r"\\\n\s*", "", body).splitlines()
    return [text for line in lines if (text := re.sub(r"(?<=\s)#.*", "", line).strip())]
