"""A sample of the bad inputs; all of them with ``python -m tests.corpus``."""

from functools import cache

import numpy as np
import pytest

from tests.corpus.__main__ import everything, good
from tests.corpus.run import GOOD, run

INPUTS = list(everything())
CHEAP = [bad for bad in INPUTS if bad.family not in ("study", "study setting", "manifest")]
SAMPLE = np.random.default_rng(2026).choice(len(CHEAP), 48, replace=False)


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """The good recording of a scenario, made when it is first asked for."""
    return cache(lambda scenario: good(tmp_path_factory.mktemp("corpus"), scenario))


def test_there_are_many_and_each_is_named_once():
    assert len(INPUTS) > 600
    assert len({(bad.family, bad.name) for bad in INPUTS}) == len(INPUTS)


@pytest.mark.parametrize("number", SAMPLE, ids=lambda number: f"{CHEAP[number].family}: {CHEAP[number].name}"[:60])
def test_a_bad_input_ends_well(given, tmp_path, number):
    found = run(CHEAP[number], *given(CHEAP[number].scenario), tmp_path)
    assert found.word in GOOD, found
