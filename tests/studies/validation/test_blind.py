"""The blind check's drawing and sealing: by case number, as strong as asked, sealed, and out of the diagnosis' sight."""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from gyrocal import GyrocalError, InputError, Recording, load
from simulator.effects import EFFECTS, REGISTRY, Effect, Setting, Stream
from simulator.effects.base import Value
from simulator.effects.common import on_axis
from simulator.scenario import load as scenario
from simulator.scenario import override
from simulator.simulate import simulate
from studies.validation.blind_check import seal, steps
from studies.validation.blind_check.cases import Drawn, Invention, Spec, by_lot, draw, kind_of, novelty
from studies.validation.blind_check.unlisted import UNLISTED

BASE = override(scenario("trmm_series"), {"gyro.sample_s": 4.0, "reference.every_s": 120.0, "gyro.arw_deg_per_sqrt_s": 1.5e-4})


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Small matrices, and cores that are shared: threads of BLAS would only wait for one another."""
    with threadpool_limits(1):
        yield


def spec(**changes: object) -> Spec:
    return Spec(**({"entropy": 5, "cases": 60, "base": BASE} | changes))


@pytest.fixture(scope="module")
def singles() -> list[Drawn]:
    """Every listed effect once, alone, from the first case that it leads."""
    one = spec(mix=(0, 1, 0, 0))
    cases: dict[str, int] = {}
    for case in range(400):
        cases.setdefault(by_lot(one.entropy, case, EFFECTS)[0], case)
    assert set(cases) == set(EFFECTS)
    return [draw(one, cases[name]) for name in EFFECTS]


def test_the_mix_is_exact_in_every_block() -> None:
    kinds = [kind_of(spec(), case)[0] for case in range(60)]
    assert [kinds[:30].count(kind) for kind in ("none", "one", "two", "unlisted")] == [6, 13, 5, 6]
    assert kinds[:30] != kinds[30:]
    assert sorted(n for kind, n in (kind_of(spec(), case) for case in range(60)) if kind == "two") == list(range(10))


def test_single_effects_are_equally_likely(singles: list[Drawn]) -> None:
    assert [one.settings[0].effect for one in singles] == list(EFFECTS)
    leads = [by_lot(3, case, EFFECTS)[0] for case in range(2400)]
    assert scipy.stats.chisquare([leads.count(name) for name in EFFECTS]).pvalue > 1e-3


class Wave(Effect):
    """A bias that nobody else has."""

    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> np.ndarray:
        return on_axis(np.sin(stream.t_s / 700.0) * 1e-6, axis)


def test_a_further_effect_changes_no_case_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which effects a case has, their axes, sizes and parameters, and the recording."""
    wave = Wave(name="wave", summary="a wave", unit="µrad/s", stage="rate", prior=(1e-4, 1e3))
    one, two = spec(mix=(0, 1, 0, 0)), spec(mix=(0, 0, 1, 0))
    before = {number: draw(two, number) for number in range(3)}
    leads = [by_lot(one.entropy, case, EFFECTS) for case in range(100)]
    # In the middle of the list, where every index after it moves.
    names = list(REGISTRY.effects.items())
    monkeypatch.setattr(REGISTRY, "effects", dict([*names[:7], ("wave", wave), *names[7:]]))
    after = [by_lot(one.entropy, case, EFFECTS) for case in range(100)]
    assert 0 < sum(lots[0] == "wave" for lots in after) < 20
    assert [[name for name in lots if name != "wave"] for lots in after] == leads
    for number, drawn in before.items():
        again = draw(two, number)
        if "wave" not in {setting.effect for setting in again.settings}:
            assert again.answer == drawn.answer
            np.testing.assert_array_equal(again.recording().gyro.rates, drawn.recording().gyro.rates)
    assert draw(one, [lots[0] for lots in after].index("wave")).answer["effects"][0]["snr"] > 3.9


def test_a_case_is_the_same_alone_as_in_a_batch() -> None:
    few, many = draw(spec(cases=8), 7), draw(spec(cases=60), 7)
    assert few.answer == many.answer
    assert (few.recording().gyro.rates == many.recording().gyro.rates).all()
    assert (few.recording().attitudes.quaternions == many.recording().attitudes.quaternions).all()


def test_entropies_share_nothing() -> None:
    first, second = draw(spec(), 3), draw(spec(entropy=6), 3)
    assert first.answer["true_G"] != second.answer["true_G"]
    assert first.world.scenario.interval[1].start_s != second.world.scenario.interval[1].start_s
    assert not np.intersect1d(first.recording().gyro.rates, second.recording().gyro.rates).size


