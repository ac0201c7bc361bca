"""Lines over samples that were not measured: the variance that they are given, against that of the angles they miss."""

import numpy as np
import pytest

from diagnosis.detectors.gap_interpolation import fill_gaps

DT, COUNT = 0.5, 2000
T = DT * np.arange(COUNT)


def mark_runs(length, every=50):
    """Mark a run of bad samples (n,) now and then."""
    bad = np.zeros(COUNT, dtype=bool)
    for low in range(every, COUNT - every, every):
        bad[low : low + length] = True
    return bad


@pytest.mark.parametrize("length", [1, 12])
def test_noise_of_a_line_is_as_stated(length):
    """Angle over runs and their neighbours; 40 draws of 38 runs on three axes, which leaves 2 % of sampling error."""
    rng, bad = np.random.default_rng(length), mark_runs(length)
    begins = np.flatnonzero(np.diff(bad.astype(int)) == 1)
    window = begins[:, None] + np.arange(length + 2)
    turned, stated = [], []
    for _ in range(40):
        filled, factor, density = fill_gaps(T, rng.standard_normal((COUNT, 3)), bad, DT, 1.0)
        turned.append(filled[window].sum(axis=1))
        stated.append(factor[window].sum(axis=1)[:, None] + density[window].sum(axis=1) / DT)
    assert np.mean(np.square(turned)) == pytest.approx(np.mean(stated), rel=0.1)
    assert np.mean([density.any() for density in stated]) == 1


@pytest.mark.parametrize("length", [1, 3, 12])
def test_what_a_line_misses_of_a_motion_is_covered_by_the_density(length):
    """A sway of 60 samples: the root mean square of the missed angles is that of the density over the run."""
    rates = np.sin(2 * np.pi * np.arange(COUNT)[:, None] / np.array([61.0, 67.0, 73.0]) + np.arange(3))
    bad = mark_runs(length)
    filled, _, density = fill_gaps(T, np.where(bad[:, None], 9.0, rates), bad, DT)
    assert not density[~bad].any()
    begins = np.flatnonzero(np.diff(bad.astype(int)) == 1) + 1
    window = begins[:, None] + np.arange(length)
    missed = DT * (filled - rates)[window].sum(axis=1)
    assert np.mean(missed**2) == pytest.approx(np.mean(DT * density[window].sum(axis=1)), rel=0.2)
