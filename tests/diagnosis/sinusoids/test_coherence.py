"""One phase over several intervals: evidence against columns made at once, and the false alarms of its best frequency."""

import numpy as np
import pytest

from diagnosis.inference.evidence import log_bayes
from diagnosis.sinusoids.coherence import SCALES, IntervalProducts, find_tops
from diagnosis.sinusoids.fit import make_waves

TIMES = [np.arange(0.0, 300.0), np.arange(2000.0, 2200.0), np.arange(7000.0, 7300.0)]
T = np.concatenate(TIMES)
OWNER = np.repeat([0, 1, 2], [one.size for one in TIMES])
MIDDLE = np.array([one.mean() for one in TIMES])
MADE = np.array([0.0917, 0.2113])
NEAR = MADE[:, None] + 1e-5 * np.arange(-8, 9)  # at most 1/(32 · 300 s) from the frequency at which waves are made


def compute_products(frequency, waves, y, interval, middle_s):
    """Products of waves of a sine and a cosine at each frequency, without nuisance parameters."""
    starts = np.flatnonzero(np.diff(interval, prepend=-1))
    back = np.exp(-2j * np.pi * np.outer(middle_s, frequency))
    a = (waves[:, 1::2] + 1j * waves[:, ::2]) * back[np.searchsorted(starts, np.arange(y.size), side="right") - 1]
    z = np.add.reduceat(a * y[:, None], starts, axis=0)
    s = np.add.reduceat(a * a, starts, axis=0)
    return IntervalProducts(middle_s, z.T[:, :, None], np.sum(np.abs(a) ** 2, axis=0), s.T[:, :, None])


def evidence_of(y):
    return compute_products(MADE, make_waves(MADE, T), y, OWNER, MIDDLE).compute_log_evidence(NEAR)


def test_evidence_is_that_of_columns_made_at_each_frequency():
    rng = np.random.default_rng(1)
    y = 0.3 * np.sin(2 * np.pi * (MADE[0] + 3e-5) * T + 1.0) + rng.standard_normal(T.size)
    found = evidence_of(y)
    for j, k in ((0, 11), (0, 2), (1, 5)):
        X = make_waves(NEAR[j, k], T)
        scales = np.array(SCALES) / np.sqrt(0.5 * np.sum(X**2))
        expected = log_bayes((X.T @ X)[None], (X.T @ y)[None], scales).max()
        assert found[j, k] == pytest.approx(expected, abs=0.02 * abs(expected) + 0.2)
    assert abs(int(find_tops(found[0], 1)[0]) - 11) <= 3  # its sigma is 0.9 steps
    assert found[0].max() > 15


def test_noise_has_no_evidence_and_tops_are_in_order():
    """The evidence of a sinusoid exceeds e^x by chance in at most e^-x of the cases, at any one frequency."""
    rng = np.random.default_rng(2)
    values = np.array([evidence_of(rng.standard_normal(T.size))[:, 8] for _ in range(400)]).ravel()
    for x in (2.0, 4.0):
        assert np.mean(values > x) <= len(SCALES) * np.exp(-x)
    assert find_tops(np.array([0.0, 3.0, 1.0, 5.0, 5.0, 2.0, 4.0]), 2).tolist() == [3, 6]
