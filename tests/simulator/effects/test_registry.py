"""The registry: what it refuses, plug-ins, files, and that nothing else depends on any one effect."""

import re
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import simulator
from gyrocal import InputError, load
from simulator.effects import BUILT_IN, Effect, Registry
from simulator.effects import registry as registry_module
from simulator.effects.common import put_on_axis


class Constant(Effect):
    """A bias that is always there."""

    def columns(self, stream, axis, parameters):
        return put_on_axis(np.ones(len(stream.t_s)), axis)


MINE = Constant(name="mine", summary="mine", unit="rad/s", stage="rate", prior=(1e-9, 1e-3))
FILE = """
import numpy as np
from simulator.effects import Effect
from simulator.effects.common import put_on_axis


class Constant(Effect):
    def columns(self, stream, axis, parameters):
        return put_on_axis(np.ones(len(stream.t_s)), axis)


EFFECT = Constant(name="from_file", summary="of a file", unit="rad/s", stage="rate", prior=(1e-9, 1e-3))
EFFECTS = [Constant(name="second", summary="of a file", unit="rad/s", stage="rate", prior=(1e-9, 1e-3))]
"""


@pytest.fixture
def own():
    """A registry of the built-in effects that a test may change."""
    registry = Registry()
    registry.register_all(BUILT_IN)
    return registry


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stage": "tape"}, "no stage 'tape' in the measuring chain; there are rate, random_rate, filter"),
        ({"name": "bias_drift"}, "an effect of that name already"),
        ({"prior": (0.0, 1.0)}, "prior"),
        ({"scanned": True}, "period_s"),
    ],
)
def test_what_cannot_work_is_refused_at_registration(own, changes, words):
    with pytest.raises(InputError, match=re.escape(words)):
        own.register(replace(MINE, **changes))
    own.register(MINE)
    assert own["mine"] is MINE


def entry_points_of(values):
    points = [EntryPoint(name, value, registry_module.ENTRY_POINT_GROUP) for name, value in values.items()]
    return lambda group: points if group == registry_module.ENTRY_POINT_GROUP else []


def test_plugins_are_loaded_when_first_needed(own, monkeypatch):
    monkeypatch.setattr(registry_module, "entry_points", lambda group: pytest.fail("a built-in effect needs none"))
    assert own["bias_drift"].name == "bias_drift"
    monkeypatch.setattr(registry_module, "entry_points", entry_points_of({"mine": f"{__name__}:MINE"}))
    assert own["mine"] == MINE
    assert list(own)[-1] == "mine"


def test_a_broken_plugin_is_named_and_left_out(own, monkeypatch):
    broken = {"nowhere": "no_such_package", "wrong": "math:pi", "mine": f"{__name__}:MINE"}
    monkeypatch.setattr(registry_module, "entry_points", entry_points_of(broken))
    with pytest.warns(UserWarning, match="left out") as caught:
        names = list(own)
    said = [str(one.message) for one in caught]
    assert [name in words for name, words in zip(("nowhere", "wrong"), said, strict=True)] == [True, True]
    assert len(names) == len(BUILT_IN) + 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1", "neither EFFECT nor EFFECTS"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        (FILE.replace('stage="rate"', 'stage="rates"'), "from_file: no stage 'rates'"),
    ],
)
def test_a_bad_file_is_one_line_with_its_name(own, tmp_path, text, words):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        own.load_file(path)
    assert str(caught.value).startswith(str(path))


def test_effects_of_a_file_on_the_command_line(run_cli, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    asked = ("--effects", str(path), "--effect", "second:y=1e-4")
    for _ in range(2):  # the first run leaves nothing behind
        done = run_cli("simulate", "trmm", str(tmp_path / "rec"), "--force", "--noise-free", *asked)
        assert done.exit_code == 0, done.stderr
    made = simulator.simulate(simulator.load("trmm"), noise=False)
    change = load(tmp_path / "rec").gyro.rates - made.gyro.rates
    np.testing.assert_allclose(change, np.tile([0, 1e-4, 0], (len(change), 1)), atol=1e-15)
    assert "from_file" in run_cli("effects", "--effects", str(path)).stdout
    assert "from_file" not in run_cli("effects").stdout
