"""The linear model of raw sensor tables: its columns against the simulator, its rows against the covariance of the noise."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.inference.amplitudes import fit
from diagnosis.inference.search import Search
from diagnosis.model.sensors.arcs import build_arcs, fit_arc
from diagnosis.model.sensors.columns import (
    HeldAmplitudes,
    build_groups,
    build_held_columns,
    compute_held_error,
)
from diagnosis.model.sensors.refine import refine_parameters
from diagnosis.model.sensors.tables import build_sensor_model, build_tables
from diagnosis.settings import DEFAULT
from simulator.effects.sensor import SENSOR_EFFECTS, dss_head, esa_bias, parse
from simulator.sensors.raw_tables import build_nominal_suite, simulate_sensor_tables
from simulator.sensors.sun import compute_head_tangents
from simulator.simulate import motion, simulate
from simulator.truth.rotation import convert_to_matrix
from tests.diagnosis.sensor_cases import EFFECTS, ONE, fits_of, recorded


def columns_of(groups):
    return np.hstack([part for group in groups for part in group.columns])


def angles_shown(suite, recording, truth):
    """Angles of both sun sensors at their tags before they are counted, by the simulator's own kernel."""
    A, parts = convert_to_matrix(truth.sensor_quaternions), []
    ephemeris = recording.sensors.ephemeris
    for number, sensor in enumerate(suite.sun_sensors, start=1):
        rows = ephemeris.rows(recording.sensors.sun.select_sensor(number)[0])
        s = np.einsum("nij,nj->ni", A[rows], ephemeris.sun[rows]) @ sensor.alignment
        parts.append(np.arctan([compute_head_tangents(*one, sensor.head) for one in s]).reshape(-1, 2))
    return parts


def taken_off(arc, recording, before, after, earth):
    """The arc fitted with what an effect adds, as the simulator makes it, on top of the measurements."""
    sun = []
    for number, old, new in zip((1, 2), before, after, strict=True):
        if number in arc.numbers:
            t = recording.sensors.sun.select_sensor(number)[0]
            own = (t >= arc.series[arc.numbers.index(number)].t[0]) & (t <= arc.series[arc.numbers.index(number)].t[-1])
            sun.append((new - old)[own])
    table = recording.sensors.earth
    own = (table.t_s >= arc.sightings.t_s[0]) & (table.t_s <= arc.sightings.t_s[-1])
    return fit_arc(arc, -np.concatenate(sun), -np.where(arc.sightings.used, earth[own], 0.0))


@pytest.mark.parametrize("text", ["dss_head:2=1", "dss_misalignment=1", "esa_s_filter=1", "esa_nadir=1"])
def test_columns_are_differences_of_the_simulation(text):
    """Every amplitude, against ± a step of it put through simulator and fit; what epoch attitude and bias take is left out."""
    setting = parse(text)
    effect, h = SENSOR_EFFECTS[setting.effect], 0.02
    recording, truth = simulate(ONE, noise=False), motion(ONE)
    plain = build_nominal_suite(0.0, 0.0)
    nominal_angles = angles_shown(plain, recording, truth)
    (arc,) = build_arcs(recording)[0]
    start = fit_arc(arc)
    for k in range(effect.count):
        both = []
        for way in (1, -1):
            size, parameters = effect.from_amplitudes(way * h * np.eye(effect.count)[k]) if effect.count > 1 else (way * h, {})
            changed = replace(setting, size=size, parameters={**setting.parameters, **parameters})
            earth = simulate_sensor_tables(ONE, truth, [changed], noise=False).earth.angles - recording.sensors.earth.angles
            shown = angles_shown(effect.fitted(plain, changed), recording, truth)
            both.append(taken_off(arc, recording, nominal_angles, shown, earth))
        difference = (both[0].rows.z - both[1].rows.z) / (2 * h)
        own = build_held_columns(start, {setting.label(): HeldAmplitudes(np.zeros(effect.count), setting.parameters)})[:, k]
        compared = replace(start, rows=replace(start.rows, z=difference - own))
        gram, _ = compared.gram(own[:, None])
        assert gram[0, 0] > 1
        assert gram[1, 1] < 1e-4 * gram[0, 0]