def test_the_recording_does_not_say_what_is_in_it(singles: list[Drawn]) -> None:
    for one in singles:
        recording = one.recording()
        text = f"{recording.title} {[interval.activity for interval in recording.intervals]}"
        assert one.settings[0].effect not in text
        assert (recording.gyro.apriori_G == np.eye(3)).all()
        assert len(recording.intervals) == 6
    assert any(one.world.plain.tables for one in singles if one.settings[0].effect != "bias_temperature")


@pytest.mark.parametrize("number", range(len(EFFECTS)))
def test_the_snr_is_that_of_an_independent_computation(singles: list[Drawn], number: int) -> None:
    drawn = singles[number]
    said = drawn.answer["effects"][0]
    if said["snr"] is None:
        assert EFFECTS[said["effect"]].in_samples
        return
    assert 4 * 0.97 < said["snr"] < 40 * 1.03
    world, entropy = drawn.world, spec().entropy
    again = [simulate(world.scenario, entropy, world.case, noise=False, effects=effects) for effects in ((), drawn.settings)]
    if said["effect"] == "bias_temperature":  # its temperature begins with the recording, as it does here
        assert (again[1].tables["housekeeping"] == world.plain.tables["housekeeping"]).all(axis=None)
    assert said["snr"] == pytest.approx(independent_snr(*again, world.G, world.bias), rel=0.02)


def independent_snr(without: Recording, with_it: Recording, G: np.ndarray, bias: np.ndarray) -> float:
    """√Δχ² by plain propagation with scipy, and G and b projected out by finite differences."""
    base = residuals(without, G, bias)
    columns = []
    for k in range(12):
        step = np.zeros(12)
        step[k] = 1e-6 if k < 9 else 1e-9
        columns.append((residuals(without, G + step[:9].reshape(3, 3), bias + step[9:]) - base) / step[k])
    L = np.linalg.cholesky(covariance(without))
    H = np.linalg.solve(L, np.column_stack(columns))
    d = np.linalg.solve(L, residuals(with_it, G, bias) - base)
    scaled = H / np.linalg.norm(H, axis=0)
    return float(np.linalg.norm(d - scaled @ np.linalg.lstsq(scaled, d, rcond=None)[0]))


def parts(recording: Recording) -> list[tuple[np.ndarray, np.ndarray]]:
    """Samples and references of each interval."""
    t_s, tags = recording.gyro.t_s, recording.attitudes.t_s
    return [
        (
            np.flatnonzero((t_s >= i.start_s - 1e-6) & (t_s < i.stop_s - 1e-6)),
            np.flatnonzero((tags >= i.start_s - 1e-6) & (tags <= i.stop_s + 1e-6)),
        )
        for i in recording.intervals
    ]


