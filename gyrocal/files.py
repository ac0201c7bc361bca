"""Writing a file so that a reader sees the old one or the new one, never half of it.

What is written goes to a temporary file of its own beside the target and takes the target's place when it is complete. Only a
regular file, or nothing, is replaced in this way: a pipe, a device or an open file (``/dev/stdout``, ``/dev/null``, a shell's
``/dev/fd/63``) is written to directly, and a symbolic link stays and its target is replaced. Nothing is forced to the disk.
"""

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

TEMPORARY = ".tmp"  # how the names of temporary files end


def regular(path: Path) -> Path | None:
    """The regular file that a path leads to, there or not yet; None if it leads to a pipe, a device or an open file."""
    # /dev/stdout, or a descriptor under /dev/fd, which leads to /proc: a link to whatever the shell opened, a file too.
    opened = re.fullmatch("/dev|/proc/[^/]+/fd", os.path.realpath(path.parent)) and path.is_symlink()
    if opened or (path.exists() and not path.is_file()):
        return None
    return Path(os.path.realpath(path))


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file that takes the place of the one at the path when the block ends; after an error the old one stays.

    Raises
    ------
    OSError
        The file cannot be written; its name is the path's.
    """
    path = Path(path)
    target = regular(path)
    temporary = target and target.with_name(f"{target.name}.{secrets.token_hex(4)}{TEMPORARY}")
    try:
        if temporary is None or target is None:
            with open(path, "ab") as file:
                yield file
            return
        # Exclusive: neither a file nor a link that somebody else put there is written to, nor removed below.
        with open(temporary, "xb") as file, _removed_on_error(temporary):
            yield file
            file.close()
            os.replace(temporary, target)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def _removed_on_error(path: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        path.unlink(missing_ok=True)
        raise
