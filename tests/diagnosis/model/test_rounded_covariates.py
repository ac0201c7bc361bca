"""Covariates that are recorded to a coarse step: their course, its error, and the evidence of what follows them."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from diagnosis.inference.amplitudes import estimate_amplitudes
from diagnosis.inference.evidence import PEAK, log_bayes
from diagnosis.inference.search import Search
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.prepare import prepare
from diagnosis.model.rounded_covariates import estimate_course, find_rounded_covariates
from simulator.effects import EFFECTS
from simulator.effects.common import DEG_H
from tests.diagnosis.recordings import of_rates, slews_between_references

SAMPLE_S, EACH, GAPS, PERIOD_S = 2.0, 60, 120, 5400.0
LIBRARY = ("bias_temperature", "bias_periodic", "bias_drift", "g_matrix_temperature")


def temperature(t_s):
    """A temperature with a swing of 2.4 K, °C."""
    return 20.1 + 1.1 * np.sin(2 * np.pi * t_s / PERIOD_S + 0.5) + 0.3 * np.sin(4 * np.pi * t_s / PERIOD_S)


@lru_cache
def recorded(step, cause, size_deg_h):
    """A recording whose bias follows a temperature or a sine of another phase, with that temperature rounded to a step."""
    plain = of_rates(slews_between_references(GAPS, EACH, SAMPLE_S, 2e-3), EACH, SAMPLE_S, 2.6e-6, 9e-5, 3)
    t_s = plain.gyro.t_s + SAMPLE_S / 2
    shape = temperature(t_s) if cause == "temperature" else np.sin(2 * np.pi * t_s / (0.8 * PERIOD_S) + 2.0)
    rates = plain.gyro.rates.copy()
    rates[:, 2] += size_deg_h * DEG_H * (shape - shape.mean())
    rows = np.arange(0.0, t_s[-1], 10.0)
    shown = temperature(rows) + 0.02 * np.random.default_rng(4).standard_normal(rows.size)
    table = pd.DataFrame({"t_s": rows, "gyro_temperature_c": np.round(shown / step) * step if step else shown})
    return replace(plain, gyro=replace(plain.gyro, rates=rates), tables={"housekeeping": table})


def test_a_coarse_column_is_rounded_and_its_course_nearer_to_the_truth():
    """The mean halves the error of rounding at least, and the courses hold the error that is left."""
    t_s = np.arange(0.0, 5 * PERIOD_S, 10.0)
    true = 20.3 + 1.5 * np.sin(2 * np.pi * t_s / PERIOD_S + 1.0)
    found = estimate_course(t_s, np.round(true), 1.0)
    error = np.interp(t_s, found.t_s, found.mean) - true
    spread = np.interp(t_s, found.t_s, np.sum(found.courses**2, axis=1))
    assert np.std(error) < 0.5 * np.std(np.round(true) - true)
    assert 0.1 < np.mean(error**2) / np.mean(spread) < 2.0
    # Values without a lattice, on a fine one, and flags of two values are taken as they are.
    coarse, fine, smooth = (recorded(step, "temperature", 0.0) for step in (1.0, 0.01, 0.0))
    assert list(find_rounded_covariates(coarse)) == ["gyro_temperature_c"]
    assert not find_rounded_covariates(fine)
    assert not find_rounded_covariates(smooth)
    table = coarse.tables["housekeeping"]
    flags = replace(coarse, tables={"housekeeping": table.assign(gyro_temperature_c=(table.gyro_temperature_c > 20) * 1.0)})
    assert not find_rounded_covariates(flags)


@pytest.mark.parametrize("correlation", [[3.0, -1.0], [40.0, 9.0]])
def test_tied_errors_have_the_evidence_of_two_peaks(correlation):
    """The closed form is the integral over the main amplitude with the errors integrated out."""
    scale, gram, along = 0.8, np.array([[50.0, 4.0], [4.0, 2.0]]), np.array(correlation)
    peak = PEAK * scale

    def likelihood(a):
        """Likelihood ratio of a main amplitude, with the error's amplitude of variance scale² integrated out."""
        gain, rest = 1 + scale**2 * gram[1, 1], along[1] - gram[0, 1] * a
        return np.exp(a * along[0] - 0.5 * a**2 * gram[0, 0] + 0.5 * scale**2 * rest**2 / gain) / np.sqrt(gain)

    whole, _ = quad(
        lambda a: likelihood(a) * 0.5 * (norm.pdf(a, scale, peak) + norm.pdf(a, -scale, peak)),
        -5,
        5,
        points=(0.0, 0.8),
        limit=200,
    )
    found = log_bayes(gram[None], along[None], np.array([scale]), tied=True)
    assert found[0, 0] == pytest.approx(np.log(whole), abs=1e-6)


def rank_singles(step, cause, size_deg_h):
    """Labels of the effects that explain a recording alone, the likeliest first, and log evidence of each."""
    model = prepare(recorded(step, cause, size_deg_h)).model
    linear = build_linear_model(model, [EFFECTS[name] for name in LIBRARY], rivals=False)
    found = Search(linear).score_singles()
    return {linear.candidate(one.members[0]).label: one for one in found}, linear


def test_a_rounded_temperature_is_the_cause_of_its_own_course_alone():
    """The bias follows the temperature before its rounding, at its own size; the rounded column explains less."""
    found, linear = rank_singles(1.0, "temperature", 0.4)
    best = found["bias_temperature:z"]
    assert next(iter(found)) == "bias_temperature:z"
    assert best.log_posterior > found["bias_periodic:z"].log_posterior + 10
    assert linear.option(best.members[0]).count > 1
    (fitted,) = estimate_amplitudes(linear, best.members)
    assert fitted.size == pytest.approx(0.4, abs=4 * fitted.sigma)
    assert fitted.sigma < 0.1 * fitted.size
    as_recorded = Search(linear).tables(best.members[0].candidate, None)[0].max()
    assert best.log_evidence > as_recorded + 5
    # A bias that swings with another period is periodic, whatever the errors of a rounded temperature could be.
    # Lines of the slews are nuisance parameters here and take 5 % of χ², so that the periods around the best are needed.
    found, linear = rank_singles(1.0, "sine", 0.5)
    for _ in range(2):
        linear = linear.refine(linear, found["bias_periodic:z"].members[0])
        found = {linear.candidate(one.members[0]).label: one for one in Search(linear).score_singles()}
    assert next(iter(found)) == "bias_periodic:z"
    assert found["bias_periodic:z"].log_posterior > found["bias_temperature:z"].log_posterior + 10
