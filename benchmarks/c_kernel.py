"""The C kernel: compiled there and then, laid out in its own way, called through ctypes."""

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
# Not -ffast-math again: linked with it, a library sets the whole process to flush subnormal numbers when it is loaded.
LINK = ("-shared",)
PAGE = 4096
SUMS = 45  # P (9) and S of four regressors (36)
LANES = 32  # of the source: pieces of the stream that run side by side


class Packed(NamedTuple):
    """A stream in the kernel's layout."""

    increments: Array  # (steps, 4, lanes) of [ω_raw Δt, Δt], zero where a piece is short
    pieces: NDArray[np.int_]  # (outputs,) lanes that lead to each output


def compiler() -> str | None:
    """The C compiler, $CC or cc; None without one."""
    return shutil.which(os.environ.get("CC") or "cc")


def compiler_version() -> str | None:
    """First line of what the compiler says of itself."""
    path = compiler()
    if path is None:
        return None
    said = subprocess.run([path, "--version"], capture_output=True, text=True, check=True).stdout
    return said.splitlines()[0]


def build(folder: Path) -> ctypes.CDLL:
    """Compile and load the kernel.

    A `RuntimeError` if there is no compiler, or it failed; with the last thing it said.
    """
    path = compiler()
    if path is None:
        raise RuntimeError("no C compiler: neither $CC nor cc is there")
    compiled, library = str(folder / "kernel.o"), str(folder / "kernel.so")
    for command in ([*COMPILE, str(SOURCE), "-o", compiled], [*LINK, compiled, "-o", library]):
        done = subprocess.run([path, *command], capture_output=True, text=True, check=False)
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["nothing said"])[-1]
            raise RuntimeError(f"the C compiler failed: {said.replace(str(SOURCE), SOURCE.name)}")
    return ctypes.CDLL(library)


def pack(arcs: Arcs) -> Packed:
    """Cut the outputs' stretches into pieces for one batch of lanes, as even as can be, and lay their increments out."""
    lengths = arcs.last - arcs.first
    low, high = 0, int(lengths.max())  # low: too short for the lanes; high: fits
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
    increments = _page_aligned((int((ends - starts).max()), 4, LANES))
    for lane, (start, end) in enumerate(zip(starts, ends, strict=True)):
        dt = arcs.dt[start:end]
        increments[: end - start, :3, lane] = arcs.raw[start:end] * dt[:, None]
        increments[: end - start, 3, lane] = dt
    return Packed(increments, np.ascontiguousarray(pieces, dtype=np.int_))


def _page_aligned(shape: tuple[int, ...]) -> Array:
    # numpy starts a large array 16 bytes into a page, where every load of a full vector straddles two cache lines.
    size = int(np.prod(shape))
    memory = np.zeros(size + PAGE // 8)
    offset = -memory.ctypes.data % PAGE // 8
    return memory[offset : offset + size].reshape(shape)


def prepare_call(library: ctypes.CDLL, packed: Packed, G: Array, bias: Array) -> Callable[[], Propagation]:
    """A call of the kernel with nothing left to do but its work; G (3, 3) and bias (3,) rad/s.

    A `ValueError` if a step turns too far for the series.
    """
    increments, pieces = packed
    G, bias = np.ascontiguousarray(G), np.ascontiguousarray(bias)
    turned = np.einsum("ij,tjl->til", G, increments[:, :-1]) + bias[:, None] * increments[:, -1:]
    if np.linalg.norm(turned, axis=1).max() >= PSI_SERIES_LIMIT:
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

    # data_as keeps its array alive, so that the call may outlive this frame.
    return call