def test_products_are_those_of_the_full_covariance_and_of_all_measurements():
    """Mᵀ V⁻¹ M with noise and the gyro's walk in V, epoch attitude and bias projected out, done densely."""
    (fitted,) = fits_of(simulate(ONE, seed=2))
    X = columns_of(build_groups(fitted, [dss_head.EFFECT, esa_bias.EFFECT], {}))
    rows, q = fitted.rows, fitted.path.q
    later = np.arange(len(q))[None, :] < rows.node[:, None]
    walk = np.einsum("ri,rk,k->rki", rows.attitude, later, q).reshape(len(rows.z), -1)
    V = np.eye(len(rows.z)) + walk @ walk.T
    nuisance = np.column_stack([rows.attitude, rows.parameters])
    M = np.column_stack([X, rows.z])
    inverse = np.linalg.inv(V)
    cross = nuisance.T @ inverse @ M
    expected = M.T @ inverse @ M - cross.T @ np.linalg.solve(nuisance.T @ inverse @ nuisance, cross)
    gram, dof = fitted.gram(X)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(gram / scale, expected / scale, atol=1e-7)
    assert dof == len(rows.z) - 6
    nominal = fits_of(recorded())
    tables = build_tables(nominal[:3], EFFECTS)
    for number, fitted in enumerate(nominal[:3]):
        own = tables.owner == number
        gram, dof = fitted.gram(columns_of(build_groups(fitted, EFFECTS, {})))
        rows = np.column_stack([columns_of(tables.groups)[own], tables.y[own]])
        scale = np.sqrt(np.maximum(np.outer(np.diag(gram), np.diag(gram)), 1e-30))
        np.testing.assert_allclose(rows.T @ rows / scale, gram / scale, atol=1e-9)
        assert tables.dof[number] == dof


def test_uncertain_parameters_widen_a_size():
    fits = fits_of(recorded("esa_s_filter=0.74,time_constant_s=42", seed=7))
    held = refine_parameters(fits, {"esa_s_filter": HeldAmplitudes(np.array([0.5]), {"time_constant_s": 60.0})})
    again = refine_parameters(fits, held)
    constant = float(held["esa_s_filter"].parameters["time_constant_s"])
    assert constant == pytest.approx(42, rel=0.1)
    assert again["esa_s_filter"].parameters["time_constant_s"] == pytest.approx(constant, rel=0.02)
    effects = [SENSOR_EFFECTS["esa_s_filter"]]
    after = [fit_arc(one.arc, *compute_held_error(one.arc.sightings, held)) for one in fits]
    model = build_sensor_model(build_tables(after, effects, held), effects, DEFAULT)
    (one,) = fit(model, Search(model).find_explanation(("esa_s_filter",)).members)
    column = model.X[:, model.candidates[0].options[0].columns]
    assert one.sigma > 1.3 / np.linalg.norm(column)
    # The same from the derivative by the time constant as a column of its own, with a size that is fitted beside it.
    moved = [
        {"esa_s_filter": HeldAmplitudes(held["esa_s_filter"].amplitudes, {"time_constant_s": constant * np.exp(way * 0.05)})}
        for way in (1, -1)
    ]
    total = 0
    for fitted in fits:
        high, low = (build_held_columns(fitted, at)[:, 0] * held["esa_s_filter"].amplitudes[0] for at in moved)
        gram, _ = fitted.gram(np.column_stack([build_held_columns(fitted, held)[:, 0], (high - low) / 0.1]))
        total = total + gram[:2, :2]
    assert one.sigma == pytest.approx(np.sqrt(np.linalg.inv(total)[0, 0]), rel=0.1)
