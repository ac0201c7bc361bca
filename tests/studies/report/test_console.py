import io
import threading

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


def test_cases_that_run_long_are_named_with_their_age(monkeypatch):
    """Also while none ends, so that nothing advances."""
    written, looked = io.StringIO(), threading.Semaphore(0)
    monkeypatch.setattr(console, "Console", lambda **options: Console(file=written, force_terminal=False, width=200))
    monkeypatch.setattr(console, "WATCH_EVERY_S", 0.001)
    monkeypatch.setattr(console, "LINE_EVERY_S", 0.0)

    def running():
        looked.release()
        return {3: 5.0, 7: 700.0, 12: 59.0, 4: 9000.0, 5: 25.0}

    with console.show_progress("cases", 100, running=running):
        for _ in range(2):
            looked.acquire()
    told = "case 4 runs since 2.5 h, case 7 runs since 12 min, case 12 runs since 59 s and 1 more"
    assert written.getvalue().startswith(f"cases: 0/100, 0.0/s, {told}\n")
