"""The remainder as a proposed effect: a function of one regressor that predicts held-out data, written as an effect file."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.draft import SETTINGS, Draft, build_centering, build_shapes, place_knots, render_draft, suggest_draft
from diagnosis.model.prepare import prepare
from diagnosis.model.remainder import add_remainder, build_processes, estimate_remainder, summarise_remainder
from diagnosis.remainder_search import BesideRemainder
from gyrocal import InputError, save
from simulator.effects.registry import Registry
from simulator.effects.regressors import Regressor, compute_regressor, list_regressors, tabulate
from tests.diagnosis.recordings import of_rates
from tests.diagnosis_cases import CASES

SIZE = 3e-5  # rad/s
PERIODS_S = (np.array([331.0, 517.0, 411.0]), np.array([97.0, 143.0, 211.0]))


def swaying(size, seed=1, count=3000):
    """A body that sways about all axes, with a gyro x whose error is two waves over its range."""
    t_s = np.arange(count)[:, None]
    w = np.deg2rad(0.4) * sum(np.sin(2 * np.pi * t_s / period + k) for k, period in enumerate(PERIODS_S))
    made = of_rates(w, 20, 1.0, np.deg2rad(3e-4), np.deg2rad(0.004), seed)
    return replace(made, gyro=replace(made.gyro, rates=made.gyro.rates + size * wave(w[:, 0])[:, None] * [1.0, 0.0, 0.0]))


def wave(rate):
    return np.sin(2 * np.pi * rate / np.deg2rad(0.8))


def unexplained(model):
    """The remainder of a recording without any effect."""
    nothing = np.zeros((model.size, 0))
    found = estimate_remainder(model, build_processes(model), nothing)
    summary = summarise_remainder(found, 1.0, (1.0, 1.0), ())
    return BesideRemainder(add_remainder(model, found), summary, (), (), (), None, np.zeros(12), np.zeros((12, 12)))


@pytest.fixture(scope="module")
def drafted():
    model = prepare(swaying(SIZE)).model
    return model, suggest_draft(model, unexplained(model))


@pytest.fixture
def loaded(drafted, tmp_path):
    path = tmp_path / "draft.py"
    path.write_text(render_draft(drafted[1]))
    return Registry().load_file(path)[0]


def test_a_function_of_the_own_rate_is_proposed_and_closes_most_of_the_misfit(drafted):
    draft = drafted[1]
    assert draft.name == "draft_rate_x"
    assert draft.closed > 0.8
    assert draft.interval_90[0] > 0.5
    assert not draft.values[:, 1:].any()


@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.long), pytest.param(4, marks=pytest.mark.long)])
def test_nothing_is_proposed_for_recordings_without_an_effect(seed):
    model = prepare(swaying(0.0, seed)).model
    assert suggest_draft(model, unexplained(model)) is None


def test_the_file_that_is_written_is_the_function_that_was_found(drafted, loaded):
    model, draft = drafted
    column = loaded.columns(model.stream, None, {})[:, :, 0]
    truth = SIZE * wave(model.stream.rates[:, 0])
    basis = np.column_stack([np.ones(truth.size), model.stream.rates[:, 0]])  # what G and b take up
    left = [one - basis @ np.linalg.lstsq(basis, one, rcond=None)[0] for one in (truth, column[:, 0])]
    assert np.corrcoef(left)[0, 1] > 0.97
    assert np.std(left[1]) == pytest.approx(np.std(left[0]), rel=0.15)
    assert loaded.name == draft.name
    assert loaded.axes == ()


def test_without_its_regressor_the_effect_says_why_it_cannot_act(drafted, loaded):
    assert loaded.missing(drafted[0].surroundings) is None
    with pytest.raises(InputError, match="no nothing; there are rate_x"):
        compute_regressor(drafted[0].stream, "nothing")


@pytest.mark.parametrize("kind", ["gyro", "scale", "reference"])
def test_every_kind_of_draft_loads_and_has_one_column(drafted, kind, tmp_path):
    model = drafted[0]
    draft = replace(drafted[1], kind=kind, name=f"draft_{kind}", regressor=list_regressors(model.stream)["since_start"])
    path = tmp_path / "draft.py"
    path.write_text(render_draft(draft))
    effect = Registry().load_file(path)[0]
    seen, method = (model.references, effect.reference_columns) if kind == "reference" else (model.stream, effect.columns)
    assert method(seen, None, {}).shape == (seen.t_s.size, 3, 1)


def test_every_regressor_is_finite_and_every_shape_has_increasing_knots(drafted):
    model = drafted[0]
    for seen in (model.stream, model.references):
        assert all(np.isfinite(one.compute()).all() for one in list_regressors(seen).values())
    assert all((np.diff(one.knots) > 0).all() for one in build_shapes(model))


def test_what_does_not_change_has_no_knots():
    assert place_knots(np.full(9, 3.0), np.ones(9)) is None


def test_centred_values_have_no_part_that_calibration_takes_up(drafted):
    for shape in build_shapes(drafted[0]):
        if shape.name == "draft_rate_x":
            assert np.allclose(build_centering(shape) @ np.column_stack([np.ones(SETTINGS.knots), shape.knots]), 0.0, atol=1e-9)
            return


def test_a_table_is_linear_between_its_knots_and_constant_beyond():
    table = np.array([[0.0, 5.0], [2.0, 5.0]])
    assert np.allclose(tabulate(np.array([-1.0, 0.5, 3.0]), np.array([0.0, 1.0]), table), [[0, 5], [1, 5], [2, 5]])


@pytest.fixture
def answered(monkeypatch):
    """The command with an answer that holds a draft."""
    draft = Draft(
        "draft_speed", "gyro", Regressor("speed", "deg/s", "the size of the rate", lambda: np.zeros(1)), np.array([0.0, 1.0]),
        np.zeros((2, 3)), np.zeros((2, 3)), "deg/h", 0.1, 0.8, (0.7, 0.9),
    )  # fmt: skip

    def answer(recording, *, progress=None, seed=0, library=None, draft=False):
        given = replace(unexplained(prepare(swaying(0.0, 2)).model).remainder, draft=None) if draft else None
        return replace(CASES["named"](), remainder=given, draft=made if draft else None)

    made = draft
    monkeypatch.setattr("diagnosis.diagnose.diagnose", answer)


def test_the_command_writes_the_draft_and_names_it(run_cli, answered, tmp_path):
    save(swaying(0.0, 2), tmp_path / "rec")
    out = tmp_path / "draft.py"
    result = run_cli("diagnose", str(tmp_path / "rec"), "--draft", str(out), "--json", str(tmp_path / "a.json"))
    assert result.exit_code == 0, result.output
    assert "closes 80 % of the held-out misfit" in " ".join(result.output.split())
    assert Registry().load_file(out)[0].name == "draft_speed"
    assert f'"draft": "{out}"' in (tmp_path / "a.json").read_text()


def test_a_file_that_cannot_be_written_is_refused_in_one_line(run_cli, answered, tmp_path):
    save(swaying(0.0, 2), tmp_path / "rec")
    result = run_cli("diagnose", str(tmp_path / "rec"), "--draft", str(tmp_path))
    assert result.exit_code == 2
    assert result.stderr.strip().count("\n") == 0
    assert "is a folder" in result.stderr
