"""The command line: ``gyrocal reproduce | calibrate | diagnose | compare | plan | simulate | mission | effects | study | …``.

A command is a module of its name in this package, loaded only when that command runs: numba and pandas take seconds to import,
which ``gyrocal --help`` avoids. Tables go to standard output, progress and errors to standard error. Bad input and wrong use
end in one line and exit status 2. Warnings are shown when the command has ended, and not after an error.
"""

import ast
import contextlib
import errno
import importlib
import logging
import os
import sys
import warnings
from collections.abc import Iterator
from difflib import get_close_matches
from keyword import iskeyword
from pathlib import Path
from typing import Any, NoReturn

import click

from studies.report.printable import make_printable

COMMAND_NAMES = (
    *("allan", "baseline", "calibrate", "compare", "diagnose", "effects", "export", "import", "mission"),
    *("plan", "predict", "reproduce", "scenarios", "simulate", "study"),
)


def _format_module_name(name: str) -> str:
    """Return the name of a command's module; a keyword of Python gets an underscore."""
    return f"{name}_" if iskeyword(name) else name


def read_help(name: str) -> str:
    """Read the help of a command from the source of its module, without loading it."""
    source = Path(__file__).with_name(f"{_format_module_name(name)}.py").read_text(encoding="utf-8")
    function = next(node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef) and node.name == "command")
    return ast.get_docstring(function) or ""


class Commands(click.Group):
    """The commands, each loaded when it is needed; errors of the project are one line and exit status 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List all names."""
        return sorted(COMMAND_NAMES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load the command of a name; None if there is none."""
        if cmd_name not in COMMAND_NAMES:
            return None
        command = importlib.import_module(f"studies.cli.{_format_module_name(cmd_name)}").command
        assert isinstance(command, click.Command)
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the first word names; for an unknown name suggest similar ones."""
        suggestions = [] if args[0] in COMMAND_NAMES else get_close_matches(args[0], COMMAND_NAMES)
        if suggestions:
            ctx.fail(f"No such command '{args[0]}'; did you mean {' or '.join(suggestions)}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands as click does, without loading them."""
        width = formatter.width - 6 - max(map(len, COMMAND_NAMES))
        rows = [(name, click.Command(name, help=read_help(name)).get_short_help_str(width)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the options before the command."""
        with _handle_user_errors(ctx):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        with _handle_user_errors(ctx), _show_warnings():
            return super().invoke(ctx)


@contextlib.contextmanager
def _handle_user_errors(ctx: click.Context) -> Iterator[None]:
    """End in one line after an error that is not a fault of the program."""
    try:
        yield
    except click.UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # of newer versions of click: the help itself
            raise
        command = (error.ctx or ctx).command_path
        _end(ctx, f"{error.format_message()} See '{command} --help'.", source=command)
    except MemoryError as error:
        _end(ctx, f"not enough memory: {error}" if str(error) else "not enough memory")
    except OSError as error:
        if error.errno == errno.EPIPE and error.filename is None:
            raise  # click ends quietly: the reader of the pipe has closed it
        _end(ctx, f"{os.fsdecode(error.filename or 'standard output or a file')}: {error.strerror or error}")
    except Exception as error:
        # The class is loaded if such an error was raised.
        errors = sys.modules.get("gyrocal.errors")
        if errors is None or not isinstance(error, errors.GyrocalError):
            raise
        text = str(error)
        if type(error).__name__ == "LargeResidualError":
            from gyrocal.importing import explain_refusal

            text = explain_refusal(error)
        _end(ctx, text, getattr(error, "exit_status", 2))


def _end(ctx: click.Context, message: str, status: int = 2, source: str = "gyrocal") -> NoReturn:
    """Print a message on standard error, and leave with an exit status."""
    click.echo(make_printable(f"{source}: {message}"), err=True)
    ctx.exit(status)


@contextlib.contextmanager
def _show_warnings() -> Iterator[None]:
    """Show warnings after success: the project's own in a line each, those of the packages it uses in one line."""
    with warnings.catch_warnings(record=True) as caught:
        yield
    own_messages = dict.fromkeys(str(warning.message) for warning in caught if warning.category is UserWarning)
    numeric = dict.fromkeys(str(warning.message) for warning in caught if warning.category is not UserWarning)
    lines = list(own_messages)
    if numeric:
        lines.append(f"while computing: {'; '.join(numeric)}; look whether the results can be meant")
    for line in lines:
        click.echo(make_printable(f"gyrocal: warning: {line}"), err=True)


class _StandardError(logging.Handler):
    """Show log messages on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Show one message."""
        click.echo(make_printable(f"gyrocal: {record.getMessage()}"), err=True)


@click.group("gyrocal", cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="gyrocal")
def main() -> None:
    """In-flight gyro calibration: simulate it, run it, validate it."""
    sys.stdout, sys.stderr = sys.stdout or _open_null_stream(), sys.stderr or _open_null_stream()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal that cannot show ψ shows ? instead of a traceback
            stream.reconfigure(errors="replace")
    compilation = logging.getLogger("gyrocal.jit_cache")
    compilation.handlers, compilation.level = [_StandardError()], logging.INFO


def _open_null_stream() -> Any:
    """Open a substitute for a stream that the shell has closed."""
    return open(os.devnull, "w", encoding="utf-8")  # open as long as the program runs
