"""What a dead zone hides: a process tied to both edges, in closed form, and the angle that real motions turn by in it."""

import numpy as np
import pytest

from diagnosis.detectors.hidden_course import SHARE, course

SIZE, COUNT = 0.01, 1  # rad/s, samples of a window
INSIDE = 0.6  # half widths


def _tied(n, tau, before, behind):
    """Mean of an Ornstein–Uhlenbeck process of n samples, given its values at either end, by its covariance."""
    t = np.arange(n) + 0.5
    ends = [(0.0, before)] * (before is not None) + [(float(n), behind)] * (behind is not None)
    at, values = np.array(ends).T
    cov = np.exp(-np.abs(np.subtract.outer(at, at)) / tau)
    return np.exp(-np.abs(np.subtract.outer(t, at)) / tau) @ np.linalg.solve(cov, values)


def _passage(n, ways, edges):
    """Readings that come to the edge, are zero for n samples, and go away, at paces of some samples a half width."""
    before = edges[0] * (1 + np.arange(3 * ways[0])[::-1] / ways[0] + 0.5 / ways[0]) if edges[0] else np.zeros(0)
    behind = edges[1] * (1 + np.arange(3 * ways[1]) / ways[1] + 0.5 / ways[1]) if edges[1] else np.zeros(0)
    return SIZE * np.concatenate([before, np.zeros(n), behind]), slice(before.size, before.size + n)


@pytest.mark.parametrize("n", [8, 60, 900])
@pytest.mark.parametrize(("edges", "ways"), [((1, 1), (20, 20)), ((1, -1), (20, 20)), ((-1, 0), (30, 0)), ((0, 1), (0, 10))])
def test_the_expected_rate_is_the_mean_of_a_process_tied_to_its_edges(n, edges, ways):
    x, inside = _passage(n, ways, edges)
    found = course(x, [slice(0, x.size)], SIZE, COUNT, INSIDE)
    np.testing.assert_array_equal(np.flatnonzero(found.dead), np.arange(inside.start, inside.stop))
    tau = 0.8 * max(ways)
    wanted = _tied(n, tau, *(edge or None for edge in edges))
    np.testing.assert_allclose(found.expected[inside], SIZE * wanted, atol=1e-9 * SIZE)
    rest = _tied(n, tau, *(1.0 if edge else None for edge in edges))
    np.testing.assert_allclose(found.resting[inside], 1 - rest, atol=1e-9)
    longer, shorter = (_tied(n, tau * (1 + way * SHARE), *(edge or None for edge in edges)) for way in (1, -1))
    np.testing.assert_allclose(found.slower[inside], SIZE * (longer - shorter) / (2 * SHARE), atol=1e-9 * SIZE)


@pytest.mark.parametrize(("level", "rel"), [(0.0, 0.01), (0.3, 0.1)])
def test_a_body_that_slows_down_smoothly_turns_by_the_expected_angle_until_it_rests(level, rel):
    """The pace falls steadily to zero, and rises again. At a level of its own the body is faster at the edges than expected."""
    u = np.arange(400) / 100.0
    slow = 3 * SIZE * (1 - u / 4) ** 2
    rate = np.concatenate([slow, np.zeros(2000), -slow[::-1]]) + level * SIZE
    found = course(np.where(np.abs(rate) < SIZE, 0.0, rate), [slice(0, rate.size)], SIZE, COUNT, INSIDE)
    hidden = np.where(found.dead, found.expected + level * SIZE * found.resting, 0.0)
    missing = np.where(found.dead, rate, 0.0)
    for half in np.array_split(np.arange(rate.size), 2):
        assert hidden[half].sum() == pytest.approx(missing[half].sum(), rel=rel)


def test_ways_that_are_not_seen_are_as_long_as_the_others():
    """A body that comes back to the edge before it is twice as far tells no pace: the usual one is taken."""
    first, _ = _passage(200, (20, 20), (1, -1))
    turned = -SIZE * np.concatenate([np.linspace(1.02, 1.5, 10), np.linspace(1.5, 1.02, 10)])
    x = np.concatenate([first[:-55], turned, np.zeros(300)])
    begin = x.size - 300
    found = course(x, [slice(0, x.size)], SIZE, COUNT, INSIDE)
    np.testing.assert_allclose(found.expected[begin:], SIZE * _tied(300, 16.0, -1.0, None), atol=1e-3 * SIZE)


def test_without_any_pace_it_is_a_straight_line():
    x = SIZE * np.concatenate([[1.2, 1.1], np.zeros(50), [-1.1, -1.2]])
    found = course(x, [slice(0, x.size)], SIZE, COUNT, INSIDE)
    np.testing.assert_allclose(found.expected[2:-2], SIZE * (1 - 2 * (np.arange(50) + 0.5) / 50), atol=1e-12)
    np.testing.assert_allclose(found.resting[2:-2], 0.0, atol=1e-12)


def test_a_way_ends_at_the_next_passage():
    """A rate that comes back into the zone before it is twice as far has told nothing of its pace there."""
    out_and_back = np.concatenate([np.linspace(1.1, 1.6, 8), np.linspace(1.6, 1.1, 8)])
    far = np.linspace(1.05, 3.0, 40)  # twice as far after the nineteenth reading
    x = SIZE * np.concatenate([far[::-1], np.zeros(30), out_and_back, np.zeros(400), far])
    found = course(x, [slice(0, x.size)], SIZE, COUNT, INSIDE)
    tau = 0.8 * np.argmax(far > 2)
    np.testing.assert_allclose(found.expected[40:70], SIZE * _tied(30, tau, 1.0, 1.0), atol=1e-9 * SIZE)
    np.testing.assert_allclose(found.expected[86:486], SIZE * _tied(400, tau, 1.0, 1.0), atol=1e-9 * SIZE)


def test_intervals_without_a_passage_hide_nothing():
    x = 3 * SIZE * np.ones(100)
    x[60:80] = 0.0
    found = course(x, [slice(0, 50), slice(50, 100)], SIZE, COUNT, INSIDE)
    np.testing.assert_array_equal(np.flatnonzero(found.dead), np.arange(60, 80))
    assert not found.expected[:50].any()
