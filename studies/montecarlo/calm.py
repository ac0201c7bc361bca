"""A calm process: what surrounds a case is the same wherever it runs.

BLAS has one thread, since with more a sum may be split otherwise and bits differ. Warnings are counted, neither shown nor
turned into errors by whatever filter the process has: a warning that is an error in one place would be a failed case there.

Both are settings of the whole process, while in one process several threads may run cases: the first to come in makes the
settings, the last to go out takes them back, and each thread counts its own warnings. OpenBLAS may not heed a limit that is
set in another than the main thread: who starts threads should be calm before.
"""

import sys
import threading
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from threadpoolctl import threadpool_limits

MOST_MESSAGES = 50  # different warnings that are kept apart
OTHER_MESSAGES = "further warnings"


class _Process:
    """The settings of this process, and who wants them."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.users = 0
        self.settings = ExitStack()
        self.modules = 0
        self.thread = threading.local()
        self.messages: Counter[str] = Counter()

    def enter(self, messages: Counter[str]) -> None:
        with self.lock:
            if not self.users:
                self.messages = messages
                self.settings.enter_context(warnings.catch_warnings())
                warnings.simplefilter("always")
                warnings.showwarning = self.count
            self.users += 1
            # Looking for BLAS takes milliseconds, and one more is there only after an import.
            if len(sys.modules) != self.modules:
                self.settings.enter_context(threadpool_limits(1))
                self.modules = len(sys.modules)

    def leave(self) -> None:
        with self.lock:
            self.users -= 1
            if not self.users:
                self.settings.close()
                self.modules = 0

    def count(self, message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        messages = getattr(self.thread, "messages", self.messages)
        text = f"{category.__name__}: {' '.join(str(message).split())}"
        messages[text if text in messages or len(messages) < MOST_MESSAGES else OTHER_MESSAGES] += 1


_process = _Process()


@contextmanager
def calm() -> Iterator[Counter[str]]:
    """Keep the process calm; nests, and may be used in several threads at a time.

    Yields
    ------
    how often each warning was given in this thread, and, of the outermost, in the threads that are not calm themselves
    """
    messages: Counter[str] = Counter()
    outer = getattr(_process.thread, "messages", None)
    _process.enter(messages)
    _process.thread.messages = messages
    try:
        yield messages
    finally:
        if outer is None:
            del _process.thread.messages
        else:
            _process.thread.messages = outer
        _process.leave()
