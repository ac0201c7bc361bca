"""Names are formed as CONTRIBUTING.md says; ``python -m tests.names --list`` shows them."""

import pytest

from tests.names import PACKAGES, WORDS, begins_with_verb, find_shared_constants, is_misformed, list_names

NAMES = list_names()


@pytest.mark.parametrize("package", PACKAGES)
def test_most_functions_begin_with_a_verb(package):
    functions = [name for name in NAMES if name.package == package and name.kind == "function"]
    assert sum(map(begins_with_verb, functions)) >= 0.7 * len(functions)


def test_no_new_name_is_a_bare_participle_or_begins_with_a_preposition():
    found = {f"{name.place.partition(':')[0]}:{name.text}" for name in NAMES if is_misformed(name)}
    assert found == WORDS["kept"]


def test_a_constant_has_one_meaning():
    assert find_shared_constants() == {}


def test_names_are_told_apart():
    texts = {name.text for name in NAMES if is_misformed(name)}
    assert "missing" in texts
    assert not {"reading", "to_json", "calibrate"} & texts
