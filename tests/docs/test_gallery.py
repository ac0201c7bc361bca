"""Every example of the gallery runs and draws the picture that is shown."""

import re
import runpy
import sys

import pytest

from tests import ROOT

FOLDER = ROOT / "docs" / "examples"
OTHERS = ("own_log", "sentinel2a")  # of the tutorial, and of a page of its own
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem not in OTHERS)
PICTURE_BYTES, LINES = 200_000, 60


def texts(path):
    """What can be read in a picture."""
    return re.findall(r"<text[^>]*>([^<]+)</text>", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_draws_its_picture(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(FOLDER)
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    sys.modules.pop("own_log", None)
    assert capsys.readouterr().out
    shown = FOLDER / f"{name}.svg"
    assert texts(tmp_path / shown.name) == texts(shown)
    assert shown.stat().st_size < PICTURE_BYTES


def test_the_gallery_shows_all_of_them():
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert re.findall(r"\(examples/(\w+)\.svg\)", page) == re.findall(r"\} examples/(\w+)\.py", page)
    assert sorted(re.findall(r"\(examples/(\w+)\.svg\)", page)) == SCRIPTS
    assert len(SCRIPTS) >= 8
    assert sorted(path.stem for path in FOLDER.glob("*.svg")) == SCRIPTS
    for name in SCRIPTS:
        assert len((FOLDER / f"{name}.py").read_text(encoding="utf-8").splitlines()) < LINES
