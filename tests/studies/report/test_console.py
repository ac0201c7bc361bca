import io

from rich.console import Console

from studies.report import console


def test_a_line_a_minute_elsewhere(monkeypatch):
    written, now = io.StringIO(), [0.0]
    monkeypatch.setattr(console, "Console", lambda **options: Console(file=written, force_terminal=False, width=120))
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.show_progress("cases", 100) as advance:
        for now[0] in (30.0, 61.0, 90.0):
            advance(10)
    assert written.getvalue().splitlines() == ["cases: 20/100, 0.3/s, 248 s left"]
