"""What moved of a baseline, by values; its command with recordings and studies is run by tests/docs/test_ci.py."""

import math

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from studies import baseline

ROWS = pd.DataFrame(
    {"case": [0, 1, 2], "error": [None] * 3, "kind": ["a", "b", "b"], "x": [1e-7, 2.0, math.inf], "y": [0.0, math.nan, 3.0]}
)


@given(st.sampled_from([(0, "x"), (1, "x"), (2, "y")]), st.floats(-1e-5, 1e-5))
@settings(max_examples=20)
def test_a_value_moves_by_more_than_its_share_or_limit(place, share):
    changed = ROWS.copy()
    changed.loc[place] *= 1 + share
    moved = baseline.find_changed_values(ROWS, changed)
    assert len(moved) == (abs(changed.loc[place] - ROWS.loc[place]) > baseline.RTOL * ROWS.loc[place])
    assert baseline.find_changed_values(ROWS, changed, {"x": 1.0, "y": 1.0}).empty
    assert set(moved["quantity"]) <= {place[1]}


@pytest.mark.parametrize(("place", "value"), [((2, "x"), 1.0), ((1, "y"), 1.0), ((2, "y"), math.nan), ((0, "kind"), "b")])
def test_what_is_infinite_missing_or_text_moves_when_it_differs(place, value):
    changed = ROWS.copy()
    changed.loc[place] = value
    moved = baseline.find_changed_values(ROWS, changed, {"x": 1.0})
    assert moved[["case", "quantity"]].to_numpy().tolist() == [list(place)]


def test_other_rows_or_columns_are_a_change():
    assert baseline.find_changed_values(ROWS, ROWS).empty
    assert len(baseline.find_changed_values(ROWS, ROWS.head(2))) == len(baseline.find_changed_values(ROWS, ROWS[["x"]])) == 1
