"""What a recording or a calibration looks like on a screen."""

import html

MOST_REPR_LINES = 15  # of a repr, at most


def format_text(name: str, rows: list[tuple[str, str]]) -> str:
    """A repr: a line for each fact."""
    width = max(len(label) for label, _ in rows)
    return "\n".join(
        [name, *(f"  {label:<{width}}  {' '.join(value.split())[:100]}" for label, value in rows)][:MOST_REPR_LINES]
    )


def format_html(name: str, rows: list[tuple[str, str]]) -> str:
    """The same as a table of HTML."""
    cells = "".join(f"<tr><th>{html.escape(label)}</th><td>{html.escape(value)}</td></tr>" for label, value in rows)
    return f"<table><caption>{html.escape(name)}</caption>{cells}</table>"
