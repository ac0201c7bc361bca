"""Tests; the folders mirror those of the source."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared"  # recordings by an independent program and of real gyros; tests without them skip
