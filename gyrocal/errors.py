"""Errors a user can meet; the command line turns each into one line and exit status 2."""

from collections.abc import Iterable


def suggest_names(name: str, known: Iterable[str]) -> str:
    """Suggest known names for an unknown one: the nearest, or all of them."""
    from difflib import get_close_matches  # only when something is wrong

    names = list(known)
    similar = get_close_matches(name, names, n=3)
    return f"did you mean {' or '.join(similar)}?" if similar else f"there are {', '.join(names)}"


class GyrocalError(Exception):
    """Base of all errors that the input, not the program, is the cause of."""


class InputError(GyrocalError, ValueError):
    """A file or an argument cannot be used; the message says what, where and what to do."""


class UnobservableError(GyrocalError):
    """The data do not determine every solved-for parameter.

    Attributes
    ----------
    combinations : tuple of str
        The parameter combinations that the data leave free.
    """

    def __init__(self, message: str, combinations: tuple[str, ...]):
        super().__init__(message)
        self.combinations = combinations
