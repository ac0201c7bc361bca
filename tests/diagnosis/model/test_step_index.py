"""What is in progress at a reference is of its own interval, also at the reference that ends it."""

import numpy as np

from diagnosis.model.bins import build_bins
from diagnosis.model.step_index import find_reference_bins, find_reference_steps, find_steps
from tests.diagnosis.recordings import prepared


def test_the_step_at_a_reference_is_the_one_that_follows_it_and_at_the_end_the_last():
    model = prepared(1).model
    assert len(model.blocks) > 1
    expected = [np.minimum(block.steps.start + block.ends, block.steps.stop - 1) for block in model.blocks]
    np.testing.assert_array_equal(find_reference_steps(model), np.concatenate(expected))
    np.testing.assert_array_equal(
        find_steps(model, model.references.t_s, model.interval_of_reference), np.concatenate(expected)
    )


def test_the_bin_at_a_reference_is_of_its_interval():
    model = prepared(1).model
    bins = build_bins(model)
    found = find_reference_bins(model, bins)
    np.testing.assert_array_equal(bins.interval[found], model.interval_of_reference)
    last = np.flatnonzero(np.append(np.diff(model.interval_of_reference) != 0, True))
    np.testing.assert_array_equal(found[last], np.searchsorted(bins.interval, np.arange(len(model.blocks)), "right") - 1)
