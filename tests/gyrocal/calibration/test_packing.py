"""Packed increments hold every step where its lane reads it."""

import numpy as np
import pytest

from gyrocal import Arcs
from gyrocal.calibration.increment_packing import LANES, is_unbroken

# Pieces of several chunks and of less than one; in the last, outputs enough for a second batch of lanes, one of them of a step.
OUTPUTS = {"one": [0, 20_011], "short": [0, 3, 501], "several": [0, 1, *range(600, 42_000, 1003)]}


def arcs_of(edges):
    """Arcs of random rates and durations between the edges."""
    rng = np.random.default_rng(4)
    steps = edges[-1]
    rates, edges = rng.normal(size=(steps, 3)) * 0.01, np.array(edges)
    return Arcs(
        rates, rng.uniform(0.2, 0.5, steps), np.arange(steps), edges[:-1], edges[1:], np.zeros(len(edges) - 1, dtype=int)
    )


@pytest.mark.parametrize("edges", OUTPUTS.values(), ids=OUTPUTS)
def test_every_step_is_where_its_lane_reads_it(edges):
    arcs = arcs_of(edges)
    packed = arcs.increments.copy()
    for piece, (start, length) in enumerate(zip(*arcs.pieces, strict=True)):
        lane = packed[piece // LANES, :, :, piece % LANES]
        steps = slice(start, start + length)
        np.testing.assert_array_equal(lane[:length, :3], arcs.raw[steps] * arcs.dt[steps, None])
        np.testing.assert_array_equal(lane[:length, 3], arcs.dt[steps])
        lane[:length] = 0
    assert not packed.any(), "steps beyond a piece's end turn nothing"
    assert arcs.largest_increment == pytest.approx(np.linalg.norm(arcs.raw * arcs.dt[:, None], axis=1).max(), rel=1e-14)


def test_rates_and_durations_of_any_layout_and_kind_are_packed():
    # The packing reads memory by its address.
    arcs = arcs_of(OUTPUTS["one"])
    rates = np.round(1e6 * arcs.rates).astype(np.float32)
    spread = np.repeat(arcs.dt, 2)[::2]
    ends = arcs.first, arcs.last, arcs.arc
    other = Arcs(np.asfortranarray(rates), spread, arcs.sample, *ends)
    expected = Arcs(rates.astype(float), arcs.dt, arcs.sample, *ends)
    np.testing.assert_array_equal(other.increments, expected.increments)


def test_samples_left_out_or_held_twice_break_a_piece():
    starts, lengths = np.array([0, 4]), np.array([4, 4])
    # Between pieces a sample may be held again: a reference cuts it in two.
    assert is_unbroken(np.array([5, 6, 7, 8, 8, 9, 10, 11]), starts, lengths)
    assert not is_unbroken(np.array([5, 6, 6, 8, 8, 9, 10, 11]), starts, lengths)
    assert not is_unbroken(np.array([5, 6, 7, 8, 8, 9, 10, 12]), starts, lengths)
