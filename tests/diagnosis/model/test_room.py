"""Columns that are kept once: what restores them before the projection, and room for more beside them."""

import numpy as np

from diagnosis.model.linear import Room

RNG = np.random.default_rng(1)


def test_columns_are_copied_where_there_is_no_room_or_others_have_it():
    room = Room(np.empty((5, 6)))
    room.memory[:, :3], room.used = RNG.standard_normal((5, 3)), 3
    first = room.memory[:, :3]
    one, other = RNG.standard_normal((2, 5, 2))
    beside = room.append_columns(first, one)
    # A second model made from the first columns must not write over those of the first.
    again = room.append_columns(first, other)
    np.testing.assert_array_equal(beside[:, 3:], one)
    np.testing.assert_array_equal(again[:, 3:], other)
    full = room.append_columns(beside, other)
    assert not np.shares_memory(full, beside)
    np.testing.assert_array_equal(full, np.hstack([beside, other]))
    elsewhere = RNG.standard_normal((5, 5))
    np.testing.assert_array_equal(room.append_columns(elsewhere, one[:, :1]), np.hstack([elsewhere, one[:, :1]]))
