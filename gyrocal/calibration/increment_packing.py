"""A stream of rates in the order in which the lanes of the compiled pass read it.

The stream is cut into pieces, 32 of which run side by side as a batch of lanes (see `gyrocal.calibration.propagation`). The
pass reads (steps, 4, lanes) of [ω_raw Δt, Δt], so that a step of all lanes is a row of vectors; a recording has
a row for each sample. Packing is the transposition between the two. It is done by squares of eight steps and eight lanes,
which are transposed in registers, and a chunk of steps at a time.

The lanes read at 32 distant places at once, more than a processor follows by itself. Hence the prefetching: without it, packing
a stream that is not in the caches takes three times as long.
"""

from math import sqrt
from typing import Any

import numpy as np
from llvmlite import ir
from numba import uintp
from numba.core import types
from numba.extending import intrinsic

from gyrocal.arrays import Array, Indices
from gyrocal.jit_cache import compile_cached

Pieces = tuple[Indices, Indices]
# Raw rates (samples, 3) rad/s; the sample that each step holds; duration of each step, s; whether that is `is_unbroken`.
Stream = tuple[Array, Indices, Array, bool]

LANES = 32
TILE = 2
CHUNK_STEPS = 256  # steps, 256 KiB; a multiple of WIDTH and of TILE
AHEAD = 32  # steps between packing and prefetching
DOUBLE = 8  # bytes
LANE_WIDTH = 8  # lanes and steps that make a square
GYROS = 3


