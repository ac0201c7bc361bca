"""Every option that a message of an import names exists in each command that can print the message."""

import ast
import re

import pytest

from studies.cli.main import main
from tests import ROOT

TABLES = ("import csv", "import aem", "import ck")  # commands that read a gyro's table whose columns are stated
IMPORTS = (*TABLES, "import euroc", "import bag")  # all that share the streams and the alignment
# Modules whose messages not every import prints.
OWN_COMMANDS = {
    "ck": ("import ck",),
    "column_mapping": TABLES,
    "__init__": ("allan",),
    "gyro_join": TABLES,
    "gyro_samples": (*TABLES, "allan"),  # euroc and bag hand over the columns of the rates alone, see below
    "units": TABLES,  # of the unit of a column, or of counts
    "rosbag": ("import bag",),
}
ONLY = {"--quat": ("import csv",)}  # the attitudes of the others have their form


def list_messages():
    """Module and text of every string that is no docstring."""
    for folder in ("importing", "recording"):
        for path in sorted((ROOT / "gyrocal" / folder).glob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            documented = {id(one.value) for one in ast.walk(tree) if isinstance(one, ast.Expr)}
            for one in ast.walk(tree):
                if isinstance(one, ast.Constant) and isinstance(one.value, str) and id(one) not in documented:
                    yield path.stem, one.value


def list_options():
    """Command and option of every message."""
    for module, text in list_messages():
        for match in re.finditer(r"--[a-z][a-z-]*", text):
            elsewhere = re.findall(r"gyrocal (import \w+|\w+) ", text[: match.start()])
            default = ONLY.get(match.group(), OWN_COMMANDS.get(module, IMPORTS))
            for command in elsewhere[-1:] or default:
                yield module, command, match.group()


def find_options(words):
    command = main
    for word in words.split():
        command = command.get_command(None, word)
    return {name for one in command.params for name in one.opts}


@pytest.mark.parametrize(("module", "command", "option"), sorted(set(list_options())))
def test_an_option_that_a_message_names_exists(module, command, option):
    assert option in find_options(command), f"{module} names {option}, which {command} does not have"
