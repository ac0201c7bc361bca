"""Compiled functions whose cache on disk cannot be stale, damaged or in the way.

numba's own cache checks only whether the file of the cached function has changed, not the functions and constants that it has
taken in from other files; it lets two processes that compile different signatures at once overwrite one another's entries, and
a damaged entry ends in a traceback. Here a folder holds the code of one state of the sources: its name has the hash of every
source that the functions may come from, and of the versions that compiled them. Within it each entry is one file, named by
its function and types, written whole or not at all, and read only if its checksum is right; anything else is compiled again.

A function of a package may come from that package and the layers below it (gyrocal <- simulator <- diagnosis <- studies), so
that a change of a report does not compile the kernels anew. A cache runs what lies in it: it is looked for where only those
write who may write the sources, or only this user, and where there is no such folder nothing is kept.
"""

import hashlib
import importlib.util
import logging
import os
import pickle
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from importlib import metadata
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from gyrocal.files import open_replacement

PACKAGE_LAYERS = ("gyrocal", "simulator", "diagnosis", "studies")
CACHE_FOLDER_PREFIX = f"compiled-{sys.implementation.cache_tag}-"  # of the folders' names
CACHE_VERSIONS = (sys.version, numba.__version__, metadata.version("llvmlite"), np.__version__)
# Settings that change no code: joblib gives its workers the latter, and nothing here is parallel.
ELSEWHERE = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")
DIGEST = hashlib.sha256().digest_size

logger = logging.getLogger(__name__)

Function = TypeVar("Function", bound=Callable[..., Any])


def compile_cached(function: Function | None = None, **options: Any) -> Any:
    """Decorate a function to be compiled when it is first called, without the global lock, and kept on disk.

    Parameters
    ----------
    function : the function, or None where options are given
    options : of `numba.njit`, such as ``inline="always"``
    """
    if function is None:
        return lambda given: compile_cached(given, **options)
    dispatcher = numba.njit(nogil=True, **options)(function)
    if dispatcher is not function:  # with NUMBA_DISABLE_JIT they are the same
        dispatcher._cache = _Store(function)
    return dispatcher


def hash_sources(package: str) -> str:
    """Hash of the versions that compile and of every source that a compiled function of a package may come from.

    An `OSError` if a source cannot be read.
    """
    below = PACKAGE_LAYERS[: PACKAGE_LAYERS.index(package) + 1] if package in PACKAGE_LAYERS else (*PACKAGE_LAYERS, package)
    hashed = hashlib.sha256(repr(CACHE_VERSIONS).encode())
    for name in below:
        for path in _list_sources(name):
            hashed.update(os.fsencode(path) + hashlib.sha256(path.read_bytes()).digest())
    return hashed.hexdigest()


def _list_sources(package: str) -> Iterator[Path]:
    """List the files of a package, or the one of a module, in a fixed order."""
    spec = importlib.util.find_spec(package)
    for place in (spec.submodule_search_locations if spec else None) or ():
        yield from sorted(Path(place).rglob("*.py"))
    if spec and not spec.submodule_search_locations and spec.origin:
        yield Path(spec.origin)


@cache
def find_cache_folder(package: str) -> tuple[Path, str] | None:
    """Find the folder of a package's compiled code and the hash in its name; None if there is no place for it.

    The first call in a process chooses it, and removes the folders of other states of the sources beside it.
    """
    try:
        digest = hash_sources(package)
    except (OSError, ImportError, ValueError):
        return None
    for parent in _list_parents(package):
        chosen = parent / f"{CACHE_FOLDER_PREFIX}{package}-{digest[:32]}"
        try:
            chosen.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=chosen).close()
        except OSError:
            continue
        for outdated in parent.glob(f"{CACHE_FOLDER_PREFIX}{package}-*"):
            if outdated != chosen:
                shutil.rmtree(outdated, ignore_errors=True)
        return chosen, digest
    return None


@cache
def announce_compilation(package: str) -> None:
    """Log once per process that a package is going to be compiled and how long that takes, unless compiled code is cached."""
    cache_folder = find_cache_folder(package)
    duration = "about 20 s" if package == "gyrocal" else "up to a minute"
    if cache_folder is None:
        logger.info("compiling %s, %s, each time: no folder can keep it; set NUMBA_CACHE_DIR to one", package, duration)
    elif not any(cache_folder[0].glob("*")):
        logger.info("compiling %s once, %s", package, duration)


