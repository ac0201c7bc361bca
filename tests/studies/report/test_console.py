import io
import re
from itertools import count

import numpy as np
import pytest
from rich.console import Console

from studies.report import console


def test_a_bar_on_a_terminal(monkeypatch):
    written = io.StringIO()
    clock = count(0.0, 0.5)
    terminal = Console(file=written, force_terminal=True, width=120, get_time=lambda: next(clock))
    monkeypatch.setattr(console, "Console", lambda **options: terminal)
    with console.progress("cases", 3) as advance:
        for _ in range(3):
            advance(1)
    assert "3/3" in written.getvalue()
    assert re.search(r"\d\.\d/s", written.getvalue())


def test_a_line_a_minute_elsewhere(monkeypatch):
    written = io.StringIO()
    clock = iter([0.0, 30.0, 61.0, 90.0])
    monkeypatch.setattr(console, "Console", lambda **options: Console(file=written, force_terminal=False, width=120))
    monkeypatch.setattr(console.time, "monotonic", lambda: next(clock))
    with console.progress("cases", 100) as advance:
        for _ in range(3):
            advance(10)
    # Two lots: the time left is not known.
    assert written.getvalue().splitlines() == ["cases: 20/100, 0.3/s"]


def lots(durations, size=10):
    """A pace that was told of lots of so many pieces, each of these durations, and the time it says for as many again."""
    pace, now = console.Pace(), 100.0
    pace.tell(size, now)
    for duration in durations:
        now += duration
        pace.tell(size, now)
    return pace.left_s(size * len(durations))


def test_the_time_left_of_a_steady_pace():
    assert lots([2.0] * 9) == pytest.approx(18.0)


@pytest.mark.parametrize(
    "durations",
    [
        [2.0] * 3,  # too few
        [0.1, 30.0, 0.1, 0.2, 40.0, 0.1, 0.1, 0.1, 50.0, 0.1],  # too uneven
        [1.0] * 8 + [5.0] * 8,  # ever slower
        [0.0] * 9,
    ],
)
def test_the_time_left_is_not_said_where_it_is_not_known(durations):
    assert lots(durations) is None


@pytest.mark.parametrize(("sigma", "least", "most"), [(0.3, 0.5, 1.0), (0.7, 0.2, 0.6), (1.5, 0.0, 0.01)])
def test_the_time_left_is_right_within_a_factor_of_two_or_not_said(sigma, least, most):
    """Of lots with log-normal durations, asked after each one, with as many still to come."""
    rng = np.random.default_rng(1)
    asked, right, said = 0, 0, 0
    for _ in range(40):
        durations = rng.lognormal(sigma=sigma, size=80)
        for done in range(1, 40):
            left = lots(durations[:done])
            asked, said = asked + 1, said + (left is not None)
            right += left is not None and 0.5 < left / durations[done : 2 * done].sum() < 2
    assert least <= said / asked <= most
    assert right >= 0.95 * said
