"""What the docs show to be typed: blocks of the pages, and the examples of every ``--help``."""

import re

import click

from studies.cli.main import main
from tests import ROOT

PAGES = ("README.md", "CONTRIBUTING.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")))
FENCE = re.compile(r"^```(\S*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
EXAMPLE = re.compile(r"Examples?:\n(.*)", flags=re.DOTALL)
SHELL = ("", "sh")  # a fence without a language may show what a command answers


def blocks(page, language):
    """The fences of a page in a language."""
    return [body for name, body in FENCE.findall((ROOT / page).read_text(encoding="utf-8")) if name == language]


def shell(page):
    """The commands of a page, a line each."""
    bodies = [(name, body) for name, body in FENCE.findall((ROOT / page).read_text(encoding="utf-8")) if name in SHELL]
    return [line for name, body in bodies for line in _lines(body) if name == "sh" or _is_command(line)]


def helped(command=main, name="gyrocal"):
    """The examples of a command and of those below it, by its name."""
    found = {}
    example = EXAMPLE.search(command.help or "")
    if example:
        found[f"{name} --help"] = [line for line in _lines(example[1]) if line.strip()]
    if isinstance(command, click.Group):
        context = click.Context(command)
        for one in command.list_commands(context):
            found |= helped(command.get_command(context, one), f"{name} {one}")
    return found


def _lines(body):
    """Lines without those that are continued, comments or empty."""
    lines = re.sub(r"\\\n\s*", "", body).splitlines()
    return [text for line in lines if (text := re.sub(r"(?<=\s)#.*", "", line).strip())]


def _is_command(line):
    return re.match(r"(\.venv/bin/)?(gyrocal|pip|python|make|pre-commit) ", line) is not None
