"""A small fault of the core: a text of a source, what it is replaced by, and which tests are asked first."""

import ast
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes
    ----------
    file : source, from the root of the tree
    breaks : what is wrong with it then, in words; no two of a file are the same
    old, new : a text that is there once, and what takes its place
    tests : files or tests that are asked first, those likely to see it before the others
    """

    file: str
    breaks: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """The file and what is broken in it."""
        return f"{self.file}: {self.breaks}"

    def put_into(self, root: Path) -> str:
        """The faulty source of a tree; nothing is written.

        Raises
        ------
        ValueError
            The text is not there, or not once, or what takes its place changes nothing or is no Python.
        """
        source = (root / self.file).read_text(encoding="utf-8")
        found = source.count(self.old)
        if found != 1:
            where = "is no longer there" if not found else f"is there {found} times"
            raise ValueError(f"{self.name}: the text {self.old!r} {where}; give the fault the text that the source has now")
        faulty = source.replace(self.old, self.new)
        try:
            same = ast.dump(ast.parse(faulty)) == ast.dump(ast.parse(source))
        except SyntaxError as error:
            raise ValueError(f"{self.name}: not Python: {error}") from None
        if same:
            raise ValueError(f"{self.name}: changes nothing")
        return faulty


def of(file: str, tests: str, faults: Iterable[tuple[str, str, str]]) -> list[Fault]:
    """Faults of one file, each by what it breaks, the old text and the new; the tests are separated by blanks."""
    return [Fault(file, breaks, old, new, tuple(tests.split())) for breaks, old, new in faults]
