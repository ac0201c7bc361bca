"""Free memory is given back, and what is in use stays as it is."""

import sys
from pathlib import Path

import numpy as np
import pytest

from diagnosis.memory import give_back

PIECE = 1 << 14  # bytes; small enough for the heap
COUNT = 8000


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_between_blocks_in_use_is_given_back():
    pieces = [np.full(PIECE // 8, float(number)) for number in range(COUNT)]
    kept = pieces[:: COUNT // 8]
    before = resident()
    del pieces
    if not give_back():
        pytest.skip("the C library has no malloc_trim")
    assert resident() < before - PIECE * COUNT // 2
    assert [piece[0] for piece in kept] == [float(number) for number in range(0, COUNT, COUNT // 8)]


def test_elsewhere_nothing_is_done(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    assert not give_back()
