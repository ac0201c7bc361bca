"""What a reproduction gathers on its way: tables by name, and the summary they give."""

from dataclasses import dataclass, field
from typing import Any

import pandas as pd
from rich.console import Console

from studies.report import tables as render
from studies.report.tables import Table


@dataclass
class Products:
    """Tables by name, and the summary they give; the console is for the tables that are shown."""

    console: Console
    tables: dict[str, Table] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)

    def add(self, name: str, title: str, data: pd.DataFrame, **more: Any) -> pd.DataFrame:
        """Keep a table; what else it has is as of `Table`."""
        self.tables[name] = Table(title, data, **more)
        return data

    def show(self, *names: str) -> None:
        """Print tables."""
        for table in map(self.tables.__getitem__, names):
            render.terminal(self.console, table.title, table.for_people(), table.note, table.formats)
