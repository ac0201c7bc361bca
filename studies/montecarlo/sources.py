"""The sources that make a study's rows, each by its hash: rows of an edited case function must not stand beside older ones.

What counts is what the study reaches: of its own module the definitions that STUDY uses, directly or through others, so that a
report beside the case function may change; all of every module of our packages that these import, inside functions too; the
other modules in the folder of a study that is a single file; and data files beside those modules in our packages. Comments and
docstrings do not count. A module that is imported by a name put together at run time is not seen.
"""

import ast
import hashlib
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import gyrocal
from studies.montecarlo.study import Study

PACKAGES = ("gyrocal", "simulator", "diagnosis", "studies")
DATA = (".csv", ".json", ".toml")
HOLDING = ("body", "orelse", "finalbody", "handlers", "cases")  # what in a statement holds others
DIGITS = 16  # of a hash, in hexadecimal
PROJECT = Path(gyrocal.__file__).resolve().parents[1]


@lru_cache(maxsize=64)
def sources(study: Study) -> dict[str, str]:
    """Hash of each source of a study, by its path in the folder that it is imported from.

    They are read once a process for the same functions: what this process has loaded is as old as that.
    """
    module = study.name.partition(":")[0]
    path, body = _own(study)
    home = path.parents[module.count(".") + (path.name == "__init__.py")]
    found = {str(path.relative_to(home)): _hash(body)}
    waiting = list(_imported(body, module, path.name == "__init__.py"))
    seen = {module}
    while waiting:
        name = waiting.pop()
        place = None if name in seen else _place(name, module, home)
        seen.add(name)
        if place is None:
            continue
        text, data, names = _module(name, place)
        found[name.replace(".", "/") + ("/__init__.py" if place.name == "__init__.py" else ".py")] = text
        found |= data
        # A package is run before what is in it.
        waiting += [*names, name.rpartition(".")[0]]
    return dict(sorted(found.items()))


@lru_cache(maxsize=64)
def module_sources(module: str) -> dict[str, str]:
    """Hash of a module of ours and of all that it imports, by path; packages count only where they are imported themselves."""
    found: dict[str, str] = {}
    waiting, seen = [module], set()
    while waiting:
        name = waiting.pop()
        place = None if name in seen else _place(name, module, PROJECT)
        seen.add(name)
        if place is not None:
            text, data, names = _module(name, place)
            found |= {str(place.relative_to(PROJECT)): text, **data}
            waiting += names
    return dict(sorted(found.items()))


@lru_cache(maxsize=64)
def uses_attribute(study: Study, name: str) -> bool:
    """Whether what a study reaches in its own module reads an attribute of that name."""
    nodes = (node for statement in _own(study)[1] for node in ast.walk(statement))
    return any(isinstance(node, ast.Attribute) and node.attr == name for node in nodes)


def _own(study: Study) -> tuple[Path, list[ast.stmt]]:
    """File of a study's module, and those of its statements that the study depends on."""
    module, _, attribute = study.name.partition(":")
    path = Path(str(sys.modules[module].__file__)).resolve()
    return path, _reached(ast.parse(path.read_bytes()).body, attribute)


@lru_cache(maxsize=1024)
def _module(name: str, path: Path) -> tuple[str, dict[str, str], tuple[str, ...]]:
    """Hash of a module, of the data files beside it if it is ours, and the names that it may import."""
    body = ast.parse(path.read_bytes()).body
    beside = sorted(file for file in path.parent.iterdir() if file.suffix in DATA) if name.split(".")[0] in PACKAGES else []
    data = {str(file.relative_to(PROJECT)): hashlib.sha256(file.read_bytes()).hexdigest()[:DIGITS] for file in beside}
    return _hash(body), data, tuple(_imported(body, name, path.name == "__init__.py"))


def _place(name: str, study: str, home: Path) -> Path | None:
    """File of a module that counts; None for one of another package, or a name that is none of a module."""
    top = name.partition(".")[0]
    # Beside a study in a single file all modules are its own; beside a package there may be anything.
    own = top == study.partition(".")[0] or ("." not in study and home.name != "site-packages")
    if not name or not (own or top in PACKAGES):
        return None
    folder = PROJECT if top in PACKAGES else home
    stem = folder.joinpath(*name.split("."))
    return next((path for path in (stem / "__init__.py", stem.with_name(f"{stem.name}.py")) if path.is_file()), None)


def _reached(body: Sequence[ast.stmt], start: str) -> list[ast.stmt]:
    """The statements of a module that a name depends on; what binds no name, such as a call, always counts."""
    binds = [_bound(statement) for statement in body]
    uses = [{node.id for node in ast.walk(statement) if isinstance(node, ast.Name)} for statement in body]
    kept = {k for k, names in enumerate(binds) if not names}
    wanted = {start}.union(*(uses[k] for k in kept))
    while more := {k for k, names in enumerate(binds) if k not in kept and names & wanted}:
        kept |= more
        wanted = wanted.union(*(uses[k] for k in more))
    return [statement for k, statement in enumerate(body) if k in kept]


def _bound(statement: ast.stmt) -> set[str]:
    """Names that a statement of a module binds, if it does nothing else."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    if isinstance(statement, ast.Import | ast.ImportFrom):
        return {(alias.asname or alias.name).partition(".")[0] for alias in statement.names}
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    if isinstance(statement, ast.AnnAssign):
        targets = [statement.target]
    leaves = [leaf for target in targets for leaf in (target.elts if isinstance(target, ast.Tuple | ast.List) else [target])]
    return {leaf.id for leaf in leaves if isinstance(leaf, ast.Name)} if all(isinstance(x, ast.Name) for x in leaves) else set()


def _imported(body: Iterable[ast.stmt], module: str, package: bool) -> Iterator[str]:
    """Names of modules that statements import; ``from a import b`` may mean the module a.b."""
    for node in _statements(body):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[: len(module.split(".")) - node.level + package] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _hash(body: Sequence[ast.stmt]) -> str:
    """Hash of what statements do: their syntax without docstrings, comments and layout."""
    bare = [_without_docstrings(statement) for statement in body]
    text = "\n".join(ast.dump(statement) for statement in bare if statement is not None)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def _without_docstrings(statement: ast.stmt) -> ast.stmt | None:
    """A statement without text that nothing uses; None if it is nothing else. The tree is changed: it is read for this only."""
    for node in _statements([statement]):
        inside = getattr(node, "body", None)
        if isinstance(inside, list):
            node.body = [one for one in inside if not _is_text(one)]  # type: ignore[attr-defined]
    return None if _is_text(statement) else statement


def _statements(body: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Statements and those inside them, without their expressions, which are ten times as many and hold no statement."""
    waiting = list(body)
    while waiting:
        node = waiting.pop()
        yield node
        for name in HOLDING:
            waiting += getattr(node, name, ())


def _is_text(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant) and isinstance(statement.value.value, str)
    )
