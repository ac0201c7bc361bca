"""Diagnoses of raw sensor tables: what nominal sensors show, what is named, and what is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from diagnosis.inference.null import compute_null_p
from diagnosis.inference.search import Search
from diagnosis.model.sensors.tables import build_sensor_model, build_tables, estimate_sensor_noise
from diagnosis.sensor_tables import diagnose_sensors, explain_tables
from diagnosis.settings import DEFAULT
from gyrocal.errors import InputError
from gyrocal.recording.sensor_tables import SensorTables
from simulator.effects.sensor import SENSOR_EFFECTS, dss_head, parse
from simulator.effects.sensor.base import VectorEffect
from studies.robertson.heads import _scale_alpha_counts, _scale_earth_noise
from tests.diagnosis.sensor_cases import DAYS, EFFECTS, fits_of, recorded

HEAD = "dss_head:2=0.28156"


def diagnose(recording, effects=EFFECTS, seed=0):
    return diagnose_sensors(recording, effects, seed=seed)


def test_p_values_of_noise_are_uniform():
    model = build_sensor_model(build_tables(fits_of(recorded()), EFFECTS), EFFECTS, DEFAULT)
    assert estimate_sensor_noise(model, DEFAULT).factor == 1
    rng = np.random.default_rng(5)
    found = [compute_null_p(Search(replace(model, y=rng.standard_normal(model.y.size))), seed=3, draws=150) for _ in range(60)]
    assert kstest(found, "uniform").pvalue > 0.01


def test_nominal_sensors_show_nothing():
    found = diagnose(recorded(seed=11), seed=11)
    assert (found.verdict, found.present, found.causes, found.closure) == ("none", False, (), None)
    assert abs(found.mean_square - 1) < 4 * np.sqrt(2 / found.dof)
    assert found.unknown_probability == 0


NAMED = [
    ("esa_s_filter=-0.5,time_constant_s=42",),
    ("dss_misalignment=0.22475",),
    ("dss_head:2=0.2", "esa_bias=0.1"),
]


def amplitudes_of(setting):
    effect = SENSOR_EFFECTS[setting.effect]
    return effect.amplitudes(setting) if isinstance(effect, VectorEffect) else np.array([setting.size])


@pytest.mark.parametrize("effects", NAMED, ids=lambda one: "+".join(one))
def test_an_effect_is_named_with_its_size(effects):
    seen = explain_tables(recorded(*effects, seed=3), EFFECTS).inference
    settings = {one.label(): one for one in map(parse, effects)}
    assert seen.attribution.verdict == "named"
    assert {one.label for one in seen.fitted} == set(settings)
    for one in seen.fitted:
        errors = (one.amplitudes - amplitudes_of(settings[one.label])) / one.sigmas
        assert np.abs(errors).max() < 3.5 if errors.size > 1 else np.abs(errors).max() < 3
        assert one.sigma < 0.1 * abs(one.size)
        for name in SENSOR_EFFECTS[one.effect].refined:
            assert one.parameters[name] == pytest.approx(float(settings[one.label].parameters[name]), rel=0.25)


def test_a_head_closes_the_gap_and_is_no_orthogonal_misalignment():
    found = diagnose(recorded(HEAD, seed=4))
    closure = found.closure
    assert closure.before > 1.5
    assert abs(closure.after - 1) < 5 * np.sqrt(2 / found.dof)
    assert closure.floor == 1
    assert list(closure.by_interval["interval"]) == list(DAYS)
    rms = found.residuals.query("sensor == 'DSS-2' and angle == 'beta'")[["before_deg", "after_deg"]].pow(2).mean().pow(0.5)
    assert rms["after_deg"] < 0.01 < rms["before_deg"]
    # The other explanation is rejected by the evidence, by days left out, and by the noise.
    (other,) = found.rejected
    assert other.effects == ("dss_misalignment", "esa_bias")
    assert other.log_bayes_factor > 100
    assert other.p_value < 1e-20
    assert found.closure.after + 0.05 < other.after < other.before == pytest.approx(found.closure.before)
    assert all("dss_misalignment" not in cause.group for cause in found.causes)
    kept = diagnose(recorded(HEAD, seed=4), [dss_head.EFFECT])
    assert kept.verdict == "named"
    assert kept.rejected == ()


@pytest.mark.parametrize("how", ["transfer function", "noise"])
def test_what_is_on_no_list_is_unknown(how):
    found = diagnose(recorded(seed=5, change=_scale_alpha_counts if how == "transfer function" else _scale_earth_noise))
    assert found.verdict == "unknown"
    assert found.present
    assert not found.causes
    assert found.unknown_probability > 0.9
    assert any("times what is stated" in note for note in found.notes) == (how == "noise")


def thin_out(recording):
    """Keep every third reading of the sensors, which is enough to see that nothing fits."""
    sun, earth = recording.sensors.sun, recording.sensors.earth
    sun = replace(sun, t_s=sun.t_s[::3], sensor=sun.sensor[::3], counts=sun.counts[::3])
    earth = replace(earth, t_s=earth.t_s[::3], angles=earth.angles[::3], used=earth.used[::3])
    return replace(recording, sensors=replace(recording.sensors, sun=sun, earth=earth))


def test_tables_that_fit_nothing_are_unknown():
    """The two heads of each sun sensor are exchanged."""
    recording = thin_out(recorded())
    tables = recording.sensors
    exchanged = replace(tables, sun=replace(tables.sun, counts=tables.sun.counts[:, ::-1]))
    found = diagnose(replace(recording, sensors=exchanged))
    assert (found.verdict, found.present, found.unknown_probability) == ("unknown", True, 1.0)
    assert not found.causes
    assert "do not fit the nominal sensors" in found.where[0].text
    assert found.where[0].p_value < 1e-100
    assert found.to_json()["mean_square"] is None


def test_tables_that_cannot_be_used_are_one_line():
    recording = recorded()
    tables = recording.sensors
    for sensors, message in (
        (None, "no raw sensor tables"),
        (SensorTables(tables.sun, tables.earth), "no ephemeris table"),
        (replace(tables, earth=None), "no arc of the recording can be used"),
        (replace(tables, sun=replace(tables.sun, counts=0 * tables.sun.counts)), "Too few sensor measurements"),
    ):
        with pytest.raises(InputError, match=message):
            diagnose(replace(recording, sensors=sensors))
