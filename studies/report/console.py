"""The terminal: the console for tables; progress with rate and, where it is known, time left; elsewhere one line a minute."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

import numpy as np
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.segment import Segment
from rich.text import Text

from studies.report.printable import CONTROL

LINE_EVERY_S = 60.0
MISSING = "\ufffd"
FEWEST_LOTS = 8  # before the time left is said
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


class Pace:
    """How long the rest will take, if that can be said within a factor of two.

    Of the times t_k that m lots of n_k pieces take, the mean per piece is r = Σt/Σn, and s² = Σ(t_k − r n_k)²/(m − 1) the
    variance of a lot's time. Of l lots more, the relative error of r is s/(√m n r), n being the mean lot, and that of what they
    scatter themselves s/(√l n r). Nothing is said unless both together are below a fifth, or while one half of the lots went
    twice as fast as the other. The first lot holds the start of the workers and is left out.
    """

    def __init__(self) -> None:
        self.lots: list[tuple[float, int]] = []
        self.last: float | None = None

    def tell(self, count: int, now: float) -> None:
        """So many more are done at a time, s."""
        if self.last is not None:
            self.lots.append((now - self.last, count))
        self.last = now

    def left_s(self, remaining: int) -> float | None:
        """Time for the remaining ones, s; None if it cannot be said."""
        if len(self.lots) < FEWEST_LOTS:
            return None
        time_s, count = np.array(self.lots, dtype=float).T
        each, lots = time_s.sum() / count.sum(), len(count)
        scatter = ((time_s - each * count) ** 2).sum() / (lots - 1)
        error = np.sqrt(scatter * (1 / lots + count.mean() / max(remaining, 1))) / count.mean()
        first, second = (time_s[half].sum() / count[half].sum() for half in (slice(lots // 2), slice(lots // 2, None)))
        known = each > 0 and error <= each / 5 and first <= 2 * second and second <= 2 * first
        return float(remaining * each) if known else None


class _Left(ProgressColumn):
    """Time left, while it can be said."""

    def __init__(self, pace: Pace) -> None:
        super().__init__()
        self.pace = pace

    def render(self, task: Task) -> Text:
        """Text of the column."""
        left = self.pace.left_s(int(task.remaining or 0))
        return Text("" if left is None else f"{timedelta(seconds=round(left))} left")


@contextmanager
def progress(label: str, total: int, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """Show progress on standard error, as a bar on a terminal, elsewhere as a line a minute.

    Yields a function that is told how many more are done.
    """
    output, pace = Console(stderr=True, quiet=quiet), Pace()
    if output.is_terminal:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(),
            TimeElapsedColumn(),
            _Left(pace),
        )
        with Progress(*columns, console=output, transient=True) as bar:
            task = bar.add_task(label, total=total)

            def moved(count: int) -> None:
                pace.tell(count, time.monotonic())
                bar.advance(task, count)

            yield moved
        return
    start = last = time.monotonic()
    done = 0

    def advance(count: int) -> None:
        nonlocal last, done
        done += count
        now = time.monotonic()
        pace.tell(count, now)
        if now - last >= LINE_EVERY_S:
            last = now
            left = pace.left_s(total - done)
            rest = "" if left is None else f", {left:.0f} s left"
            output.print(f"{label}: {done}/{total}, {done / (now - start):.1f}/s{rest}", highlight=False)

    yield advance
