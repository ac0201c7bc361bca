"""The effects of docs/extending.md: each is loaded from a file, simulated, and does what its text says."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import simulator
from diagnosis.diagnose import diagnose
from diagnosis.settings import DEFAULT
from gyrocal import load
from simulator.effects import REGISTRY, STAGES, ProcessTimes, SampleView, extract_surroundings, parse, setting
from simulator.effects.recording_view import find_interval_slices
from simulator.effects.sensor import SensorEffect
from simulator.sensors.raw_tables import build_nominal_suite
from simulator.simulate import build_surroundings
from tests import ROOT

TEXT = (ROOT / "docs" / "extending.md").read_text()
BLOCKS = {re.search(r'name="(\w+)"', block)[1]: block for block in re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)}
ASKED = {
    "bias_eclipse": "bias_eclipse:z=2,phase_deg=40",
    "bias_swing": "bias_swing:x=3,period_s=900",
    "noise_crosstalk": "noise_crosstalk:y=0.4",
    "reference_third": "reference_third:x=0.1,phase_deg=30",
    "dss_focal": "dss_focal:2=1.5",
}
SCENARIO = simulator.override(simulator.load("trmm_series"), {"gyro.sample_s": 1.0})
MONTHS = simulator.load("trmm_months")
DAYS = ("d09", "m1", "m2", "m3", "m4", "m5", "m6", "d25", "d37", "d57", "d73")
FEW = MONTHS.model_copy(update={"interval": tuple(one for one in MONTHS.interval if one.name in DAYS)})


@pytest.fixture(params=list(BLOCKS))
def example(request, tmp_path):
    """An example of the text, registered for the time of a test."""
    (effect,) = REGISTRY.load_file(written(tmp_path, request.param))
    yield effect
    REGISTRY.remove(effect.name)


def one_of(name):
    """A test with one of the examples."""
    return pytest.mark.parametrize("example", [name], indirect=True)


def written(folder, name):
    """An example on file."""
    path = folder / "mine.py"
    path.write_text(BLOCKS[name])
    return path


def test_there_is_an_example_of_every_kind():
    assert set(BLOCKS) == set(ASKED)
    rows = re.findall(r"^\| `(\w+)` \| .* \| `(\w+)` \|$", TEXT, flags=re.MULTILINE)
    assert rows == [(stage.name, stage.calls) for stage in STAGES]


@pytest.mark.parametrize("name", list(BLOCKS))
def test_an_example_is_simulated_on_the_command_line(name, run_cli, tmp_path):
    path, on_sensors = written(tmp_path, name), name.startswith("dss_")
    base, chosen = ("trmm_months", MONTHS.interval[6:8]) if on_sensors else ("trmm_series", SCENARIO.interval[:3])
    scenario = tmp_path / "scenario.toml"
    write_scenario(scenario, base, [one.model_dump(exclude_none=True) for one in chosen])
    assert name in run_cli("effects", "--effects", str(path)).stdout
    made = {}
    for folder, options in {"plain": [], "with": ["--effects", str(path), "--effect", ASKED[name]]}.items():
        done = run_cli("simulate", str(scenario), str(tmp_path / folder), "--seed", "3", *options)
        assert done.exit_code == 0, done.stderr
        made[folder] = load(tmp_path / folder)
    assert name not in REGISTRY
    plain, changed = made["plain"], made["with"]
    assert np.array_equal(changed.gyro.rates, plain.gyro.rates) == (on_sensors or name.startswith("reference_"))
    assert np.array_equal(changed.attitudes.quaternions, plain.attitudes.quaternions) != name.startswith("reference_")
    if on_sensors:
        assert (changed.sensors.sun.counts != plain.sensors.sun.counts).any()


def write_scenario(path, base, intervals):
    """A scenario with some of the intervals of another one."""
    lines = [f'base = "{base}"']
    for one in intervals:
        slews = one.pop("slew", ())
        lines += ["[[interval]]", *(f"{key} = {value!r}" for key, value in one.items() if not isinstance(value, dict))]
        for slew in slews:
            slew["axis"] = list(slew["axis"])
            lines += ["[[interval.slew]]", *(f"{key} = {value!r}" for key, value in slew.items())]
    path.write_text("\n".join(lines).replace("'", '"'))


@one_of("bias_swing")
def test_the_swing_has_its_covariance(example):
    path = simulator.motion(SCENARIO)
    stream = build_surroundings(simulator.simulate(SCENARIO, noise=False), path).stream
    few = slice(0, 3000, 250)
    short = replace(
        stream, t_s=stream.t_s[few], duration_s=stream.duration_s[few], raw=stream.raw[few], rates=stream.rates[few]
    )
    made, rng = parse(ASKED["bias_swing"]), np.random.default_rng(2)
    draws = np.array([example.wander(rng, short, made)[:, 0] for _ in range(3000)])
    expected = 9 * example.covariance(ProcessTimes(short.t_s, short.t_s, np.zeros(12, dtype=int)), made.parameters)
    np.testing.assert_allclose(draws.T @ draws / 3000, expected, atol=6 * math.sqrt(2 / 3000) * expected[0, 0])


def view_of(recording):
    """The samples of a recording as an effect's own test sees them."""
    around = extract_surroundings(recording, np.eye(3), np.zeros(3))
    inside = np.zeros(recording.gyro.t_s.size, dtype=bool)
    for one in find_interval_slices(recording):
        inside[one] = True
    sigma = np.full(3, recording.gyro.arw / math.sqrt(recording.gyro.sample_s))
    return SampleView(
        around.stream.t_s, recording.gyro.sample_s, recording.gyro.rates, sigma, inside, find_interval_slices(recording),
        np.full_like(recording.gyro.rates, np.nan),
    )  # fmt: skip


