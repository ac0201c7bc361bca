"""The C kernel: compiled at run time, with its own memory layout, called through ctypes."""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal import Arcs
from gyrocal.arrays import Array
from gyrocal.calibration.propagation import PSI_SERIES_LIMIT, Propagation

SOURCE = Path(__file__).with_name("kernel.c")
COMPILE = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-Wno-psabi", "-c")
# Without -ffast-math: a library linked with it makes the whole process flush subnormal numbers when it is loaded.
LINK = ("-shared",)
PAGE = 4096
SUMS = 45  # P (9) and S of four regressors (36)
LANES = 32  # of the source: pieces of the stream that run side by side


class Packed(NamedTuple):
    """A stream in the kernel's layout."""

    increments: Array  # (steps, 4, lanes) of [ω_raw Δt, Δt], zero where a piece is short
    pieces: NDArray[np.int_]  # (outputs,) lanes that lead to each output


def find_compiler() -> str | None:
    """Find the C compiler, $CC or cc; None without one."""
    return shutil.which(os.environ.get("CC") or "cc")


def read_compiler_version() -> str | None:
    """Read the first line of the compiler's version text."""
    path = find_compiler()
    if path is None:
        return None
    output = subprocess.run([path, "--version"], capture_output=True, text=True, check=True).stdout
    return output.splitlines()[0]


def build(folder: Path) -> ctypes.CDLL:
    """Compile and load the kernel.

    Raises `RuntimeError` if there is no compiler, or if it failed, with the last line of its output.
    """
    path = find_compiler()
    if path is None:
        raise RuntimeError("no C compiler: neither $CC nor cc is there")
    compiled, library = str(folder / "kernel.o"), str(folder / "kernel.so")
    for command in ([*COMPILE, str(SOURCE), "-o", compiled], [*LINK, compiled, "-o", library]):
        process = subprocess.run([path, *command], capture_output=True, text=True, check=False)
        if process.returncode:
            message = (process.stderr.strip().splitlines() or ["nothing said"])[-1]
            raise RuntimeError(f"the C compiler failed: {message.replace(str(SOURCE), SOURCE.name)}")
    return ctypes.CDLL(library)


def pack(arcs: Arcs) -> Packed:
    """Cut the outputs' stretches into pieces of nearly equal length for one batch of lanes, and lay out their increments."""
    lengths = arcs.last - arcs.first
    low, high = 0, int(lengths.max())  # longest piece by bisection: low needs too many lanes, high fits
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if np.sum(-(-lengths // middle)) <= LANES else (middle, high)
    pieces = -(-lengths // high)
    edges = [
        first + length * np.arange(count + 1) // count for first, length, count in zip(arcs.first, lengths, pieces, strict=True)
    ]
    starts, ends = np.concatenate([e[:-1] for e in edges]), np.concatenate([e[1:] for e in edges])
    if len(starts) > LANES:
        raise ValueError(f"{len(lengths)} outputs need more than {LANES} lanes")
    increments = _allocate_page_aligned((int((ends - starts).max()), 4, LANES))
    for lane, (start, end) in enumerate(zip(starts, ends, strict=True)):
        dt = arcs.dt[start:end]
        increments[: end - start, :3, lane] = arcs.raw[start:end] * dt[:, None]
        increments[: end - start, 3, lane] = dt
    return Packed(increments, np.ascontiguousarray(pieces, dtype=np.int_))


def _allocate_page_aligned(shape: tuple[int, ...]) -> Array:
    """Allocate zeros that start at a page; numpy starts 16 bytes later, where vector loads straddle two cache lines."""
    size = int(np.prod(shape))
    memory = np.zeros(size + PAGE // 8)
    offset = -memory.ctypes.data % PAGE // 8
    return memory[offset : offset + size].reshape(shape)


def prepare_call(library: ctypes.CDLL, packed: Packed, G: Array, bias: Array) -> Callable[[], Propagation]:
    """Prepare a call of the kernel alone; G (3, 3) and bias (3,) rad/s.

    Raises `ValueError` if a step turns too far for the series.
    """
    increments, pieces = packed
    G, bias = np.ascontiguousarray(G), np.ascontiguousarray(bias)
    rotations = np.einsum("ij,tjl->til", G, increments[:, :-1]) + bias[:, None] * increments[:, -1:]
    if np.linalg.norm(rotations, axis=1).max() >= PSI_SERIES_LIMIT:
        raise ValueError("a step turns too far for the series of the C kernel")
    work = np.empty((SUMS, increments.shape[2]))
    R, S = np.empty((len(pieces), 3, 3)), np.empty((len(pieces), 4, 3, 3))
    result = Propagation(R, S)
    pointer, number = ctypes.c_void_p, ctypes.c_long
    arrays = [array.ctypes.data_as(pointer) for array in (increments, G, bias, pieces, work, R, S)]
    arguments = (arrays[0], number(1), number(len(increments)), *arrays[1:4], number(len(pieces)), *arrays[4:])
    library.propagate.restype = None

    def call() -> Propagation:
        library.propagate(*arguments)
        return result

    # data_as keeps its array alive after this function returns.
    return call
