"""The command line, one file per command."""

from studies.cli.main import main

__all__ = ["main"]
