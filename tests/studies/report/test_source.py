"""What a page says of how a file was made."""

import hashlib
import json

import pytest

from studies.report.source import Source
from tests import ROOT

FOLDERS = sorted(path.parent for path in (ROOT / "results" / "studies").glob("*/manifest.json"))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_figures_hash_is_that_of_its_file(folder):
    files = json.loads((folder / "manifest.json").read_text())["files"]
    for path in folder.glob("*.svg"):
        if path.name in files:  # the oldest manifests have only their rows'
            assert files[path.name] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_figures_that_were_made_later_than_their_rows_say_so():
    rows, later = "a" * 40, "b" * 40 + "+changes"
    said = Source(ROOT, {"commit": rows, "reported": {"commit": later}}).made("x.svg")
    assert "<code>aaaaaaaaaaaa</code>, reported from its rows at <code>bbbbbbbbbbbb+changes</code>" in said
    assert "reported" not in Source(ROOT, {"commit": rows}).made("x.svg")
