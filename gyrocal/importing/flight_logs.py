"""Logs of flight controllers: a file that an optional package reads, and the gyro's table of it."""

from __future__ import annotations

import contextlib
import importlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
Key = tuple[str, int]  # name and instance of a message


def read_log(path: Path, module: str, extra: str, form: str, read: Callable[[Any, Path], T]) -> T:
    """Read a file by a package that need not be installed.

    Parameters
    ----------
    path : of the file
    module, extra : of the package, and the extra of this one that installs it
    form : name of the format
    read : makes the value of the module and the path; what it prints is dropped

    Raises
    ------
    InputError
        The package or the file is not there, or the file is damaged.
    """
    try:
        package = importlib.import_module(module)
    except ImportError:
        raise InputError(f"{path}: {module.split('.')[0]} is needed to read it: pip install 'gyrocal[{extra}]'") from None
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return read(package, path)
    except Exception as fault:  # a damaged file raises a zoo of types
        raise InputError(f"{path}: cannot be read as {form}: {' '.join(str(fault).split())}") from None


def build_gyro_table(
    t_us: NDArray[Any], rates: NDArray[Any], warm_us: NDArray[Any] | None = None, temperature: NDArray[Any] | None = None
) -> pd.DataFrame:
    """Table of a gyro: x, y, z (rad/s), t (µs), and temperature (°C) where any is known.

    Parameters
    ----------
    t_us, rates : (n,) and (n, 3)
    warm_us, temperature : (m,) each; times and temperatures, interpolated at t_us
    """
    import pandas as pd

    table = pd.DataFrame(np.asarray(rates, dtype=float), columns=list("xyz")).assign(t=np.asarray(t_us).astype(np.int64))
    if warm_us is not None and temperature is not None and np.isfinite(temperature).any():
        known = np.isfinite(temperature)
        table["temperature"] = np.interp(table["t"], warm_us[known], temperature[known])
    return table


def build_log_entries(gyro: pd.DataFrame, title: str, tag: str) -> dict[str, Any]:
    """Entries of a mapping that read a table of `build_gyro_table`."""
    temperature = "temperature" if "temperature" in gyro else None
    return {"time": "t:us", "gyro": "x,y,z:rad/s", "title": title, "tag": tag, "temperature": temperature}


def compute_message_rate(t_us: NDArray[Any]) -> float:
    """Messages a second, by the median of the times between them."""
    spacing = np.diff(t_us.astype(np.int64))
    return 1e6 / max(float(np.median(spacing)), 1.0) if spacing.size else 0.0


def format_message(key: Key) -> str:
    """NAME:INSTANCE of a message."""
    return f"{key[0]}:{key[1]}"


def describe_others(rates_hz: dict[Key, float], option: str) -> list[str]:
    """Say which gyros are not taken, and the option that takes them."""
    return [f"not taken: {format_message(key)} at {rate:.3g} Hz ({option})" for key, rate in rates_hz.items()]
