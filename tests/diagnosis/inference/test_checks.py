"""Checks of what a named explanation leaves: they pass data of the named model, and see what is beside it."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference import check_statistics, checks
from diagnosis.inference.check_statistics import Layout
from diagnosis.inference.checks import Check, residual_checks, together
from diagnosis.model.linear import Member
from tests.diagnosis.linear_models import linear_model

INTERVALS, EACH = 4, 30
ROWS = INTERVALS * EACH
MEMBERS = (Member(0, 0, 6), Member(1, 0, 2))


@pytest.fixture(scope="module")
def layout():
    rng = np.random.default_rng(1)
    interval = np.repeat(np.arange(INTERVALS), EACH)
    since = np.tile(60.0 * np.arange(EACH), INTERVALS)
    rates = rng.standard_normal((ROWS, 3))
    axes = np.linalg.qr(rng.standard_normal((ROWS, 3, 3)))[0]
    t_s = since + 8000.0 * interval
    regressors = np.column_stack([rates, np.abs(rates), t_s / t_s.max()])
    return Layout(axes, t_s, since, interval, regressors, np.linalg.norm(rates, axis=1))


@pytest.fixture(scope="module")
def model():
    """A drift and a random process that are named, and nuisance parameters."""
    rng = np.random.default_rng(2)
    drift = np.repeat(np.linspace(-1, 1, ROWS), 3)[:, None]
    wander = np.cumsum(rng.standard_normal((3 * ROWS, 20)), axis=0) / 30
    return linear_model([drift, wander], np.zeros(3 * ROWS), rng.standard_normal((3 * ROWS, 12)))


def _smooth(layout):
    """(r, r) covariance that is correlated over some observations."""
    apart = np.abs(layout.t_s[:, None] - layout.t_s)
    return np.exp(-0.5 * (apart / 150.0) ** 2) + 1e-9 * np.eye(ROWS)


@pytest.fixture(scope="module")
def process(model, layout):
    """The same, the second of which is a random process about a body axis, correlated over some observations."""
    factor = np.linalg.cholesky(_smooth(layout))
    columns = np.einsum("rb,rk->rbk", layout.axes[:, 0, :], factor).reshape(3 * ROWS, ROWS)
    rng = np.random.default_rng(12)
    drift = np.repeat(np.linspace(-1, 1, ROWS), 3)[:, None]
    made = linear_model([drift, columns], np.zeros(3 * ROWS), rng.standard_normal((3 * ROWS, 12)))
    first, second = made.candidates
    return replace(made, candidates=(first, replace(second, process=True)))


def drawn(model, rng, count):
    """Observations of the named model, (N, count)."""
    C = np.hstack([model.scale(m) * model.X[:, model.option(m).columns] for m in MEMBERS])
    return model.projected(rng.standard_normal((model.y.size, count))) + C @ rng.standard_normal((C.shape[1], count))


def statistics(model, layout, y):
    """(d,) each statistic of observations (N, d), as `residual_checks` makes them."""
    C = np.hstack([model.scale(m) * model.X[:, model.option(m).columns] for m in MEMBERS])
    L = np.linalg.cholesky(np.eye(model.y.size) + C @ C.T)
    return check_statistics.of_innovations(checks._in_body(np.linalg.solve(L, y), layout), layout)


def checked(model, layout, y):
    return {one.name: one for one in residual_checks(replace(model, y=y), MEMBERS, layout)}


def along_body(layout, values):
    """Observations (3 r,) of values (r, 3) along the body axes."""
    return np.einsum("rba,rb->ra", layout.axes, values).ravel()


def test_innovations_of_the_named_model_are_white(model, layout):
    """Their size is χ² with the degrees of freedom: each has variance one, but for the nuisance parameters."""
    size = statistics(model, layout, drawn(model, np.random.default_rng(3), 2000))["size"]
    assert size.mean() == pytest.approx(model.dof, rel=4 * np.sqrt(2 / model.dof / 2000))
    assert size.std() == pytest.approx(np.sqrt(2 * model.dof), rel=0.1)


LEVELS = (0.05, 0.01, 1e-3)


@pytest.fixture(scope="module")
def rejected_data(model, layout):
    """Shares of ten thousand data of the named model that are rejected at each level, by six sets of draws."""
    rng = np.random.default_rng(4)
    data = statistics(model, layout, drawn(model, rng, 10_000))
    shares = []
    for _ in range(6):
        own = statistics(model, layout, drawn(model, rng, checks.DRAWS))
        p = np.min([checks._p_value(name, data[name], own[name]) for name in own], axis=0)
        shares.append([np.mean(p * len(own) < level) for level in LEVELS])
    return dict(zip(LEVELS, np.mean(shares, axis=0), strict=True))


@pytest.mark.parametrize("level", LEVELS)
def test_data_of_the_named_model_are_rejected_at_the_stated_rate(rejected_data, level):
    """Counted with the allowance for the number of checks."""
    # Counting errors of the data, and what a thousand draws leave open: a fifth at 0.05 and a factor of two at a thousandth.
    error = 4 * np.sqrt(level / 10_000) + level * (0.2 if level >= 0.01 else 1.0)
    assert rejected_data[level] < level + error
    assert rejected_data[level] > 0.4 * level  # and the checks can speak at all


def of_process(model, layout, y):
    """(d,) each statistic of the process in observations (N, d)."""
    C = np.hstack([model.scale(m) * model.X[:, model.option(m).columns] for m in MEMBERS])
    L = np.linalg.cholesky(np.eye(model.y.size) + C @ C.T)
    return check_statistics.of_process(
        checks._in_body(checks._estimated(model, MEMBERS[1], L, np.linalg.solve(L, y)), layout), layout
    )


@pytest.fixture(scope="module")
def rejected_processes(process, layout):
    """The same of draws of a random process, asked about the process itself, by four sets of draws."""
    rng = np.random.default_rng(14)
    found = of_process(process, layout, drawn(process, rng, 10_000))
    shares = []
    for _ in range(4):
        own = of_process(process, layout, np.column_stack([drawn(process, rng, 1), drawn(process, rng, checks.DRAWS)]))
        p = np.min([checks._p_value(name, found[name][1:], own[name][1:]) for name in own], axis=0)
        shares.append([np.mean(p * len(own) < level) for level in LEVELS])
    return dict(zip(LEVELS, np.mean(shares, axis=0), strict=True))


@pytest.mark.parametrize("level", LEVELS)
def test_draws_of_a_process_are_rejected_at_the_stated_rate(rejected_processes, level):
    error = 4 * np.sqrt(level / 10_000) + level * (0.3 if level >= 0.01 else 1.5)
    assert rejected_processes[level] < level + error


def test_a_bump_is_no_draw_of_a_process(process, layout):
    """One bump of an interval, which a slow process takes up whole, so that the innovations show nothing."""
    rng = np.random.default_rng(15)
    y = process.projected(rng.standard_normal((process.y.size, 1)))[:, 0]
    values = np.zeros((ROWS, 3))
    values[:, 0] = np.exp(-0.5 * ((layout.t_s - 8900.0) / 200.0) ** 2)
    bump = process.projected((40 * along_body(layout, values))[:, None])[:, 0]
    found = {one.name: one.p_value for one in residual_checks(replace(process, y=y + bump), MEMBERS, layout)}
    own = [p for name, p in found.items() if name.endswith("itself")]
    assert min(own) < 1e-4
    draw = drawn(process, rng, 1)[:, 0]
    usual = {one.name: one.p_value for one in residual_checks(replace(process, y=draw), MEMBERS, layout)}
    assert min(p for name, p in usual.items() if name.endswith("itself")) > 1e-3


def swallowed(process, layout, course, size=40.0, seed=15):
    """P-values of the checks of a process itself, which has taken up some course (r,) about its axis."""
    rng = np.random.default_rng(seed)
    values = np.zeros((ROWS, 3))
    values[:, 0] = course
    y = process.projected(np.column_stack([rng.standard_normal(process.y.size), size * along_body(layout, values)])).sum(axis=1)
    found = residual_checks(replace(process, y=y), MEMBERS, layout)
    return {one.name.split(",")[0]: one.p_value for one in found if one.name.endswith("itself")}


def switching(layout, switches):
    """(r,) one of two values, in each interval changed at random observations."""
    rng = np.random.default_rng(16)
    sign = np.ones(ROWS)
    for at in rng.choice(ROWS, switches, replace=False):
        sign[at:] *= -1
    return sign


def test_jumps_are_no_draw_of_a_process(process, layout):
    """Steps up and down, two in a hundred and twenty observations, unlike the steady changes of a process."""
    steps = np.zeros(ROWS)
    steps[[47, 101]] = [-1.0, 1.0]
    found = swallowed(process, layout, np.cumsum(steps))
    assert found["jumps"] < 1e-3
    assert swallowed(process, layout, np.zeros(ROWS))["jumps"] > 0.01


def test_whole_checks_of_the_named_model_seldom_reject(model, layout):
    y = drawn(model, np.random.default_rng(5), 25)
    count = sum(together(residual_checks(replace(model, y=y[:, k]), MEMBERS, layout, seed=k)) < 0.2 for k in range(25))
    assert scipy.stats.binom.sf(count - 1, 25, 0.2) > 1e-4


def beside(layout, kind):
    """Something of two sigma or so beside the named effects, (3 r,)."""
    values = np.zeros((ROWS, 3))
    if kind == "line":
        values[:, 1] = 1.3 * np.sin(2 * np.pi * layout.since_s / 410.0 + layout.interval)
    elif kind == "step":
        values[:, 2] = 3.0 * (layout.t_s > 10_000)
    elif kind == "rate":
        values[:, 1] = 1.2 * layout.regressors[:, 0]
    return along_body(layout, values)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("line", "line of any period"),
        ("step", "correlation in time"),
        ("rate", "dependence on what is known"),
    ],
)
def test_what_is_beside_the_named_effects_is_seen_for_what_it_is(model, layout, kind, name):
    y = drawn(model, np.random.default_rng(6), 1)[:, 0]
    assert together(list(checked(model, layout, y).values())) > 1e-3
    found = checked(model, layout, y + model.projected(beside(layout, kind)))
    assert together(list(found.values())) < 1e-5
    assert found[name].p_value < 1e-6
    assert found[name].value > found[name].expected


@pytest.mark.parametrize(
    ("scatter", "name"),
    [
        (lambda layout: np.full(ROWS, 1.4), "size"),
        (lambda layout: np.full(ROWS, 0.7), "size"),
        (lambda layout: np.where(layout.interval == 2, 1.8, 1.0), "variance over the intervals"),
        (lambda layout: np.where(layout.activity > np.quantile(layout.activity, 0.8), 2.2, 1.0), "variance with the rate"),
    ],
)
def test_noise_other_than_stated_is_seen(model, layout, scatter, name):
    """More or less of it everywhere, in one interval, or at fast rates."""
    rng = np.random.default_rng(7)
    y = drawn(model, rng, 1)[:, 0]
    C = np.hstack([model.scale(m) * model.X[:, model.option(m).columns] for m in MEMBERS])
    L = np.linalg.cholesky(np.eye(y.size) + C @ C.T)
    innovations = np.linalg.solve(L, y) * np.repeat(scatter(layout), 3)
    found = checked(model, layout, model.projected(L @ innovations))
    assert found[name].p_value < 1e-4


def test_single_large_residuals_are_seen_by_the_shape(model, layout):
    y = drawn(model, np.random.default_rng(8), 1)[:, 0]
    odd = np.zeros(3 * ROWS)
    odd[[40, 200]] = 9.0
    found = checked(model, layout, y + model.projected(odd))
    assert found["shape"].p_value < 1e-6


def test_too_little_is_not_checked(model, layout):
    few = replace(layout, t_s=layout.t_s[:11])
    assert residual_checks(model, MEMBERS, few) == ()
    assert together(()) == 1.0


def test_the_number_of_checks_is_allowed_for():
    made = [Check(str(number), 0.0, 0.0, 0.5) for number in range(8)]
    assert together([*made, Check("odd", 0.0, 0.0, 1e-5)]) == pytest.approx(9e-5)
    assert together(made) == 1.0


def test_arcs_that_are_too_short_have_no_lines(layout):
    e = np.random.default_rng(9).standard_normal((ROWS, 3, 5))
    assert check_statistics._lines(e, layout) is not None
    short = replace(layout, since_s=np.tile(60.0 * np.arange(3), ROWS // 3), interval=np.repeat(np.arange(ROWS // 3), 3))
    assert check_statistics._lines(e, short) is None


def test_a_process_that_nothing_shows_of_has_no_line(layout):
    found = check_statistics.of_process(np.zeros((ROWS, 3, 20)), layout)
    assert not found[check_statistics.LINE].any()


@pytest.mark.parametrize("degrees", [18, 200])
def test_p_values_of_sums_of_squares_are_those_of_chi_square(degrees):
    rng = np.random.default_rng(10)
    levels = np.array([0.3, 1e-2, 1e-4])
    values = scipy.stats.chi2.isf(levels, degrees)
    found = [checks._p_value("a sum", values, rng.chisquare(degrees, checks.DRAWS)) for _ in range(50)]
    np.testing.assert_allclose(np.log(found).mean(axis=0), np.log(levels), atol=0.35)
    few = scipy.stats.chi2.isf(1 - levels, degrees)
    both = [checks._p_value(check_statistics.SIZE, few, rng.chisquare(degrees, checks.DRAWS)) for _ in range(50)]
    assert (np.log(both).mean(axis=0)[1:] < np.log([0.05, 5e-3])).all()


def test_p_values_of_the_largest_of_many_are_those_of_gumbel():
    rng = np.random.default_rng(11)
    levels = np.array([0.3, 1e-2, 1e-6])
    values = -np.log(-np.log1p(-levels) / 144)
    found = [
        checks._p_value(check_statistics.LINE, values, rng.exponential(size=(144, checks.DRAWS)).max(axis=0)) for _ in range(50)
    ]
    np.testing.assert_allclose(np.log(found).mean(axis=0), np.log(levels), atol=0.2)


def test_a_statistic_that_cannot_vary_says_nothing():
    assert checks._p_value("a sum", np.array([1.0]), np.ones(50)) == 1.0
