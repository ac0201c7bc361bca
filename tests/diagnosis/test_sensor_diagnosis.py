"""Diagnosis of the raw sensor tables: its linear model against the simulator, and what it names."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from diagnosis.sensors import diagnose
from diagnosis.sensors.candidates import Held, held_columns, listed_columns, listed_groups, rival_columns, rival_groups
from diagnosis.sensors.diagnose import examine, p_of_gap, searched
from diagnosis.sensors.reduced import reduce
from diagnosis.sensors.refine import refined, widened
from diagnosis.sensors.spans import fit, fitted_all, spans
from gyrocal.errors import InputError
from gyrocal.recording.sensor_tables import SensorTables
from simulator import scenario
from simulator.effects.sensor import SENSOR_EFFECTS, parse
from simulator.effects.sensor.base import VectorEffect
from simulator.sensors.record import nominal_suite, sensed
from simulator.sensors.sun import head_tangents
from simulator.simulate import motion, simulate
from simulator.truth.rotation import matrix
from studies.robertson.heads import _noisy, _scaled

MONTHS = scenario.load("trmm_months")
DAYS = ("d01", "d09", "d17", "d25", "d33", "d37", "d45", "d53", "d61", "d69", "d73", "d81")
FEW = MONTHS.model_copy(update={"interval": tuple(one for one in MONTHS.interval if one.name in DAYS)})
ONE = MONTHS.model_copy(update={"interval": tuple(one for one in MONTHS.interval if one.name == "d73")})
MOTION = motion(FEW)


def recorded(*effects, seed=1, change=None):
    """A recording whose attitudes and gyro are those of the seed, with noise."""
    plain = simulate(FEW, seed=seed)
    return replace(plain, sensors=sensed(FEW, MOTION, [parse(one) for one in effects], seed, change=change))


def fits_of(recording):
    return fitted_all(spans(recording)[0])[0]


@pytest.fixture(scope="module")
def nominal():
    return fits_of(recorded())


# ---- the linear model --------------------------------------------------------------------------------------------------------


def angles_shown(suite, recording, truth):
    """Angles of both sun sensors at their tags before they are counted, by the simulator's own kernel."""
    A, parts = matrix(truth.sensor_quaternions), []
    ephemeris = recording.sensors.ephemeris
    for number, sensor in enumerate(suite.sun_sensors, start=1):
        rows = ephemeris.rows(recording.sensors.sun.of(number)[0])
        s = np.einsum("nij,nj->ni", A[rows], ephemeris.sun[rows]) @ sensor.alignment
        parts.append(np.arctan([head_tangents(*one, sensor.head) for one in s]).reshape(-1, 2))
    return parts


def taken_off(span, recording, before, after, earth):
    """The stretch fitted with what an effect adds, as the simulator makes it, on top of the measurements."""
    sun = []
    for number, old, new in zip((1, 2), before, after, strict=True):
        if number in span.numbers:
            t = recording.sensors.sun.of(number)[0]
            own = (t >= span.series[span.numbers.index(number)].t[0]) & (t <= span.series[span.numbers.index(number)].t[-1])
            sun.append((new - old)[own])
    table = recording.sensors.earth
    own = (table.t_s >= span.sightings.t_s[0]) & (table.t_s <= span.sightings.t_s[-1])
    return fit(span, -np.concatenate(sun), -np.where(span.sightings.used, earth[own], 0.0))


