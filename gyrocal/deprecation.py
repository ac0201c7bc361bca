"""Old names of functions that user code may import: they work for one release, with a warning."""

import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any


def build_getattr(module: str, renamed: Mapping[str, str]) -> Callable[[str], Any]:
    """Build the ``__getattr__`` of a module whose functions have new names.

    Parameters
    ----------
    module : its ``__name__``
    renamed : new names by the old ones
    """

    def get_renamed(name: str) -> Any:
        if name not in renamed:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warnings.warn(f"{module}.{name} is {renamed[name]} now; the old name goes with the next release", DeprecationWarning, 2)
        return getattr(sys.modules[module], renamed[name])

    return get_renamed
