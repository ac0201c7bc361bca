"""Readings on a lattice: what the samples and the references say together of how they came there."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import expit

from diagnosis.detectors.samples import examine
from diagnosis.model import prepare
from diagnosis.settings import DEFAULT
from tests.diagnosis.recordings import recorded


@lru_cache
def _first(lattice, seed, *effects):
    """A recording, what its samples show with the lattice taken in one way, and the first model."""
    made = recorded(seed, *effects, sample_s=1.0, every_s=60.0)
    report = examine(made, lattice=lattice)
    return made, report, prepare._build_first_model(made, report)


def _judged(lattice, odds, seed, *effects):
    """Kind and rivals of the lattice of a recording whose samples say so much of it."""
    made, report, first = _first(lattice, seed, *effects)
    found, _ = prepare._cut_or_rounded(made, replace(report, cut_odds=odds), first, DEFAULT, lambda text, share: None)
    ((kind, rivals),) = [(one.kind, one.rivals) for one in found.symptoms if one.kind.startswith("lattice")]
    return kind, rivals


@pytest.mark.parametrize("lattice", ["cut", "rounded"])
@pytest.mark.parametrize(
    ("spec", "kind", "odds"),
    [("rate_truncation=1e-3", "lattice_cut", -4.0), ("rate_quantization=1e-3", "lattice_rounded", 4.0)],
)
def test_the_references_tell_readings_that_were_cut_whatever_was_taken_at_first(spec, kind, odds, lattice):
    """Half a step too little everywhere is far more than they are uncertain by, and than samples that err."""
    assert _judged(lattice, odds, 4, spec) == (kind, ())


@pytest.mark.parametrize("odds", [-3.0, 1.0])
def test_what_the_references_leave_open_has_the_odds_of_the_samples(odds, monkeypatch):
    monkeypatch.setattr(prepare, "_compute_misfit", lambda model: 100.0)
    kind, rivals = _judged("rounded", odds, 4, "rate_quantization=4e-4")
    assert kind == ("lattice_cut" if odds > 0 else "lattice_rounded")
    ((other, share),) = rivals
    assert {kind, other} == {"lattice_cut", "lattice_rounded"}
    assert share == pytest.approx(expit(-abs(odds)))


def test_the_gain_counts_against_what_is_left_anyway(monkeypatch):
    """A misfit twice as large as it should be, of residuals that go by threes, makes the references six times less sure."""
    _, _, first = _first("rounded", 4, "rate_quantization=4e-4")
    misfits = iter([2.0 * first[0].y.size + 24.0, 2.0 * first[0].y.size])
    monkeypatch.setattr(prepare, "_compute_misfit", lambda model: next(misfits))
    monkeypatch.setattr(prepare, "_estimate_redundancy", lambda y: 3.0)
    kind, ((_, share),) = _judged("rounded", 0.0, 4, "rate_quantization=4e-4")
    assert kind == "lattice_cut"
    assert share == pytest.approx(expit(-12.0 / 6.0))


def test_a_bias_that_wanders_does_not_say_how_readings_came_onto_a_lattice():
    """Errors that stay for a while count once; with every residual counted, "rounded" would be excluded."""
    kind, rivals = _judged("rounded", 0.0, 1, "rate_quantization=4e-4", "bias_random_walk:x=20")
    shares = {kind: 1 - sum(share for _, share in rivals), **dict(rivals)}
    assert shares["lattice_rounded"] > 0.1


def test_residuals_that_follow_one_another_count_by_their_correlation():
    """Of a first-order process of the correlation a at one step, as many as (1 + a)/(1 − a) say what one would."""
    rng = np.random.default_rng(3)
    white = rng.standard_normal((3000, 3))
    assert prepare._estimate_redundancy(white.ravel()) == 1.0
    alike = lfilter([1.0], [1.0, -0.9], white, axis=0)
    # Sokal's error of a sum over M lags of n numbers is √(2(2M + 1)/n): 0.16 with M = 3 · 19.
    assert prepare._estimate_redundancy(alike.ravel()) == pytest.approx(19, rel=2 * 0.16)
