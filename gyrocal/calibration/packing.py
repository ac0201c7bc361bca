"""A stream of rates in the order in which the lanes of the compiled pass read it.

The stream is cut into pieces, 32 of which run side by side as a batch of lanes (see `gyrocal.calibration.propagation`). The
pass reads (steps, 4, lanes) of [ω_raw Δt, Δt], so that a step of all lanes is a row of vectors; a recording has a row for each
sample. Packing is the transposition between the two, and costs as much memory traffic as the stream is long. So it is done a
stretch of CHUNK steps at a time, right before these are propagated: they are then still in the second-level cache, and a long
stream is never written to memory a second time.

The lanes read at 32 distant places at once, more than the processor follows by itself. Hence the prefetching: without it,
packing a stream that is not in the caches takes three times as long.
"""

from math import sqrt
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import uintp
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Pieces = tuple[Indices, Indices]
# Raw rates (samples, 3) rad/s; the sample that each step holds; duration of each step, s; whether that is `unbroken`.
Stream = tuple[Array, Indices, Array, bool]

LANES = 32
TILE = 2
CHUNK = 128  # steps, 128 KiB; a multiple of TILE
AHEAD = 16  # steps from what is packed to what is fetched
DOUBLE = 8  # bytes


def packed_shape(pieces: Pieces) -> tuple[int, int, int, int]:
    """Shape of packed increments: batches, steps in whole tiles, 4, lanes."""
    return -(-len(pieces[0]) // LANES), -(-int(pieces[1].max()) // TILE) * TILE, 4, LANES


def _prefetching(_typing: Any, _address: Any) -> Any:
    """Ask for the cache line at an address, which may lie outside of all memory."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        read, keep, data = number(0), number(3), number(1)
        builder.call(function, [builder.inttoptr(arguments[0], byte), read, keep, data])
        return None

    return types.void(types.intp), generate


_prefetch: Any = intrinsic(_prefetching)


@numba.njit(cache=True, nogil=True)
def unbroken(sample: Indices, starts: Indices, lengths: Indices) -> bool:  # pragma: no cover - compiled
    """Whether the steps of every piece hold one sample after the other, none twice and none left out."""
    for piece in range(len(starts)):
        for k in range(starts[piece] + 1, starts[piece] + lengths[piece]):
            if sample[k] != sample[k - 1] + 1:
                return False
    return True


@numba.njit(cache=True, nogil=True)
def pack_chunk(stream: Stream, pieces: Pieces, batch: int, low: int, out: Array) -> float:  # pragma: no cover - compiled
    """Pack steps `low` and following of a batch's pieces into out (steps, 4, lanes), zero where a piece is short.

    Returns
    -------
    Largest |ω_raw Δt| of these steps, rad.
    """
    rates, sample, dt, in_order = stream
    starts, lengths = pieces
    # Of each lane: its first step here, the sample of that, and how many steps it has here.
    first, row, count = np.zeros(LANES, np.uintp), np.zeros(LANES, np.uintp), np.zeros(LANES, np.intp)
    for lane in range(LANES):
        piece = batch * LANES + lane
        if piece < len(starts) and low < lengths[piece]:
            first[lane] = starts[piece] + low
            row[lane] = sample[first[lane]]
            count[lane] = min(lengths[piece] - low, len(out))
    full = count.min()
    largest = np.zeros(LANES)
    next_rates, next_dt = rates.ctypes.data + 3 * DOUBLE * AHEAD, dt.ctypes.data + DOUBLE * 2 * AHEAD
    # Two loops, since the compiler gathers only where no lane has a choice.
    for k in range(full if in_order else 0):
        for lane in range(LANES):
            _put(rates, row[lane] + uintp(k), dt[first[lane] + uintp(k)], out, k, lane, largest)
        if k % 2 == 0:  # a cache line holds 2⅔ samples, and 8 durations
            for lane in range(LANES):
                _prefetch(next_rates + 3 * DOUBLE * np.intp(row[lane] + uintp(k)))
        if k % 8 == 0:
            for lane in range(LANES):
                _prefetch(next_dt + DOUBLE * np.intp(first[lane] + uintp(k)))
    for k in range(0 if in_order else full):
        for lane in range(LANES):
            step = first[lane] + uintp(k)
            _put(rates, uintp(sample[step]), dt[step], out, k, lane, largest)
    for lane in range(LANES):
        for k in range(full, count[lane]):
            step = first[lane] + uintp(k)
            _put(rates, uintp(sample[step]), dt[step], out, k, lane, largest)
        for k in range(count[lane], len(out)):
            for q in range(4):
                out[k, q, lane] = 0.0
    return sqrt(largest.max())


@numba.njit(inline="always")
def _put(
    rates: Array, sample: int, h: float, out: Array, k: int, lane: int, largest: Array
) -> None:  # pragma: no cover - compiled
    """[ω_raw Δt, Δt] of one step into its place, and the largest |ω_raw Δt|² of each lane."""
    x, y, z = rates[sample, uintp(0)] * h, rates[sample, uintp(1)] * h, rates[sample, uintp(2)] * h
    out[k, 0, lane], out[k, 1, lane], out[k, 2, lane], out[k, 3, lane] = x, y, z, h
    largest[lane] = max(largest[lane], x * x + y * y + z * z)


@numba.njit(cache=True, nogil=True)
def pack_increments(stream: Stream, pieces: Pieces, out: Array) -> float:  # pragma: no cover - compiled
    """Pack a whole stream into out (batches, steps, 4, lanes); returns the largest |ω_raw Δt| rad."""
    largest = 0.0
    for batch in range(len(out)):
        for low in range(0, out.shape[1], CHUNK):
            largest = max(largest, pack_chunk(stream, pieces, batch, low, out[batch, low : low + CHUNK]))
    return largest