@pytest.mark.parametrize(
    "text", ["dss_head:1=1", "dss_head:2=1", "dss_misalignment=1", "esa_bias=1", "esa_s_filter=1", "esa_nadir=1"]
)
def test_columns_are_differences_of_the_simulation(text):
    """Every amplitude, against ± a step of it put through simulator and fit; what epoch attitude and bias take is left out."""
    setting = parse(text)
    effect, h = SENSOR_EFFECTS[setting.effect], 0.02
    recording, truth = simulate(ONE, noise=False), motion(ONE)
    plain = nominal_suite(0.0, 0.0)
    nominal_angles = angles_shown(plain, recording, truth)
    (span,) = spans(recording)[0]
    start = fit(span)
    for k in range(effect.count):
        both = []
        for way in (1, -1):
            size, parameters = effect.from_amplitudes(way * h * np.eye(effect.count)[k]) if effect.count > 1 else (way * h, {})
            changed = replace(setting, size=size, parameters={**setting.parameters, **parameters})
            earth = sensed(ONE, truth, [changed], noise=False).earth.angles - recording.sensors.earth.angles
            shown = angles_shown(effect.fitted(plain, changed), recording, truth)
            both.append(taken_off(span, recording, nominal_angles, shown, earth))
        difference = (both[0].rows.z - both[1].rows.z) / (2 * h)
        own = held_columns(start, {setting.label(): Held(np.zeros(effect.count), setting.parameters)})[:, k]
        compared = replace(start, rows=replace(start.rows, z=difference - own))
        gram, _ = compared.gram(own[:, None])
        assert gram[0, 0] > 1
        assert gram[1, 1] < 1e-4 * gram[0, 0]


def test_the_column_of_an_intrusion_is_the_difference_of_two_simulations():
    """The Sun is in the field only when it is not excluded, so that the step is from a weak Sun to a stronger one."""
    one, two = (simulate(ONE, noise=False, effects=[parse(f"esa_sun_intrusion={size}")]) for size in (0.1, 0.14))
    (start,), (more,) = fits_of(one), fits_of(two)
    held = {"esa_sun_intrusion": Held(np.array([0.1]), parse("esa_sun_intrusion=1").parameters)}
    own = held_columns(start, held)
    gram, _ = replace(start, rows=replace(start.rows, z=(more.rows.z - start.rows.z) / 0.04 - own[:, 0])).gram(own)
    assert gram[0, 0] > 1
    assert gram[1, 1] < 1e-3 * gram[0, 0]


def test_a_rate_error_at_orbit_rate_is_a_combination_of_its_columns():
    plain, swinging = (simulate(ONE, noise=False, effects=[parse(e) for e in more]) for more in ((), ("bias_orbital:z=0.3",)))
    (start,), (other,) = fits_of(plain), fits_of(swinging)
    (group, *_) = [one for one in rival_groups(0) if one.effect == "gyro rate at orbit harmonics"]
    X = rival_columns(start)[:, group.start : group.start + group.count]
    gram, _ = replace(start, rows=replace(start.rows, z=other.rows.z - start.rows.z)).gram(X)
    inner, along, whole = gram[:-1, :-1], gram[:-1, -1], gram[-1, -1]
    assert whole > 100
    assert whole - along @ np.linalg.pinv(inner, hermitian=True) @ along < 0.01 * whole


def test_products_are_those_of_the_full_covariance():
    """Mᵀ V⁻¹ M with noise and the gyro's walk in V, epoch attitude and bias projected out, done densely."""
    (fitted,) = fits_of(simulate(ONE, seed=2))
    X = listed_columns(fitted, ("dss_head", "esa_bias"), {})
    rows, q = fitted.rows, fitted.path.q
    later = np.arange(len(q))[None, :] < rows.node[:, None]
    walk = np.einsum("ri,rk,k->rki", rows.attitude, later, q).reshape(len(rows.z), -1)
    V = np.eye(len(rows.z)) + walk @ walk.T
    free = np.column_stack([rows.attitude, rows.parameters])
    M = np.column_stack([X, rows.z])
    inverse = np.linalg.inv(V)
    cross = free.T @ inverse @ M
    expected = M.T @ inverse @ M - cross.T @ np.linalg.solve(free.T @ inverse @ free, cross)
    gram, dof = fitted.gram(X)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(gram / scale, expected / scale, atol=1e-7)
    assert dof == len(rows.z) - 6


