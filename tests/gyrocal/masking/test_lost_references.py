"""References that were not measured are found and left out, and measured ones stay."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrocal.masking.lost_references import leave_out_lost_references

SAMPLE_S, RATE = 0.02, 0.6


@cache
def build_motion(amplitude):
    """Times (n,), rates (n, 3) and attitudes (n,) of a body that rests for ten seconds, turns for 30, and rests again."""
    t_s = np.arange(2500) * SAMPLE_S
    gate = ((t_s > 10) & (t_s < 40))[:, None]
    rates = amplitude * gate * np.sin(2 * np.pi * np.outer(t_s - 10, [0.13, 0.21, 0.34]))
    turned = [Rotation.identity()]
    for rate in rates[:-1]:
        turned.append(turned[-1] * Rotation.from_rotvec(rate * SAMPLE_S))
    return t_s, rates, Rotation.concatenate(turned)


def build_tables(seed, noise=1e-3, digits=6, amplitude=RATE, every=5):
    """Times, rates (n, 3), times and attitudes (m, 4)."""
    rng, (t_s, rates, turned) = np.random.default_rng(seed), build_motion(amplitude)
    q = turned[::every]
    q = (q * Rotation.from_rotvec(rng.normal(size=(len(q), 3)) * noise)).as_quat()
    raw = rates + np.deg2rad([0.8, -0.5, 0.3]) + rng.normal(size=rates.shape) * 1e-3
    return t_s, raw, t_s[::every], np.round(q * np.sign(q[:, [3]]), digits)


def find_lost(t_s, raw, at, q):
    unit = q / np.linalg.norm(q, axis=1, keepdims=True)
    said = []
    keep = leave_out_lost_references(at, unit, t_s, raw, SAMPLE_S, "attitude", said)
    return np.flatnonzero(~keep), said


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("noise", "digits"), [(1e-3, 6), (1e-3, 3), (1e-5, 4), (0.0, 6), (0.0, 3)])
@pytest.mark.parametrize("amplitude", [RATE, 0.02, 0.0])
def test_measured_references_all_stay(seed, noise, digits, amplitude):
    """Rounded references of a body at rest repeat to the last digit, and the ones without noise begin at the identity."""
    lost, said = find_lost(*build_tables(seed, noise, digits, amplitude))
    assert lost.size == 0, said


def test_a_body_that_spins_evenly_keeps_its_references_and_loses_held_ones():
    t_s = np.arange(2500) * SAMPLE_S
    raw = np.tile([0.0, 0.0, 0.3], (2500, 1)) + np.random.default_rng(1).normal(size=(2500, 3)) * 1e-3
    q = Rotation.from_rotvec(np.outer(t_s[::5], [0.0, 0.0, 0.3])).as_quat()
    assert find_lost(t_s, raw, t_s[::5], q)[0].size == 0
    q[200:210] = q[199]
    assert find_lost(t_s, raw, t_s[::5], q)[0].tolist() == list(range(200, 210))


def test_the_identity_and_held_values_are_left_out():
    t_s, raw, at, q = build_tables(0)
    plain = q.copy()
    q[150:170] = [0.0, 0.0, 0.0, 1.0]
    lost, (text,) = find_lost(t_s, raw, at, q)
    assert lost.tolist() == list(range(150, 170))
    assert "20 attitude row(s) are the identity" in text
    plain[150:170] = plain[149]
    lost, (text,) = find_lost(t_s, raw, at, plain)
    assert lost.tolist() == list(range(150, 170))
    assert "20 attitude row(s) repeat" in text


def test_a_forward_filled_table_keeps_one_row_a_measurement_at_rest_as_well():
    t_s, raw, at, q = build_tables(4, every=1)
    fresh = np.unique((np.arange(0, 700) * 3.57).astype(int))
    fresh = fresh[fresh < len(q)]
    filled = q[fresh[np.searchsorted(fresh, np.arange(len(q)), side="right") - 1]]
    lost, said = find_lost(t_s, raw, at, filled)
    assert np.setdiff1d(np.arange(len(q)), lost).tolist() == fresh.tolist()
    assert "up to 0.02 s late" in said[1]
