"""The effects of docs/extending.md: each is loaded from a file, simulated, and does what its text says."""

import re

import numpy as np
import pytest

import simulator
from diagnosis.diagnose import diagnose
from diagnosis.settings import DEFAULT
from simulator.effects import REGISTRY, STAGES, parse
from simulator.effects.sensor import SensorEffect
from tests import ROOT

TEXT = (ROOT / "docs" / "extending.md").read_text()
BLOCKS = {re.search(r'name="(\w+)"', block)[1]: block for block in re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)}
ASKED = {
    "bias_eclipse": "bias_eclipse:z=0.4,phase_deg=40",
    "bias_swing": "bias_swing:x=0.15,period_s=900",
    "noise_crosstalk": "noise_crosstalk:y=0.4",
    "reference_third": "reference_third:x=0.05,phase_deg=30",
    "dss_focal": "dss_focal:2=1.5",
}
SCENARIO = simulator.override(simulator.load("trmm_series"), {"gyro.sample_s": 1.0})
MONTHS = simulator.load("trmm_months")
DAYS = ("d09", "m1", "m2", "m3", "m4", "m5", "m6", "d25", "d37", "d57", "d73")
FEW = MONTHS.model_copy(update={"interval": tuple(one for one in MONTHS.interval if one.name in DAYS)})


@pytest.fixture(params=list(BLOCKS))
def example(request, tmp_path):
    """An example of the text, registered for the time of a test."""
    path = tmp_path / "mine.py"
    path.write_text(BLOCKS[request.param])
    (effect,) = REGISTRY.load_file(path)
    yield effect
    REGISTRY.remove(effect.name)


def test_there_is_an_example_of_every_kind():
    assert set(BLOCKS) == set(ASKED)
    rows = re.findall(r"^\| `(\w+)` \| .* \| `(\w+)` \|$", TEXT, flags=re.MULTILINE)
    assert rows == [(stage.name, stage.calls) for stage in STAGES]


def test_an_example_changes_what_its_kind_changes(example):
    name = example.name
    scenario = MONTHS.model_copy(update={"interval": MONTHS.interval[6:8]}) if name.startswith("dss_") else SCENARIO
    plain, changed = (simulator.simulate(scenario, seed=3, effects=one) for one in ([], [parse(ASKED[name])]))
    assert np.array_equal(changed.gyro.rates, plain.gyro.rates) == name.startswith(("dss_", "reference_"))
    assert np.array_equal(changed.attitudes.quaternions, plain.attitudes.quaternions) != name.startswith("reference_")
    if name.startswith("dss_"):
        assert (changed.sensors.sun.counts != plain.sensors.sun.counts).any()


RIVALS = (
    *("bias_step", "bias_drift", "bias_orbital", "bias_periodic", "bias_markov", "bias_random_walk", "noise_flicker"),
    *("reference_orbital", "reference_horizon", "reference_periodic", "reference_correlated", "scale_asymmetry", "time_offset"),
)


FAST = ("bias_eclipse", "noise_crosstalk")  # the others have tests of what they do


@pytest.mark.parametrize("is_against_all", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "example", [name if name in FAST else pytest.param(name, marks=pytest.mark.long) for name in ASKED], indirect=True
)
def test_an_effect_from_outside_is_named_with_its_size(example, is_against_all):
    """One file each: a rate column, a random process, a change of the samples, of the references, and of a sensor."""
    asked = parse(ASKED[example.name])
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
