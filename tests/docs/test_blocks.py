"""Blocks of the pages run as they stand; those with something to compare have tests of their own, listed here."""

import re
import tomllib

import pytest

import gyrocal
import simulator
from gyrocal import importing
from tests import ROOT
from tests.docs import world
from tests.docs.blocks import FENCE, PAGES, blocks

RUN = ("docs/calibrate.md", "docs/conventions.md")
ELSEWHERE = {  # by page and language, the test that runs or reads it
    ("README.md", "python"): "tests/test_docs.py",
    ("docs/allan.md", "python"): "tests/studies/allan/test_allan.py",
    ("docs/broad.md", "python"): "tests/test_docs.py",
    ("docs/compare.md", "toml"): "tests/test_docs.py",
    ("docs/diagnosis.md", "json"): "tests/studies/cli/test_diagnose.py",
    ("docs/diagnosis.md", "python"): "tests/docs/test_blocks.py",
    ("docs/extending.md", "python"): "tests/test_extending.py",
    ("docs/extending.md", "toml"): "tests/docs/test_blocks.py",
    ("docs/gyros.md", "python"): "tests/test_docs.py",
    ("docs/import.md", "python"): "tests/studies/cli/test_import_csv.py",
    ("docs/import.md", "toml"): "tests/docs/test_blocks.py",
    ("docs/library.md", "python"): "tests/gyrocal/recording/test_arrays.py",
    ("docs/own_study.md", "python"): "tests/studies/cli/test_own_study.py",
    ("docs/plan.md", "toml"): "tests/docs/world.py",
    ("docs/requirements.md", "python"): "tests/studies/montecarlo/test_dispersions.py",
    ("docs/requirements.md", "toml"): "tests/studies/montecarlo/test_dispersions.py",
    ("docs/predict.md", "python"): "tests/gyrocal/estimation/test_predict.py",
    ("docs/recording.md", "python"): "tests/test_docs.py",
    ("docs/recording.md", "toml"): "tests/test_docs.py",
    ("docs/references.md", "python"): "tests/test_docs.py",
    ("docs/scenario.md", "toml"): "tests/test_docs.py",
    ("docs/tutorial.md", "python"): "tests/docs/test_commands.py",
}
OUTLINES = {"docs/references.md"}  # a fence of calls whose arguments the text before it makes


@pytest.mark.parametrize("page", RUN)
def test_a_block_runs(page, tmp_path, capsys):
    world.namespace(page, tmp_path)
    assert blocks(page, "python")


def test_the_diagnosis_in_python_is_that_of_the_command(tmp_path, capsys):
    scenario = simulator.override(simulator.load("trmm_series"), {"gyro.sample_s": 10.0, "reference.every_s": 600.0})
    effect = simulator.effects.parse("bias_orbital:z=0.5")
    gyrocal.save(simulator.simulate(scenario, seed=1, effects=[effect]), tmp_path / "rec")
    world.namespace("docs/diagnosis.md", tmp_path)
    assert capsys.readouterr().out == "named ['bias_orbital:z']\n"


def test_the_mapping_of_the_import_is_one():
    (block,) = blocks("docs/import.md", "toml")
    entries = tomllib.loads(block)
    assert importing.validate_mapping(entries, "the page").model_dump(exclude_none=True, exclude_defaults=True) == entries


def test_the_entry_point_of_an_effect_is_the_group_that_is_read():
    (block,) = blocks("docs/extending.md", "toml")
    (group,) = tomllib.loads(block)["project"]["entry-points"]
    assert f'"{group}"' in (ROOT / "simulator" / "effects" / "registry.py").read_text()


def test_every_block_has_a_test():
    """No page gains a block that nothing runs."""
    found = {
        (page, language)
        for page in PAGES
        for language, _ in FENCE.findall((ROOT / page).read_text(encoding="utf-8"))
        if language in ("python", "toml", "json") and page not in RUN and not page.startswith("docs/formats/")
    }
    assert found == set(ELSEWHERE)
    for (page, language), file in ELSEWHERE.items():
        text = (ROOT / file).read_text(encoding="utf-8")
        name = page.rsplit("/", 1)[-1]
        assert name in text, (page, file)
        assert language in text or file == "tests/test_extending.py", (page, file)


def test_other_fences_are_commands_or_what_commands_answer():
    kinds = {language for page in PAGES for language, _ in FENCE.findall((ROOT / page).read_text(encoding="utf-8"))}
    assert kinds <= {"", "sh", "python", "toml", "json", "{toctree}", "{literalinclude}", "{eval-rst}"}
    calls = {page for page in PAGES if any(re.search(r"^\w+\(", body, flags=re.MULTILINE) for body in blocks(page, ""))}
    assert calls == OUTLINES


def test_conventions_state_what_the_package_states():
    """The signs of the page are those that the package's own text has."""
    page, own = (ROOT / "docs" / "conventions.md").read_text(), gyrocal.__doc__
    for sign in (
        "dA/dt = −[ω×] A",
        "ω = G ω_raw + b",
        "exp([θ×]) = A_obs A_propᵀ",
        "Δx = x_adj − x_true",
        "y against the orbit",
    ):
        assert sign in page
        assert sign in own