def test_groups_are_where_the_columns_are(nominal):
    library = tuple(SENSOR_EFFECTS)
    held = {"esa_s_filter": Held(np.array([0.3]), {"time_constant_s": 41.0})}
    for about in ({}, held):
        groups = listed_groups(library, about)
        assert listed_columns(nominal[3], library, about).shape[1] == groups[-1].start + groups[-1].count
    (own,) = [group for group in groups if group.effect == "esa_s_filter"]
    assert own.parameters == {"time_constant_s": 41.0}
    last = rival_groups(0)
    assert rival_columns(nominal[3]).shape[1] == max(group.start + group.count for group in last)


# ---- the null distribution ---------------------------------------------------------------------------------------------------


def test_p_values_of_noise_are_uniform(nominal):
    search, scatter = searched(reduce(nominal))
    assert scatter == 1
    rng = np.random.default_rng(5)
    found = []
    for _ in range(60):
        y = rng.standard_normal(len(search.y))
        drawn = type(search)(search.bank, y)
        found.append(p_of_gap(drawn, seed=3))
    assert kstest(found, "uniform").pvalue > 0.01


@pytest.mark.parametrize("seed", range(11, 18))
def test_nominal_sensors_show_nothing(seed):
    found = diagnose(recorded(seed=seed), seed=seed)
    assert (found.verdict, found.present, found.causes, found.closure) == ("none", False, (), None)
    assert abs(found.mean_square - 1) < 4 * np.sqrt(2 / found.dof)
    assert found.unknown_probability == 0


# ---- what is named -----------------------------------------------------------------------------------------------------------

NAMED = [
    ("dss_head:1=0.08056,e1_deg=0.044,e2_deg=-0.008,e3_deg=0.067",),
    ("dss_head:2=0.28156",),
    ("dss_misalignment=0.22475",),
    ("dss_misalignment=0.04,m_x_deg=1,m_y_deg=0,m_z_deg=0",),
    ("esa_bias=0.19681",),
    ("esa_s_filter=0.74",),
    ("esa_s_filter=-0.5,time_constant_s=42",),
    ("esa_sun_intrusion=0.7,field_deg=4.6,time_constant_s=45",),
    ("esa_nadir=-0.3",),
    ("dss_head:2=0.2", "esa_bias=0.1"),
]


def amplitudes_of(setting):
    effect = SENSOR_EFFECTS[setting.effect]
    return effect.amplitudes(setting) if isinstance(effect, VectorEffect) else np.array([setting.size])


@pytest.mark.parametrize("effects", NAMED, ids=lambda one: "+".join(one))
def test_an_effect_is_named_with_its_size(effects):
    seen = examine(recorded(*effects, seed=3))
    settings = {one.label(): one for one in map(parse, effects)}
    assert seen.attribution.verdict == "named"
    assert {one.label for one in seen.found} == set(settings)
    for one in seen.found:
        errors = (one.held.amplitudes - amplitudes_of(settings[one.label])) / one.sigmas
        assert np.abs(errors).max() < 3.5 if errors.size > 1 else np.abs(errors).max() < 3
        assert one.sigma < 0.1 * abs(one.size)
        for name in SENSOR_EFFECTS[one.effect].refined:
            assert one.held.parameters[name] == pytest.approx(float(settings[one.label].parameters[name]), rel=0.25)


@pytest.fixture(scope="module")
def head():
    return diagnose(recorded("dss_head:2=0.28156", seed=4))


def test_the_gap_closes_on_days_left_out(head):
    found = head
    closure = found.closure
    noise = np.sqrt(2 / found.dof)
    assert closure.before > 1.5
    assert abs(closure.after - 1) < 5 * noise
    assert closure.floor == 1
    assert list(closure.by_interval["interval"]) == list(DAYS)
    rms = found.residuals.query("sensor == 'DSS-2' and angle == 'beta'")[["before_deg", "after_deg"]].pow(2).mean().pow(0.5)
    assert rms["after_deg"] < 0.01 < rms["before_deg"]