def compute_packed_shape(pieces: Pieces) -> tuple[int, int, int, int]:
    """Compute the shape of packed increments: batches, steps in whole tiles, gyros and Δt, lanes."""
    return -(-len(pieces[0]) // LANES), -(-int(pieces[1].max()) // TILE) * TILE, GYROS + 1, LANES


def _build_prefetch(_typing: Any, _address: Any) -> Any:
    """Build the intrinsic that fetches the cache line at an address, which may lie outside of all memory."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        function_type = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = builder.module.declare_intrinsic("llvm.prefetch", [byte], function_type)
        read, keep, data = number(0), number(3), number(1)
        builder.call(function, [builder.inttoptr(arguments[0], byte), read, keep, data])
        return None

    return types.void(types.intp), generate


_prefetch: Any = intrinsic(_build_prefetch)


def _build_square_packing(_typing: Any, _rates: Any, _dt: Any, _out: Any, _largest: Any) -> Any:
    """Build the intrinsic that packs a square: eight consecutive samples of eight lanes.

    Arguments are addresses: of the eight lanes' addresses of their rates, and of their durations; of the first place of the
    first lane to pack to; and of the eight lanes' largest |ω_raw Δt|².
    """

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        number, vector = ir.IntType(64), ir.VectorType(ir.DoubleType(), LANE_WIDTH)
        rates, dt, out, largest = arguments

        def locate(address: Any, doubles: int, target_type: Any = vector) -> Any:
            return builder.inttoptr(builder.add(address, number(DOUBLE * doubles)), target_type.as_pointer())

        def permute(first: Any, second: Any, order: list[int]) -> Any:
            return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(ir.IntType(32), LANE_WIDTH), order))

        def transpose(lanes: Any, doubles: int) -> list[Any]:
            """Transpose eight doubles of each of eight lanes to the eight lanes of each of eight doubles."""
            rows = [builder.load(locate(lane, doubles), align=DOUBLE) for lane in lanes]
            for half in (1, 2, 4):  # swap the off-diagonal blocks of that size
                for i in (i for i in range(LANE_WIDTH) if not i & half):
                    upper, lower = rows[i], rows[i + half]
                    rows[i] = permute(upper, lower, [j + LANE_WIDTH - half if j & half else j for j in range(LANE_WIDTH)])
                    rows[i + half] = permute(
                        upper, lower, [j + LANE_WIDTH if j & half else j + half for j in range(LANE_WIDTH)]
                    )
            return rows

        rate_addresses, duration_addresses = (
            [builder.load(locate(table, lane, number)) for lane in range(LANE_WIDTH)] for table in (rates, dt)
        )
        maxima = builder.load(locate(largest, 0), align=DOUBLE)
        durations, squares = transpose(duration_addresses, 0), [None] * LANE_WIDTH
        for step, h in enumerate(durations):
            builder.store(h, locate(out, LANES * ((GYROS + 1) * step + GYROS)), align=DOUBLE)
        for column in range(GYROS):  # eight doubles at a time, which the registers hold
            for row, value in enumerate(transpose(rate_addresses, LANE_WIDTH * column)):
                step, gyro = divmod(LANE_WIDTH * column + row, GYROS)
                turn = builder.fmul(value, durations[step])
                builder.store(turn, locate(out, LANES * ((GYROS + 1) * step + gyro)), align=DOUBLE)
                square, partial_sum = builder.fmul(turn, turn), squares[step]
                squares[step] = square if partial_sum is None else builder.fadd(partial_sum, square)
        for squared_turn in squares:
            maxima = builder.select(builder.fcmp_ordered(">", squared_turn, maxima), squared_turn, maxima)
        builder.store(maxima, locate(largest, 0), align=DOUBLE)
        return None

    return types.void(*[types.intp] * 4), generate


_pack_square: Any = intrinsic(_build_square_packing)


@compile_cached
def is_unbroken(sample: Indices, starts: Indices, lengths: Indices) -> bool:
    """Tell whether the steps of every piece hold one sample after the other, none twice and none left out."""
    for piece in range(len(starts)):
        for k in range(starts[piece] + 1, starts[piece] + lengths[piece]):
            if sample[k] != sample[k - 1] + 1:
                return False
    return True


@compile_cached
def pack_chunk(stream: Stream, pieces: Pieces, batch: int, low: int, out: Array) -> float:
    """Pack steps `low` and following of a batch's pieces into out (steps, 4, lanes), zero where a piece is short.

    Returns the largest |ω_raw Δt| of these steps, rad.
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
    # Loops for the least and the largest: those of numpy take a second to compile.
    common_steps = len(out)
    for lane in range(LANES):
        common_steps = min(common_steps, count[lane])
    largest = np.zeros(LANES)  # |ω_raw Δt|²
    rates_at, dt_at = np.empty(LANES, np.intp), np.empty(LANES, np.intp)  # addresses
    square_steps = common_steps // LANE_WIDTH * LANE_WIDTH if in_order else 0  # steps in squares
    for k in range(0, square_steps, LANE_WIDTH):
        for lane in range(LANES):
            rates_at[lane] = rates.ctypes.data + GYROS * DOUBLE * np.intp(row[lane] + uintp(k))
            dt_at[lane] = dt.ctypes.data + DOUBLE * np.intp(first[lane] + uintp(k))
        for lane in range(0, LANES, LANE_WIDTH):
            lane_offset = DOUBLE * lane
            _pack_square(
                rates_at.ctypes.data + lane_offset,
                dt_at.ctypes.data + lane_offset,
                out.ctypes.data + DOUBLE * (GYROS + 1) * LANES * k + lane_offset,
                largest.ctypes.data + lane_offset,
            )
        for lane in range(LANES):
            for column in range(GYROS):  # a cache line is eight doubles long
                _prefetch(rates_at[lane] + DOUBLE * (GYROS * AHEAD + LANE_WIDTH * column))
            _prefetch(dt_at[lane] + DOUBLE * AHEAD)
    for k in range(square_steps, common_steps):
        for lane in range(LANES):
            step = first[lane] + uintp(k)
            _pack_step(rates, uintp(sample[step]), dt[step], out, k, lane, largest)
    for lane in range(LANES):
        for k in range(common_steps, count[lane]):
            step = first[lane] + uintp(k)
            _pack_step(rates, uintp(sample[step]), dt[step], out, k, lane, largest)
        for k in range(count[lane], len(out)):
            for q in range(GYROS + 1):
                out[k, q, lane] = 0.0
    largest_square = 0.0
    for lane in range(LANES):
        largest_square = max(largest_square, largest[lane])
    return sqrt(largest_square)


@compile_cached(inline="always")
def _pack_step(rates: Array, sample: int, h: float, out: Array, k: int, lane: int, largest: Array) -> None:
    """Pack one step of one lane."""
    squared_turn = 0.0
    for column in range(GYROS):
        turn = rates[sample, uintp(column)] * h
        out[k, column, lane] = turn
        squared_turn += turn * turn
    out[k, GYROS, lane] = h
    largest[lane] = max(largest[lane], squared_turn)


@compile_cached
def pack_increments(stream: Stream, pieces: Pieces, out: Array) -> float:
    """Pack a whole stream into out (batches, steps, 4, lanes); returns the largest |ω_raw Δt| rad."""
    largest = 0.0
    for batch in range(len(out)):
        for low in range(0, out.shape[1], CHUNK_STEPS):
            largest = max(largest, pack_chunk(stream, pieces, batch, low, out[batch, low : low + CHUNK_STEPS]))
    return largest
