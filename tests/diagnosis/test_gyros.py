"""Faults of one of several gyros are named with and without reference attitudes, and what cannot be told is a group."""

from dataclasses import replace

import numpy as np
import pytest

import simulator
from diagnosis.diagnose import diagnose
from diagnosis.gyros import NOTHING_TO_SEE, find_faulty_gyros
from diagnosis.inference.attribution import Attribution, RankedExplanation
from diagnosis.inference.search import Explanation
from diagnosis.settings import DEFAULT
from gyrocal import InputError
from gyrocal.recording.parts import build_empty_attitudes
from simulator.effects import parse
from tests.gyro_arrays import TETRAHEDRON, array_recording

SIX = simulator.override(simulator.load("trmm_six"), {"gyro.sample_s": 4.0, "reference.at": "none"})
FOUR = simulator.override(simulator.load("trmm_tetrahedron"), {"gyro.sample_s": 4.0, "reference.every_s": 600.0})


LIBRARY = ("bias_step", "bias_drift", "gyro_scale_step", "gyro_dead", "noise_excess")  # all of them take a minute


def answer(scenario, *texts):
    return diagnose(simulator.simulate(scenario, seed=11, effects=[parse(text) for text in texts]), library=LIBRARY)


def test_without_a_fault_nothing_is_found_by_parity_alone():
    found = answer(SIX)
    assert found.verdict == "none"
    assert found.gyros == ("1", "2", "3", "4", "5", "6")
    assert np.shape(found.G) == (3, 6)
    assert any("No reference attitudes" in note for note in found.notes)


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("gyro_scale_step:2=1500,time_s=21000", "gyro_scale_step:2"),
        ("gyro_dead:6=0,time_s=20000", "gyro_dead:6"),
        pytest.param("bias_step:4=1.5,time_s=12900", "bias_step:4", marks=pytest.mark.long),
        pytest.param("noise_excess:5=1.6", "noise_excess:5", marks=pytest.mark.long),
    ],
)
def test_six_gyros_name_the_faulty_one_without_a_reference(text, label):
    found = answer(SIX, text)
    assert [cause.axis for cause in found.causes] == [label[-1]]
    assert label in found.causes[0].group
    assert {name.rpartition(":")[2] for name in found.causes[0].group} == {label[-1]}
    size = parse(text).size
    if found.causes[0].label == label:
        assert abs(found.causes[0].size - size) < 4 * found.causes[0].sigma + 1e-12


def test_four_gyros_see_a_step_without_a_reference_but_not_whose():
    bare = simulator.override(FOUR, {"reference.at": "none"})
    found = answer(bare, "bias_step:3=3,time_s=12900")
    assert found.verdict in ("group", "unknown")
    assert found.present
    assert not any(cause.group == ("bias_step:3",) for cause in found.causes)


def test_four_gyros_and_references_name_the_faulty_one():
    found = answer(FOUR, "bias_step:3=3,time_s=12900")
    assert {name.rpartition(":")[2] for cause in found.causes for name in cause.group} == {"3"}
    assert found.closure is not None
    assert found.closure.closed > 0.5
    assert any(finding.signal == "parity" for finding in found.where)


def test_of_four_with_a_dead_one_three_are_left():
    found = answer(FOUR, "gyro_dead:2=0,time_s=20000")
    assert [cause.label for cause in found.causes] == ["gyro_dead:2"]
    assert any("left out" in note for note in found.notes)
    bare = answer(simulator.override(FOUR, {"reference.at": "none"}), "gyro_dead:2=0,time_s=20000")
    assert [cause.label for cause in bare.causes] == ["gyro_dead:2"]


def test_a_gyro_is_told_where_its_fault_is_not():
    shares = {("a of a gyro:1",): 0.5, ("bias_step:1",): 0.4, ("bias_step:1", "bias_drift:2"): 0.06, ("late:x",): 0.04}
    ranked = tuple(RankedExplanation(labels, share, 1.0, False) for labels, share in shares.items())
    best = Explanation((), 0.0, 0.0)
    unknown = replace(NOTHING_TO_SEE, attribution=Attribution("unknown", best, (), 0.5, ranked))
    (found,) = find_faulty_gyros(unknown, ("1", "2", "3"), DEFAULT)
    assert (found.axis, found.signal) == ("1", "gyro")
    assert found.value == pytest.approx(0.96)
    assert not find_faulty_gyros(unknown, ("1", "2", "3"), replace(DEFAULT, named=0.97))
    assert not find_faulty_gyros(NOTHING_TO_SEE, ("1", "2", "3"), DEFAULT)


def test_what_cannot_be_compared_is_said():
    recording, *_ = array_recording(TETRAHEDRON)
    with pytest.raises(InputError, match="no gyro noise"):
        diagnose(recording)
    three, *_ = array_recording(TETRAHEDRON, gyros=[("1", "2", "3")] * 6)
    alone = replace(three, gyro=replace(three.gyro, arw=1e-6), attitudes=build_empty_attitudes())
    with pytest.raises(InputError, match="nothing to compare with"):
        diagnose(alone)