@one_of("noise_crosstalk")
def test_the_crosstalk_is_found_by_its_own_test_and_only_where_it_is(example):
    plain = simulator.simulate(SCENARIO, seed=3)
    assert example.detect(view_of(plain)) == []
    for size in (0.4, -0.1):
        made = simulator.simulate(SCENARIO, seed=3, effects=[setting("noise_crosstalk", "y", size)])
        (found,) = example.detect(view_of(made))
        assert (found.effect, found.axis) == ("noise_crosstalk", "y")
        assert abs(found.size - size) < 3 * found.sigma
        assert found.log_odds > 10
        assert np.std(made.gyro.rates[:, 1]) == pytest.approx(np.std(plain.gyro.rates[:, 1]), rel=1e-3)


@one_of("dss_focal")
def test_the_sun_sensor_reads_high_as_its_error_says(example):
    """At some angles, by the counts that the changed sensor gives and the nominal one reads."""
    made = parse(ASKED["dss_focal"])
    nominal = build_nominal_suite(0.0, 0.0)
    changed = example.fitted(nominal, made)
    before, after = nominal.sun_sensors[1], changed.sun_sensors[1]
    assert nominal.sun_sensors[0] is changed.sun_sensors[0]
    counts = np.arange(3000.0, 14000.0, 500.0)
    read, true = (tangent(sensor.coefficients_alpha, counts) for sensor in (before, after))
    angles = np.column_stack([np.arctan(true), np.zeros(counts.size)])
    sightings = SimpleNamespace(
        sun_sensor=np.full(counts.size, 2), sun_angles=angles, nothing=(np.zeros(angles.shape), np.zeros((0, 4)))
    )
    error, _ = example.error(sightings, "2", example.amplitudes(made), {})
    np.testing.assert_allclose(error[:, 0], np.arctan(read) - np.arctan(true), atol=1e-12)
    assert np.abs(error).max() > 1e-3


def tangent(k, count):
    """tan(α − a₉) of R (5)."""
    return k[0] + k[1] * count + k[2] * np.sin(k[3] * count + k[4]) + k[5] * np.sin(k[6] * count + k[7])


SEEN = {
    "bias_eclipse": "bias_eclipse:z=0.4,phase_deg=40",
    "bias_swing": "bias_swing:x=0.15,period_s=900",
    "noise_crosstalk": "noise_crosstalk:y=0.4",
    "reference_third": "reference_third:x=0.05,phase_deg=30",
    "dss_focal": "dss_focal:2=1.5",
}


RIVALS = (
    *("bias_step", "bias_drift", "bias_orbital", "bias_periodic", "bias_markov", "bias_random_walk", "noise_flicker"),
    *("reference_orbital", "reference_horizon", "reference_periodic", "reference_correlated", "scale_asymmetry", "time_offset"),
)


FAST = ("bias_eclipse", "noise_crosstalk")  # the others have tests of what they do


@pytest.mark.parametrize("is_against_all", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "example", [name if name in FAST else pytest.param(name, marks=pytest.mark.long) for name in SEEN], indirect=True
)
def test_an_effect_from_outside_is_named_with_its_size(example, is_against_all):
    """One file each: a rate column, a random process, a change of the samples, of the references, and of a sensor."""
    asked = parse(SEEN[example.name])
    every_s = 90.0 if example.name in ("bias_swing", "reference_third") else 120.0  # they swing fast
    series = simulator.override(SCENARIO, {"reference.every_s": every_s})
    on_sensors = isinstance(example, SensorEffect)
    rivals = [name for name, one in REGISTRY.items() if isinstance(one, SensorEffect)] if on_sensors else RIVALS
    library = None if is_against_all else [example.name, *(name for name in rivals if name != example.name)]
    answer = diagnose(simulator.simulate(FEW if on_sensors else series, seed=1, effects=[asked]), library=library)
    (cause,) = answer.causes
    assert (cause.effect, cause.axis) == (asked.effect, asked.axis)
    assert cause.group == (cause.label,)
    # A remainder may stand in the place of a random process, whatever the data.
    random = not on_sensors and example.is_process
    assert cause.probability > (0.95 * (1 - DEFAULT.unlisted_share) if random else 0.8)
    assert abs(cause.size - asked.size) < 3 * cause.sigma
