"""Progress of commands that go through stages."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn


@contextmanager
def stages(command: str, every_s: float | None = None) -> Iterator[Callable[[str, float], None]]:
    """Show progress on standard error: a bar on a terminal; elsewhere a line every so many s, or for each stage.

    Yields a function that is told where the work is, "stage: detail", and which share of it is done.
    """
    output = Console(stderr=True)
    if output.is_terminal:
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        with Progress(*columns, console=output, transient=True) as bar:
            task = bar.add_task("", total=1.0)
            yield lambda text, share: bar.update(task, description=text, completed=share)
        return
    last, told = time.monotonic(), ""

    def tell(text: str, share: float) -> None:
        nonlocal last, told
        line = text if every_s is not None else text.split(":")[0]
        if line != told if every_s is None else time.monotonic() - last >= every_s:
            last, told = time.monotonic(), line
            output.print(f"{command}: {line}, {100 * share:.0f} % done", highlight=False, markup=False)

    yield tell
