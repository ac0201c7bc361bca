"""The terminal: the console for tables; progress with rate and time left, and one line a minute where there is no terminal."""

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
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.text import Text

from studies.report.printable import CONTROL

LINE_EVERY_S = 60.0
MISSING = "\ufffd"
WIDTH = 200  # without a terminal there is none to fold tables to: wide enough for the widest


class _Printable(Console):
    """A console that shows the control characters of a text as one that is missing: in a file's words they are not meant."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """The pieces of what is printed, before the console adds what it says to the terminal itself."""
        for piece in super().render(renderable, options):
            lines = (CONTROL.sub(MISSING, line) for line in piece.text.split("\n"))
            yield piece if piece.control else piece._replace(text="\n".join(lines))


def console() -> Console:
    """Standard output, for tables."""
    terminal = sys.stdout.isatty()
    return _Printable(width=None if terminal else WIDTH, soft_wrap=not terminal)


class _Rate(ProgressColumn):
    """How many a second."""

    def render(self, task: Task) -> Text:
        """Text of the column."""
        return Text(f"{task.speed:.1f}/s" if task.speed else "")


@contextmanager
def progress(label: str, total: int, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """Show progress on standard error, as a bar on a terminal, elsewhere as a line a minute.

    Yields a function that is told how many more are done.
    """
    output = Console(stderr=True, quiet=quiet)
    if output.is_terminal:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=output, transient=True) as bar:
            task = bar.add_task(label, total=total)
            yield lambda count: bar.advance(task, count)
        return
    start = last = time.monotonic()
    done = 0

    def advance(count: int) -> None:
        nonlocal last, done
        done += count
        now = time.monotonic()
        if now - last >= LINE_EVERY_S:
            last = now
            rate = done / (now - start)
            output.print(f"{label}: {done}/{total}, {rate:.1f}/s, {(total - done) / rate:.0f} s left", highlight=False)

    yield advance
