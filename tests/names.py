"""Count how names are formed: ``python -m tests.names [--list]``.

A function begins with a verb, no name is a bare participle or begins with a preposition, and a constant of a module has one
meaning in the whole repository. Functions of tests and special methods do not count, nor do properties, which are nouns, the
laws of the test world, which have the names of their effects, and the generators of taken exams, which are sealed byte by byte.
"""

import ast
import re
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests import ROOT

PACKAGES = ("gyrocal", "simulator", "diagnosis", "studies")
WORDS = {key: frozenset(text.split()) for key, text in tomllib.loads((ROOT / "tests" / "names.toml").read_text()).items()}
SEALED = re.compile(r"studies/validation/exam/\d+/")
PARTICIPLES = ("ed", "ing")


@dataclass(frozen=True)
class Name:
    """A name that a module of a package defines, with its place."""

    package: str
    kind: str
    text: str
    place: str

    @property
    def words(self) -> list[str]:
        """The words of the name, in lower case."""
        return [word for word in self.text.strip("_").lower().split("_") if word]


def list_names(root: Path = ROOT) -> list[Name]:
    """List functions, classes and modules of all packages."""
    return [
        name
        for package in PACKAGES
        for path in sorted((root / package).rglob("*.py"))
        if not SEALED.match(path.relative_to(root).as_posix())
        for name in _list_module_names(package, path)
    ]


def _list_module_names(package: str, path: Path) -> Iterator[Name]:
    place = path.relative_to(path.parents[len(path.parts) - path.parts.index(package) - 1]).as_posix()
    if path.stem not in ("__init__", "__main__"):
        yield Name(package, "module", path.stem, place)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ClassDef):
            yield Name(package, "class", node.name, f"{place}:{node.lineno}")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("__"):
            decorators = {ast.unparse(one).partition("(")[0].rpartition(".")[2] for one in node.decorator_list}
            if decorators & WORDS["laws"]:
                continue
            kind = "property" if decorators & {"property", "cached_property", "setter"} else "function"
            yield Name(package, kind, node.name, f"{place}:{node.lineno}")


def begins_with_verb(name: Name) -> bool:
    """Tell whether a function's name begins with a verb of ``names.toml``; some are nouns unless an object follows."""
    first = name.words[0] if name.words else ""
    return first in WORDS["verbs"] and not (first in WORDS["nouns"] and len(name.words) == 1)


def is_misformed(name: Name) -> bool:
    """Tell whether a name is a bare participle or begins with a preposition."""
    words = name.words
    if not words or name.kind == "class" or name.text in WORDS["conversions"]:
        return False
    participle = words[0] in WORDS["irregular"] or (words[0].endswith(PARTICIPLES) and words[0] not in WORDS["not_participles"])
    verb = name.kind == "function" and words[0] in WORDS["verbs"]  # read, set, split: a participle and a verb
    return words[0] in WORDS["prepositions"] or (len(words) == 1 and participle and not verb)


def find_shared_constants(root: Path = ROOT) -> dict[str, dict[str, str]]:
    """Find module constants of one name with different values: the value by module, of each name."""
    values: dict[str, dict[str, str]] = defaultdict(dict)
    conventional = WORDS["by_convention"]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            for node in ast.parse(path.read_text()).body:
                targets = (
                    node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
                )
                for target in targets:
                    if (
                        isinstance(target, ast.Name)
                        and target.id.isupper()
                        and target.id not in conventional
                        and getattr(node, "value", None) is not None
                    ):
                        values[target.id][path.relative_to(root).as_posix()] = ast.unparse(node.value)  # type: ignore[attr-defined]
    return {name: places for name, places in values.items() if len(set(places.values())) > 1}


def main() -> None:
    """Print the counts, with ``--list`` the names."""
    names = list_names()
    for package in PACKAGES:
        functions = [name for name in names if name.package == package and name.kind == "function"]
        verbs = sum(map(begins_with_verb, functions))
        bad = [name for name in names if name.package == package and is_misformed(name)]
        print(
            f"{package}: {verbs} of {len(functions)} functions begin with a verb ({verbs / len(functions):.0%}); "
            f"{len(bad)} names are bare participles or begin with a preposition"
        )
        if "--list" in sys.argv[1:]:
            print("\n".join(f"  {name.place} {name.text}" for name in bad))
            print("\n".join(f"  no verb: {name.place} {name.text}" for name in functions if not begins_with_verb(name)))
    constants = find_shared_constants()
    print(f"{len(constants)} names of module constants have more than one value")
    if "--list" in sys.argv[1:]:
        print("\n".join(f"  {name}: {', '.join(sorted(places))}" for name, places in sorted(constants.items())))


if __name__ == "__main__":
    main()
