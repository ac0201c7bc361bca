"""The sequential test for a change of a parameter: its likelihoods, its false alarms in unit-years, and the dates."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.stats

from gyrocal import InputError
from gyrocal.calibration.parameter_change import GRID_STEP, detect_parameter_change
from tests.builders import choose_case_numbers

PARAMETERS = 12  # of three gyros
LOG_THRESHOLD = np.log(PARAMETERS / 0.1)
RECORDINGS = 12  # a unit-year: one recording a month


def draw_design(rng, n=RECORDINGS):
    """Times in years, about a month apart, and sigmas of recordings of different lengths."""
    return np.cumsum(rng.uniform(0.02, 0.15, n)), np.exp(rng.normal(0.0, 0.4, n))


def draw_walk(rng, time, size):
    return size * np.cumsum(np.append(0.0, np.sqrt(np.diff(time)) * rng.normal(size=time.size - 1)))


def draw_markov(rng, time, size, years):
    C = np.exp(-np.abs(time[:, None] - time) / years)
    return size * np.linalg.cholesky(C + 1e-12 * np.eye(time.size)) @ rng.normal(size=time.size)


def count_false_alarms(rng, draw, units, **options):
    """Units of `PARAMETERS` parameters with an alarm in a unit-year; `draw` makes the course of a parameter."""
    count = 0
    for _ in range(units):
        time, sigma = draw_design(rng)
        values = [draw(rng, time) + sigma * rng.normal(size=time.size) for _ in range(PARAMETERS)]
        found = [detect_parameter_change(one, sigma, time, **options).find_alarm(LOG_THRESHOLD) for one in values]
        count += any(one is not None for one in found)
    return count


@pytest.mark.parametrize("with_temperature", [False, True])
def test_evidence_is_that_of_dense_matrices(with_temperature):
    """Another implementation: densities of the contrasts, with one change time, scatter and step at a time."""
    rng = np.random.default_rng(5)
    n = 5
    time, sigma = draw_design(rng, n)
    value, T = 3 * rng.normal(size=n), 20 + 5 * rng.normal(size=n)
    found = detect_parameter_change(value, sigma, time, T if with_temperature else None, largest_walk=0.0)
    X = np.column_stack([np.ones(n), T] if with_temperature else [np.ones(n)])
    unit, first = sigma[:2].min(), time[1] - time[0]
    Z = scipy.linalg.null_space(X.T)

    def density(C):
        return scipy.stats.multivariate_normal(np.zeros(Z.shape[1]), Z.T @ C @ Z).pdf(Z.T @ value)

    def covariance(s, walk):
        return np.diag(sigma**2 + s**2) + walk**2 / first * np.minimum.outer(time - time[0], time - time[0])

    pairs = [(s * unit, w * unit) for s in (0, 1, 4, 16, 64) for w in (0, 1, 4, 16, 64)]
    total, by_date = 0.0, np.zeros(n)
    for k, (s, walk) in enumerate(pairs):
        C, weight = covariance(s, walk), 0.5 if k == 0 else 0.5 / 24
        total += weight / n * density(C)
        for c in range(2, n + 1):
            h = np.r_[np.zeros(c - 1), np.ones(n - c + 1)]
            one = np.mean([density(C + (size * unit) ** 2 * np.outer(h, h)) for size in (2, 8, 32, 128, 512)])
            total += weight / (c * (c - 1)) * one
            by_date[c - 1] += weight * one
    contrasts = Z.shape[1]
    assert found.log_e[-1] == pytest.approx(np.log(total / density(covariance(0, 0))) - contrasts * GRID_STEP**2 / 16)
    np.testing.assert_allclose(found.date_probability, by_date / by_date.sum(), atol=1e-9)


def test_the_expectation_of_e_is_one():
    """Of a constant that is known to be constant, by quadrature over the one contrast of two recordings."""
    sigma, time = np.array([1.0, 2.0]), np.array([0.0, 1.0])
    grid = np.linspace(-9.0, 9.0, 601)
    contrast = np.sinh(grid)  # to 4000 sigma: E weighs what hardly ever happens under the null hypothesis
    log_e = np.array(
        [detect_parameter_change(np.array([0.0, one]), sigma, time, largest_walk=0.0).log_e[1] for one in contrast]
    )
    log_density = scipy.stats.norm(0.0, np.hypot(1.0, 2.0)).logpdf(contrast)
    expectation = scipy.integrate.trapezoid(np.exp(log_e + log_density) * np.cosh(grid), grid)
    assert expectation == pytest.approx(np.exp(-(GRID_STEP**2) / 16), rel=1e-4)


def test_offset_and_temperature_slope_change_nothing():
    rng = np.random.default_rng(4)
    time, sigma = draw_design(rng)
    T = 20 + 10 * np.sin(6 * time)
    value = draw_walk(rng, time, 5.0) + sigma * rng.normal(size=time.size)
    before = detect_parameter_change(value, sigma, time, T, largest_walk=2.0)
    after = detect_parameter_change(value + 300 - 7 * T, sigma, time, T, largest_walk=2.0)
    np.testing.assert_allclose(after.log_e, before.log_e, atol=1e-8)
    assert (after.step, after.date) == (pytest.approx(before.step), before.date)


COURSES = {
    "constant": lambda rng, time: 0.0,
    "walk of 5 sigma a year": lambda rng, time: draw_walk(rng, time, 5.0),
    "walk of 100 sigma a year": lambda rng, time: draw_walk(rng, time, 100.0),
    "Markov process of 20 sigma and half a year": lambda rng, time: draw_markov(rng, time, 20.0, 0.5),
    "stated sigmas ten times too small": lambda rng, time: 10 * rng.normal(size=time.size),
}


@pytest.mark.parametrize("units", choose_case_numbers(10, 40))
def test_at_most_one_false_alarm_in_ten_unit_years(units):
    """So many unit-years of each course: a tenth of what is allowed, since scatter and walk are those of the data."""
    rng = np.random.default_rng(1)
    assert sum(count_false_alarms(rng, draw, units) for draw in COURSES.values()) <= units * len(COURSES) // 100


def test_no_false_alarm_by_looking_for_ten_years():
    rng = np.random.default_rng(2)
    time, sigma = draw_design(rng, 120)
    for size in (0.0, 20.0, 200.0):
        value = draw_walk(rng, time, size) + sigma * rng.normal(size=time.size)
        assert detect_parameter_change(value, sigma, time).find_alarm(LOG_THRESHOLD) is None


def test_a_limit_that_the_walk_exceeds_makes_false_alarms():
    """Negative control: the test is valid because its null hypothesis has the walk, not because it never says anything."""
    rng = np.random.default_rng(1)
    assert count_false_alarms(rng, COURSES["walk of 100 sigma a year"], 5, largest_walk=0.0) == 5
    assert count_false_alarms(rng, COURSES["constant"], 20, largest_walk=0.0) <= 2


@pytest.mark.parametrize(
    ("largest_walk", "size", "n"),
    [(np.inf, 20.0, 12), (1.0, 10.0, 12), (0.0, 5.0, 12), (np.inf, 60.0, 6), (1.0, 10.0, 6), (0.0, 5.0, 6)],
)
def test_a_change_is_found_and_dated_exactly(largest_walk, size, n):
    """A step of so many sigmas in the middle of constant parameters: the table of docs/trend.md."""
    rng = np.random.default_rng(6)
    time, sigma, place, units = np.arange(n) / RECORDINGS, np.ones(n), n // 2, 100
    seen, exact, covered, errors = 0, 0, 0, []
    for _ in range(units):
        value = rng.normal(size=n) + size * (np.arange(n) >= place)
        found = detect_parameter_change(value, sigma, time, largest_walk=largest_walk)
        alarm = found.find_alarm(LOG_THRESHOLD)
        seen += alarm is not None and alarm >= place
        exact += found.date == place
        low, high = found.date_interval
        covered += low <= place <= high
        errors.append((found.step - size) / found.step_sigma)
    assert seen >= 0.9 * units
    assert exact >= 0.9 * units
    assert covered >= 0.9 * units
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)


def test_the_interval_of_dates_holds_nine_in_ten_where_the_date_is_in_doubt():
    """A step of two sigmas: the most probable date is often wrong, and its interval is wide."""
    rng = np.random.default_rng(7)
    time, sigma, units = np.arange(RECORDINGS) / RECORDINGS, np.ones(RECORDINGS), 300
    covered, width = 0, []
    for _ in range(units):
        place = rng.integers(1, RECORDINGS)
        value = rng.normal(size=RECORDINGS) + rng.normal(0.0, 2.0) * (np.arange(RECORDINGS) >= place)
        low, high = detect_parameter_change(value, sigma, time, largest_walk=0.0).date_interval
        covered += low <= place <= high
        width.append(high - low)
    assert covered >= scipy.stats.binom(units, 0.9).ppf(0.001)
    assert np.mean(width) > 3


def test_a_change_with_the_temperature_is_none():
    rng = np.random.default_rng(8)
    time, sigma = np.arange(12.0), np.ones(12)
    T = np.where(time < 6, 20.0, 45.0) + 0.1 * rng.normal(size=12)
    value = 2 * T + rng.normal(size=12)
    assert detect_parameter_change(value, sigma, time, largest_walk=0.0).find_alarm(LOG_THRESHOLD) is not None
    assert detect_parameter_change(value, sigma, time, T, largest_walk=0.0).find_alarm(LOG_THRESHOLD) is None
    without_variation = detect_parameter_change(value, sigma, time, np.full(12, 20.0), largest_walk=0.0)
    assert without_variation.find_alarm(LOG_THRESHOLD) is not None


@pytest.mark.parametrize("n", [1, 2])
def test_what_is_no_sequence_is_refused(n):
    with pytest.raises(InputError, match="two recordings or more"):
        detect_parameter_change(np.zeros(n), np.ones(n), np.zeros(n))