def residuals(recording: Recording, G: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Propagated from the first reference against each later one, rotation vectors in inertial axes, rad."""
    out = []
    gyro, attitudes = recording.gyro, recording.attitudes
    for samples, rows in parts(recording):
        tags = attitudes.t_s[rows]
        edges = np.unique(np.concatenate([gyro.t_s[samples], tags]))
        edges = edges[(edges >= tags[0]) & (edges <= tags[-1])]
        owner = samples[np.searchsorted(gyro.t_s[samples], 0.5 * (edges[1:] + edges[:-1])) - 1]
        turns = Rotation.from_rotvec((gyro.rates[owner] @ G.T + bias) * np.diff(edges)[:, None]).as_matrix()
        reach = 1
        while reach < len(turns):  # products of all turns up to each
            turns[reach:] = turns[:-reach] @ turns[reach:]
            reach *= 2
        observed = Rotation.from_quat(attitudes.quaternions[rows])
        propagated = observed[0] * Rotation.from_matrix(turns[np.searchsorted(edges, tags[1:]) - 1])
        out.append((propagated * observed[1:].inv()).as_rotvec().ravel())
    return np.concatenate(out)


def covariance(recording: Recording) -> np.ndarray:
    """Of the residuals: reference noise at both ends, random walk between."""
    blocks = []
    attitudes = recording.attitudes
    for _, rows in parts(recording):
        turned = Rotation.from_quat(attitudes.quaternions[rows]).as_matrix()
        noise = np.einsum("kij,kj,klj->kil", turned, attitudes.sigma[rows] ** 2, turned)
        elapsed = attitudes.t_s[rows][1:] - attitudes.t_s[rows[0]]
        walk = recording.gyro.arw**2 * np.minimum.outer(elapsed, elapsed)
        count = len(rows) - 1
        blocks.append(np.kron(walk, np.eye(3)) + np.kron(np.ones((count, count)), noise[0]) + block_diag(*noise[1:]))
    return np.asarray(block_diag(*blocks))


def test_the_two_of_a_pair_are_not_alike() -> None:
    for case in range(8):
        drawn = draw(spec(mix=(0, 0, 1, 0)), case)
        first, second = drawn.answer["effects"]
        assert first["effect"] != second["effect"]
        kin = [EFFECTS[one["effect"]].kin for one in (first, second)]
        assert kin[0] != kin[1] or not kin[0]
        for one in (first, second):
            assert one["snr"] is None or one["separate_snr"] > 0.59 * one["snr"]


def test_withheld_effects_cannot_be_named() -> None:
    for case in (0, 1, 2, 3):
        drawn = draw(spec(withhold=2), case)
        assert drawn.nameable is not None
        assert drawn.settings[0].effect == list(EFFECTS)[case // 2]
        assert set(EFFECTS) - set(drawn.nameable) == {drawn.settings[0].effect}


def test_there_are_enough_unlisted_effects_and_none_is_listed() -> None:
    assert len(UNLISTED) >= 12
    assert not set(UNLISTED) & set(EFFECTS)
    assert {one.acts_on for one in UNLISTED.values()} == {"rates", "references"}


@pytest.fixture(scope="module")
def world() -> Drawn:
    return draw(spec(mix=(1, 0, 0, 0)), 0)


@pytest.mark.parametrize("name", UNLISTED)
def test_an_unlisted_effect_changes_the_data(world: Drawn, name: str) -> None:
    effect = UNLISTED[name]
    for axis in effect.axes:
        invention = Invention(effect, axis, 1e-5, 1.0, 0.5)
        changed = world.world.recording((), invention, noise=False)
        plain = world.world.plain
        rates = np.rad2deg(changed.gyro.rates - plain.gyro.rates)
        turned = np.abs(changed.attitudes.quaternions - plain.attitudes.quaternions) > 1e-10
        other = [k for k in range(3) if k != "xyz".index(axis)]
        assert not rates[:, other].any()
        assert rates.any() == (effect.acts_on == "rates")
        assert turned.any() == (effect.acts_on == "references")
        response = world.world.whitened((), invention)
        assert np.linalg.norm(response) > 1e-4  # not taken up by G, b and the start attitudes
        # and linear, or its size could not be found
        twice = world.world.whitened((), replace(invention, size=2e-5))
        assert np.linalg.norm(twice - 2 * response) < 0.02 * np.linalg.norm(twice)


def test_a_listed_effect_is_no_news_and_an_unlisted_one_is() -> None:
    drawn = draw(spec(mix=(0, 0, 0, 1)), 0)
    world = drawn.world
    known = world.whitened([Setting("bias_drift", "x", 0.1)])
    assert novelty(world.model, known) < 0.05 * np.linalg.norm(known)
    tone = world.whitened((), Invention(UNLISTED["chirp"], "y", 1e-4, 0.3, 0.5))
    assert novelty(world.model, tone) > 0.5 * np.linalg.norm(tone)


def test_a_seal_is_the_sha256_of_salt_and_canonical_answer() -> None:
    text = 'ab\n{"a":[1,0.1],"b":null}'
    assert seal.seal({"b": None, "a": [1, 0.1]}, "ab") == hashlib.sha256(text.encode()).hexdigest()
    assert seal.new_salt() != seal.new_salt()


def test_any_change_of_an_answer_breaks_its_seal() -> None:
    answer = {"case": 3, "kind": "one", "effects": [{"effect": "bias_drift", "axis": "z", "size": 0.1}], "unlisted": None}
    sealed = {"3": {"answer": answer, "salt": "ab"}}
    seals = {"3": seal.seal(answer, "ab")}
    seal.check(seals, sealed)
    changes = [
        {**answer, "kind": "two"},
        {**answer, "effects": [{"effect": "bias_drift", "axis": "z", "size": np.nextafter(0.1, 1)}]},
        {**answer, "effects": [{"effect": "bias_drift", "axis": "x", "size": 0.1}]},
        {**answer, "effects": []},
        {**answer, "more": 0},
    ]
    for changed in changes:
        with pytest.raises(InputError, match="case 3: the answer is not the one"):
            seal.check(seals, {"3": {"answer": changed, "salt": "ab"}})
    with pytest.raises(InputError, match="case 3: the answer is not the one"):
        seal.check(seals, {"3": {"answer": answer, "salt": "ac"}})
    with pytest.raises(InputError, match="case 3: no answer to its seal"):
        seal.check(seals, {})
    with pytest.raises(InputError, match="case 4: an answer without a seal"):
        seal.check(seals, sealed | {"4": sealed["3"]})


class Silent:
    """A diagnosis that never sees a gap."""

    def to_json(self) -> dict[str, object]:
        numbers = {"G": np.eye(3).tolist(), "baseline_G": np.eye(3).tolist()}
        return {
            "verdict": "none",
            "gap": {"present": False},
            "where": [],
            "causes": [],
            "unknown_probability": 0.0,
            "closure": None,
            "calibration": numbers,
            "runtime_s": np.float64(0.5),
        }


@pytest.fixture
def blind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(steps, "diagnose", lambda recording, seed, library: Silent())
    steps.make(tmp_path, spec(cases=2, mix=(1, 1, 0, 0)))
    return tmp_path


def test_the_second_step_does_without_the_answers(blind: Path) -> None:
    seals = (blind / "seals.json").read_bytes()
    shutil.move(blind / "sealed", blind.parent / f"{blind.name}-sealed")
    steps.diagnose_all(blind)
    assert pd.read_parquet(blind / "results" / "table.parquet")["case"].tolist() == [0, 1]
    assert steps.settings(blind / "results")["seals_sha256"] == hashlib.sha256(seals).hexdigest()
    shutil.move(blind.parent / f"{blind.name}-sealed", blind / "sealed")
    made = steps.score(blind).table.set_index("what")
    assert made.loc["false alarm, nothing there", ["hits", "of"]].tolist() == [0, 1]


def test_nothing_is_diagnosed_before_the_seals_are_published(blind: Path) -> None:
    (blind / "seals.json").unlink()
    with pytest.raises(InputError, match="no published seals"):
        steps.diagnose_all(blind)


def test_seals_made_afterwards_do_not_count(blind: Path) -> None:
    steps.diagnose_all(blind)
    published = json.loads((blind / "seals.json").read_text())
    sealed = json.loads((blind / "sealed" / "answers.json").read_text())
    sealed["0"]["answer"]["kind"] = "one"
    (blind / "sealed" / "answers.json").write_text(json.dumps(sealed))
    with pytest.raises(InputError, match="case 0: the answer is not the one"):
        steps.score(blind)
    published["seals"]["0"] = seal.seal(sealed["0"]["answer"], sealed["0"]["salt"])
    (blind / "seals.json").write_text(json.dumps(published))
    with pytest.raises(InputError, match="the cases were not diagnosed under the published seals"):
        steps.score(blind)


def test_steps_go_on_where_they_stopped(blind: Path) -> None:
    before = (blind / "seals.json").read_text(), (blind / "sealed" / "answers.json").read_text()
    steps.make(blind, spec(cases=2, mix=(1, 1, 0, 0)))
    assert before == ((blind / "seals.json").read_text(), (blind / "sealed" / "answers.json").read_text())
    with pytest.raises(InputError, match="not every case has a diagnosis yet"):
        steps.score(blind)
    steps.diagnose_all(blind)
    (blind / "results" / "parts" / "part-000001.parquet").unlink()
    told: list[int] = []

    @contextmanager
    def shown(study: str, total: int) -> Iterator[Any]:
        yield told.append

    steps.diagnose_all(blind, shown=shown)
    assert told == [1]
    steps.score(blind)
    with pytest.raises(InputError, match="another configuration"):
        steps.make(blind, spec(cases=3))


def test_a_case_that_cannot_be_drawn_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(steps, "draw", fails)
        with pytest.raises(GyrocalError, match="2 of 2 cases failed, the first one case 0: ZeroDivisionError: no"):
            steps.make(tmp_path, spec(cases=2, mix=(1, 1, 0, 0)))
    assert not (tmp_path / "seals.json").exists()
    assert steps.make(tmp_path, spec(cases=2, mix=(1, 1, 0, 0))).exists()


def fails(*_: object, **__: object) -> None:
    raise ZeroDivisionError("no")


def test_a_diagnosis_that_fails_is_a_result(blind: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "diagnose", fails)
    steps.diagnose_all(blind)
    made = steps.score(blind)
    assert made.rows["error"].tolist() == ["ZeroDivisionError: no"] * 2
    assert made.criteria.empty


def test_what_is_saved_is_what_was_drawn(blind: Path) -> None:
    drawn = draw(spec(cases=2, mix=(1, 1, 0, 0)), 1).recording()
    saved = load(blind / "recordings" / "case-000001")
    np.testing.assert_allclose(saved.gyro.rates, drawn.gyro.rates, rtol=1e-14)
    assert saved.title == drawn.title