def test_heads_are_no_orthogonal_misalignment(head):
    """The other explanation is rejected by the evidence, by days left out, and by the noise."""
    found = head
    (other,) = found.rejected
    assert other.effects == ("dss_misalignment", "esa_bias")
    assert other.log_bayes_factor > 100
    assert other.p_value < 1e-20
    assert found.closure.after + 0.05 < other.after < other.before == pytest.approx(found.closure.before)
    assert all("dss_misalignment" not in cause.group for cause in found.causes)
    kept = diagnose(recorded("dss_head:2=0.28156", seed=4), library=("dss_head",))
    assert kept.verdict == "named"
    assert kept.rejected == ()


def test_a_misalignment_is_no_head():
    found = diagnose(recorded("dss_misalignment=0.22475", seed=4))
    assert [cause.label for cause in found.causes] == ["dss_misalignment"]
    assert found.rejected == ()


def test_without_the_right_effect_on_the_list_nothing_is_named():
    found = diagnose(recorded("dss_head:2=0.28156", seed=4), library=("dss_misalignment", "esa_bias"))
    assert found.verdict == "unknown"
    assert not found.causes


def by_latitude(recording):
    """The CO₂ horizon is higher toward one pole, which is on no list."""
    tables = recording.sensors
    position = tables.ephemeris.position[tables.ephemeris.rows(tables.earth.t_s)]
    sine = position[:, 2] / np.linalg.norm(position, axis=1)
    return replace(
        recording, sensors=replace(tables, earth=replace(tables.earth, angles=tables.earth.angles + 3e-3 * sine[:, None]))
    )


@pytest.mark.parametrize("how", ["transfer function", "latitude", "noise"])
def test_what_is_on_no_list_is_unknown(how):
    if how == "latitude":
        found = diagnose(by_latitude(recorded(seed=5)))
    else:
        found = diagnose(recorded(seed=5, change=_scaled if how == "transfer function" else _noisy))
    assert found.verdict == "unknown"
    assert found.present
    assert not found.causes
    assert found.unknown_probability > 0.9
    assert any("times what is stated" in note for note in found.notes) == (how == "noise")


def test_more_noise_than_stated_does_not_pass_for_evidence():
    """A head is still named with the larger sigma, and nothing beside it."""
    quiet, loud = (examine(recorded("dss_head:2=0.28156", seed=6, change=change)) for change in (None, _noisy))
    (one,), (other,) = quiet.found, loud.found
    assert other.label == "dss_head:2"
    assert other.sigma > 1.2 * one.sigma


def test_uncertain_parameters_widen_a_size():
    seen = examine(recorded("esa_s_filter=0.74,time_constant_s=42", seed=7))
    (one,) = seen.found
    (again,) = widened(seen.fits, seen.found)
    assert again.sigma == pytest.approx(one.sigma)
    fixed = {"esa_s_filter": Held(one.held.amplitudes, one.held.parameters)}
    moved = refined(seen.fits, fixed)["esa_s_filter"]
    assert moved.parameters["time_constant_s"] == pytest.approx(float(one.held.parameters["time_constant_s"]), rel=0.02)
    gram = sum(fitted.gram(held_columns(fitted, fixed))[0] for fitted in seen.fits)
    assert one.sigma > 1.3 / np.sqrt(gram[0, 0])


# ---- bad input ---------------------------------------------------------------------------------------------------------------


def test_tables_that_cannot_be_used_are_one_line():
    recording = recorded()
    tables = recording.sensors
    for sensors, message in (
        (None, "no raw sensor tables"),
        (SensorTables(tables.sun, tables.earth), "no ephemeris table"),
        (replace(tables, earth=None), "no stretch of the recording can be used"),
        (replace(tables, sun=replace(tables.sun, counts=tables.sun.counts[:, ::-1] * 0)), "no stretch"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            diagnose(replace(recording, sensors=sensors))
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no sensor effect may be named"):
        diagnose(recording, library=("bias_drift",))
