"""The terminal: the console for tables; progress with rate and time left, or by stages; elsewhere one line a minute."""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.text import Text

from studies.report.printable import CONTROL_CHARACTERS

LINE_EVERY_S = 60.0
MISSING = "\ufffd"
TERMINAL_WIDTH = 200  # without a terminal there is none to fold tables to: wide enough for the widest


class _PrintableConsole(Console):
    """A console that replaces control characters, which come from files and are not meant for the terminal."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Render the segments of a text, without control characters, before the console adds its own."""
        for piece in super().render(renderable, options):
            lines = (CONTROL_CHARACTERS.sub(MISSING, line) for line in piece.text.split("\n"))
            yield piece if piece.control else piece._replace(text="\n".join(lines))


def make_console() -> Console:
    """Make the console of standard output, for tables."""
    terminal = sys.stdout.isatty()
    return _PrintableConsole(width=None if terminal else TERMINAL_WIDTH, soft_wrap=not terminal)


class _Rate(ProgressColumn):
    """How many a second."""

    def render(self, task: Task) -> Text:
        """Render the text of the column."""
        return Text(f"{task.speed:.1f}/s" if task.speed else "")


@contextmanager
def show_progress(label: str, total: int, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """Show progress on standard error, as a bar on a terminal, elsewhere as a line a minute.

    Yields a function that takes the number of further items done.
    """
    output = Console(stderr=True, quiet=quiet)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Rate())
    last_time = time.monotonic()
    bar = Progress(
        *columns,
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=output,
        transient=True,
        disable=not output.is_terminal,
        get_time=time.monotonic,
        speed_estimate_period=10 * LINE_EVERY_S,
    )
    with bar:
        task = bar.add_task(label, total=total)

        def advance(count: int) -> None:
            nonlocal last_time
            bar.advance(task, count)
            if output.is_terminal or time.monotonic() - last_time < LINE_EVERY_S:
                return
            last_time, state = time.monotonic(), bar.tasks[0]
            remaining = "" if state.time_remaining is None else f", {state.time_remaining:.0f} s left"
            rate = state.completed / (state.elapsed or math.inf)
            output.print(f"{label}: {state.completed:.0f}/{total}, {rate:.1f}/s{remaining}", highlight=False)

        yield advance


@contextmanager
def show_stages(command: str, every_s: float | None = None) -> Iterator[Callable[[str, float], None]]:
    """Show the stages of a command on standard error: a bar on a terminal; elsewhere a line each `every_s`, or for each stage.

    Yields a function that takes the present stage as "stage: detail", and the share of the work that is done.
    """
    output = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    last_time, last_line = time.monotonic(), ""
    with Progress(*columns, console=output, transient=True, disable=not output.is_terminal) as bar:
        task = bar.add_task("", total=1.0)

        def report_stage(text: str, fraction: float) -> None:
            nonlocal last_time, last_line
            bar.update(task, description=text, completed=fraction)
            line = text if every_s is not None else text.split(":")[0]
            is_due = line != last_line if every_s is None else time.monotonic() - last_time >= every_s
            if is_due and not output.is_terminal:
                last_time, last_line = time.monotonic(), line
                output.print(f"{command}: {line}, {100 * fraction:.0f} % done", highlight=False, markup=False)

        yield report_stage
