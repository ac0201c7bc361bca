"""The folder of a study: whose it is, who is at work in it, and its manifest.

The manifest is written when a run starts and when it ends. It lists every run that worked on the study: one that was killed
stays there as "running", and one with other versions of the program can be seen.
"""

import fcntl
import hashlib
import json
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from gyrocal.errors import InputError
from studies.montecarlo.files import write_json
from studies.montecarlo.manifest import PACKAGES, commit
from studies.montecarlo.store import StorageError, default_chunk, storage

MANIFEST = "manifest.json"
SEEDS = "SeedSequence(entropy, spawn_key=(case, *name.encode()))"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make the folder and hold it for this run; the lock goes with the process, however that ends.

    Raises
    ------
    InputError
        Another process holds it, or it cannot be made.
    """
    with storage(folder):
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / ".lock").open("w")
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{folder}: another run is at work in this folder; wait for it or choose another folder") from None
        yield


def known(folder: Path, config_sha256: str) -> dict[str, Any] | None:
    """Manifest of the same study in the folder, None if there is none.

    Raises
    ------
    InputError
        The folder holds another study.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        found, _, _ = manifest["config_sha256"], manifest["chunk"], manifest["runs"]
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: is not the manifest of a Monte Carlo study; choose another folder") from None
    if found != config_sha256:
        hashes = f"its hash is {found[:12]}, this one's {config_sha256[:12]}"
        raise InputError(f"{folder}: holds a study with another configuration ({hashes}); choose another folder")
    return dict(manifest)


def chunk_size(folder: Path, config_sha256: str, cases: int, wanted: int | None) -> int:
    """Cases of a chunk: what the folder's parts have, else what is wanted, else what suits the number of cases.

    Raises
    ------
    InputError
        The folder holds another study or parts of another size, or the size is not positive.
    """
    if wanted is not None and wanted < 1:
        raise InputError(f"chunk {wanted}: must be at least one case")
    earlier = known(folder, config_sha256)
    if earlier is None:
        return wanted or default_chunk(cases)
    if wanted not in (None, earlier["chunk"]):
        raise InputError(f"{folder}: its parts hold {earlier['chunk']} cases each, not {wanted}; leave the chunk out to resume")
    return int(earlier["chunk"])


@dataclass
class Progress:
    """How far a study is.

    Attributes
    ----------
    done : cases that have ended and are stored
    failures : error of each failed case
    cpu_s : CPU time of the stored cases
    warnings : how often each warning was given in this run
    """

    done: int = 0
    failures: dict[int, str] = field(default_factory=dict)
    cpu_s: float = 0.0
    warnings: dict[str, int] = field(default_factory=dict)


class Record:
    """Writes the manifest of one run.

    Parameters
    ----------
    folder : of the study
    about : what identifies the study: its name, configuration, hash, chunk …, as plain values
    backend : where the cases run
    """

    def __init__(self, folder: Path, about: Mapping[str, Any], backend: str) -> None:
        self.path = folder / MANIFEST
        earlier = known(folder, about["config_sha256"]) or {"runs": []}
        packages = PACKAGES + (("distributed",) if backend == "dask" else ())
        self.versions = {
            "commit": commit(),
            "python": platform.python_version(),
            "packages": {name: metadata.version(name) for name in packages},
        }
        self.run = {"status": "running", "backend": backend, "jobs": None, "resumed": 0, "wall_s": 0.0, **self.versions}
        self.about = dict(about) | self.versions
        self.earlier = earlier["runs"]

    @property
    def mixed(self) -> bool:
        """Whether an earlier run was of another version of the program."""
        return any(run[name] != self.versions[name] for run in self.earlier for name in ("commit", "python"))

    def write(self, status: str, progress: Progress, table: Path | None = None) -> None:
        """Write the manifest; a full disk does not hide how a run ended."""
        self.run["status"] = status
        document = self.about | {
            "seeds": {"entropy": self.about["config"]["entropy"], "stream": SEEDS},
            "status": status,
            "backend": self.run["backend"],
            "jobs": self.run["jobs"],
            "wall_s": self.run["wall_s"],
            "cpu_s": round(progress.cpu_s, 3),
            "done": progress.done,
            "failed": len(progress.failures),
            "failures": {str(case): progress.failures[case] for case in sorted(progress.failures)},
            "warnings": progress.warnings,
            "files": {table.name: _file_sha256(table)} if table else {},
            "runs": [*self.earlier, self.run],
        }
        try:
            with storage(self.path.parent):
                write_json(self.path, document)
        except StorageError:
            self.path.with_name(MANIFEST + ".tmp").unlink(missing_ok=True)
            if status != "interrupted":
                raise


def _file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
