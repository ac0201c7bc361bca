"""The table of faults fits the sources; the runs are ``python -m tests.mutations``."""

import pytest

from tests import ROOT
from tests.mutations import FAULTS
from tests.mutations.fault import Fault


def test_there_are_many_and_each_is_named_once():
    assert len(FAULTS) >= 60
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


def test_every_fault_is_still_one_of_the_sources():
    """A fault whose text has gone would be an equal program, which no test could see."""
    for fault in FAULTS:
        assert fault.put_into(ROOT)
        for test in fault.tests:
            file, _, name = test.partition("::")
            assert f"def {name}(" in (ROOT / file).read_text() if name else (ROOT / file).is_file(), test


@pytest.mark.parametrize(
    ("source", "words"),
    [("x = 1\n", "is no longer there"), ("y = 2\ny = 2\n", "is there 2 times"), ("# y = 2\n", "changes nothing")],
)
def test_a_fault_that_is_none_is_said(tmp_path, source, words):
    (tmp_path / "one.py").write_text(source)
    fault = Fault("one.py", "y", "y = 2", "y = 3", ())
    with pytest.raises(ValueError, match=words):
        fault.put_into(tmp_path)


def test_a_fault_that_is_no_python_is_said(tmp_path):
    (tmp_path / "one.py").write_text("y = 2\n")
    with pytest.raises(ValueError, match="not Python"):
        Fault("one.py", "y", "y = 2", "y = (", ()).put_into(tmp_path)
