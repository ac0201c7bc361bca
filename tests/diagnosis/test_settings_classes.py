"""Every number that decides something stands in the frozen settings class of its module, with a description."""

import ast
from pathlib import Path

import pytest

import diagnosis

ROOT = Path(diagnosis.__file__).parent
# Numbers of the arithmetic: they guard against rounding, zero or too much memory, or are units. They decide nothing.
ARITHMETIC = {
    *("LEAST_POSITIVE", "LEAST_TOTAL_MISFIT", "LEAST_CELL_PROBABILITY", "LEAST_MISFIT", "LEAST_TRACE", "ROOT_REGULARISATION"),
    *("DRAWS_PER_BATCH", "FOLD_COLUMNS_PER_BATCH", "RESTORED_ROWS_PER_BATCH", "PROJECTED_COLUMNS_PER_BATCH"),
    *(
        "LAPACK_BLOCK_COLUMNS",
        "MOST_BATCH_COLUMNS",
        "MOST_KEPT",
        "COLUMN_CAPACITY",
        "IMPOSSIBLE",
        "LEAST_P",
        "LARGEST_P",
        "DAY",
        "NO_TURN",
        "DIFFERENCE_STEP",
        "SLEW_TIME_MARGIN",
    ),
}
MODULES = sorted(ROOT.rglob("*.py"))
LITERAL = (ast.Constant, ast.Tuple, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop, ast.expr_context)


def has_number(node):
    return any(isinstance(one, ast.Constant) and type(one.value) in (int, float) for one in ast.walk(node))


def list_loose(tree):
    """Names in capitals that a module gives a number, by literals alone."""
    for statement in tree.body:
        if not (isinstance(statement, ast.Assign) and has_number(statement.value)):
            continue
        if all(isinstance(one, LITERAL) for one in ast.walk(statement.value)):
            names = [one.id for target in statement.targets for one in ast.walk(target) if isinstance(one, ast.Name)]
            yield from (name for name in names if name.isupper() and name not in ARITHMETIC)


@pytest.mark.parametrize("path", MODULES, ids=[str(path.relative_to(ROOT)) for path in MODULES])
def test_no_number_that_decides_is_loose(path):
    assert not list(list_loose(ast.parse(path.read_text())))


@pytest.mark.parametrize("text", ["LIMIT = 6.0", "LOW, HIGH = 1, 2.0", "SHARE = 1 + 2 * 17 / 36"])
def test_a_loose_number_is_found(text):
    assert list(list_loose(ast.parse(text)))


def list_settings():
    for path in MODULES:
        source = path.read_text()
        for node in ast.parse(source).body:
            if isinstance(node, ast.ClassDef) and node.name.endswith("Settings") and node.name != "DiagnosisSettings":
                yield path, source.splitlines(), node


def test_settings_are_frozen_and_each_field_is_described():
    """A comment stands behind a field, or above the first of some that it describes together."""
    missing = []
    for path, lines, node in list_settings():
        assert [ast.unparse(one) for one in node.decorator_list] == ["dataclass(frozen=True)"], (path, node.name)
        described = False
        for field in (one for one in node.body if isinstance(one, ast.AnnAssign)):
            above = lines[field.lineno - 2].strip()
            # In a run of fields under one comment, each is described by it.
            own = "#" in lines[field.end_lineno - 1] or above.startswith("#")
            described = own or (described and ":" in above and "#" not in above)
            if not described:
                missing.append(f"{path.relative_to(ROOT)}: {ast.unparse(field.target)}")
    assert not missing