def _list_parents(package: str) -> Iterator[Path]:
    """List folders for the cache, best first: the one numba is given, one beside the sources, one of this user."""
    spec = importlib.util.find_spec(package)
    pycache = Path((spec and spec.origin) or package).resolve().parent / "__pycache__"
    configured = getattr(numba.config, "CACHE_DIR", "")
    if configured:
        yield Path(configured) / _hash_place(pycache)
    yield pycache
    yield Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "gyrocal" / _hash_place(pycache)
    if hasattr(os, "getuid"):
        temporary = Path(tempfile.gettempdir()) / f"gyrocal-{os.getuid()}"
        if _make_private_folder(temporary):
            yield temporary / _hash_place(pycache)


def _hash_place(folder: Path) -> str:
    """Hash the sources' place to a name, so that two checkouts do not remove one another's code."""
    return hashlib.sha256(os.fsencode(folder)).hexdigest()[:16]


def _make_private_folder(path: Path) -> bool:
    """Make a folder for this user alone, and say whether it is one: in a folder of all, another may have made it."""
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077


class _Store(NullCache):
    """The compiled code of one function on disk, as numba's dispatchers ask for it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.package = function.__module__.partition(".")[0]
        find_cache_folder(self.package)  # before the modules that are imported after it can change

    @property
    def cache_path(self) -> str | None:
        """The folder, as text."""
        folder = find_cache_folder(self.package)
        return str(folder[0]) if folder else None

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Load the compiled code for a signature; None if there is none, or only a damaged one."""
        rtsys.initialize(target)  # all that kept code needs: numba loads what it compiles with (0.5 s) when it compiles
        key = self._build_key(signature, target.codegen())
        path = self._find_path(key)
        if path is None or not path.exists():
            announce_compilation(self.package)
        try:
            data = path.read_bytes() if path else b""
            if hashlib.sha256(data[DIGEST:]).digest() != data[:DIGEST]:
                return None
            stored_key, payload = pickle.loads(data[DIGEST:])
            return CompileResult._rebuild(target, *payload) if stored_key == key else None
        except Exception:  # whatever is wrong with it, it can be compiled again
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store the code for a signature.

        Not stored: code with addresses in it, which are valid in this process only, and any code once the source files have
        changed since this process loaded them.
        """
        key = self._build_key(signature, result.codegen)
        path = self._find_path(key)
        lifted, code = attrgetter("lifted", "library")(result)
        if path is None or lifted or code.has_dynamic_globals or not self._is_current():
            return
        data = dumps((key, result._reduce()))
        try:
            path.parent.mkdir(exist_ok=True)  # another state of the sources may have removed it
            with open_replacement(path) as file:
                file.write(hashlib.sha256(data).digest() + data)
        except OSError:  # a full disk: the code runs all the same
            return

    def _build_key(self, signature: Any, codegen: Any) -> tuple[str, ...]:
        """Build the key of compiled code: function, types, processor, and the values in its closure."""
        code, closure = self.function.__code__, self.function.__closure__ or ()
        names = (self.function.__module__, self.function.__qualname__, str(code.co_firstlineno))
        settings = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_") and item[0] not in ELSEWHERE)
        code_digest = hashlib.sha256(code.co_code + dumps(tuple(cell.cell_contents for cell in closure))).hexdigest()
        return (*names, str(signature), repr(codegen.magic_tuple()), repr(settings), code_digest)

    def _find_path(self, key: tuple[str, ...]) -> Path | None:
        folder = find_cache_folder(self.package)
        if folder is None or " at 0x" in repr(key):  # the address of a function, which another one can have next time
            return None
        name = f"{self.function.__module__}.{self.function.__name__}-{hashlib.sha256(repr(key).encode()).hexdigest()[:32]}"
        return folder[0] / name

    def _is_current(self) -> bool:
        folder = find_cache_folder(self.package)
        try:
            return folder is not None and hash_sources(self.package) == folder[1]
        except (OSError, ImportError, ValueError):
            return False
