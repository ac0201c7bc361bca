"""Writing a file so that a reader sees the old one or the new one, never half of it.

What is written goes to a temporary file of its own beside the target and takes the target's place when it is complete. Only a
regular file, or nothing, is replaced in this way: a pipe, a device or an open file (``/dev/stdout``, ``/dev/null``, a shell's
``/dev/fd/63``) is written to directly. A symbolic link in the target's place is refused: somebody else may have put it there,
and to replace the link itself would leave an old result where it led. Files of a folder that belong together are all made
before the first takes its place, and who reads them meanwhile waits. Nothing is forced to the disk.
"""

import errno
import os
import re
import secrets
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

TEMPORARY = ".tmp"  # how the names of temporary files end
LINK = "is a symbolic link, which is not written through; give the file that it leads to, or remove it"


def is_replaced(path: Path) -> bool:
    """Tell whether a file written to a path replaces it, a regular file or nothing; anything else is written into.

    An `OSError` if it is a symbolic link.
    """
    if path.is_symlink():
        # /dev/stdout, or a descriptor under /dev/fd, which leads to /proc: a link to what the shell opened.
        if re.fullmatch("/dev|/proc/[^/]+/fd", os.path.realpath(path.parent)):
            return False
        raise OSError(errno.ELOOP, LINK, str(path))
    return path.is_file() or not path.exists()


@contextmanager
def open_replacement(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a binary file that replaces the one at the path when the block ends; after an error the old one stays.

    An `OSError` if the file cannot be written; its name is the path's.
    """
    path = Path(path)
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}{TEMPORARY}") if path.name else path
    try:
        if not is_replaced(path):
            with open(path, "ab") as file:
                yield file
            return
        # Exclusive: neither a file nor a link that somebody else put there is written to, nor removed below.
        with open(temporary, "xb") as file:
            try:
                yield file
                file.close()
                os.replace(temporary, path)
            except BaseException:
                temporary.unlink(missing_ok=True)
                raise
    except OSError as error:
        if error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error


def write_together(folder: Path, files: Mapping[str, Callable[[BinaryIO], Any]], without: Iterable[str] = ()) -> None:
    """Replace files in a folder together, and remove those `without`; if one cannot be written, all old files stay.

    The last file is one that no reader can do without. It is removed before the first rename and comes back with the last one:
    a process killed in between leaves a folder that is seen to be incomplete, never a complete set of old and new files. An
    `OSError` has the name of a file that cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in files:
        if not is_replaced(folder / name):
            raise OSError(errno.EEXIST, "is there already, and no regular file", str(folder / name))
    with tempfile.TemporaryDirectory(prefix=".", suffix=TEMPORARY, dir=folder) as staging:
        for name, write in files.items():
            try:
                with open_replacement(Path(staging) / name) as file:
                    write(file)
            except OSError as error:
                raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(folder / name)) from error
        with lock_folder(folder):
            for name in (*list(files)[-1:], *without):
                (folder / name).unlink(missing_ok=True)
            for name in files:
                os.replace(Path(staging) / name, folder / name)


@contextmanager
def lock_folder(folder: Path, shared: bool = False) -> Iterator[None]:
    """Lock a folder while its files change or, shared, are read; without a lock if the system has none."""
    opened = None
    with suppress(ImportError, OSError):
        import fcntl

        opened = os.open(folder, os.O_RDONLY)
        fcntl.flock(opened, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
    try:
        yield
    finally:
        if opened is not None:
            os.close(opened)
