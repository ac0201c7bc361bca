"""Normal numbers drawn in compiled loops: those that numpy draws, to the bit, at half the time.

numpy draws a standard normal number by a ziggurat of 256 layers (Marsaglia & Tsang 2000). A word r of 64 random bits gives a
layer i = r mod 256, a sign, and m of 52 bits. If m < k_i, as in 98.5 % of all draws, the number is ± m w_i; else it takes more
words, logarithms and exponentials. Layer i is w_i 2⁵² wide, and k_i/2⁵² is the part of it that lies inside the next one:

    k_i = 2⁵² w_{i−1}/w_i,    k_1 = 0,    k_0 = 2⁵² w_255/w_0

Numba calls the generator through a pointer for every word, which takes longer than the arithmetic. Here SFC64 (Doty-Humphrey,
PractRand) is written out, a, b, c and n being the words of its state:

    r = a + b + n,    a ← b ⊕ (b ≫ 11),    b ← 9 c,    c ← (c rotated left by 24) + r,    n ← n + 1           all mod 2⁶⁴

The widths are read off numpy, and a draw is done here only if m is below k_i by more than rounding; any other one is left to
numpy, which continues from the state and leaves it where it stops. So nothing depends on how numpy draws those.
"""

import ctypes
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached

Words = NDArray[np.uint64]
# Width w of each layer, that of the negative numbers second, and the m below which a draw is quick; (512,) each.
Layers = tuple[Array, NDArray[np.int64]]

ZIGGURAT_LAYERS = 256
MANTISSA = 2**52
ZIGGURAT_MARGIN = 1e-9  # of k, far above its rounding; so much of the quick draws are left to numpy

BY_LAYER, BELOW_SIGN = np.uint64(2 * ZIGGURAT_LAYERS - 1), np.uint64(9)
OF_MANTISSA = np.int64(MANTISSA - 1)
ONE, XOR_BY, ROTATE, ROTATE_BACK, NINE = (np.uint64(value) for value in (1, 11, 24, 40, 9))


def state_words(rng: np.random.Generator) -> Words | None:
    """Return the words a, b, c, n of an SFC64 generator, shared with it; None of any other, or if they are not there."""
    source = rng.bit_generator
    if not isinstance(source, np.random.SFC64):
        return None
    words = np.ctypeslib.as_array((ctypes.c_uint64 * 4).from_address(source.ctypes.state_address))
    return words if np.array_equal(words, source.state["state"]["state"]) else None


@lru_cache(maxsize=1)
def read_layers() -> Layers:
    """Read widths and bounds of the layers off numpy; a layer that is not as expected has no quick draws."""
    rng = np.random.Generator(np.random.SFC64(0))
    words = state_words(rng)
    assert words is not None

    def draw_layer(layer: int, m: int) -> float:
        words[:] = layer | m << 9, 0, 0, 0  # the first word is a + b + n
        return float(rng.standard_normal())

    width = np.array([draw_layer(layer, 1) for layer in range(ZIGGURAT_LAYERS)])
    inside = np.roll(width, 1) / width
    bound = (MANTISSA * (1 - ZIGGURAT_MARGIN) * inside).astype(np.int64)
    bound[1] = 0
    for layer in np.flatnonzero(bound):
        m = int(bound[layer]) - 1
        if draw_layer(int(layer), m) != m * width[layer] or words[3] != 1:  # or it took a second word
            bound[layer] = 0
    return np.concatenate([width, -width]), np.concatenate([bound, bound])


@compile_cached
def add_normals(
    rng: np.random.Generator, words: Words, layers: Layers, rates: Array, size: float, duration: Array, out: Array
) -> None:
    """Add `rng.standard_normal()` times size/√duration to each of the rates (n, 3), into out (n, 3).

    Parameters
    ----------
    rng, words : an SFC64 generator and its `state_words`
    layers : from `read_layers`: widths and bounds (512,); the second half has the negative widths, so that nine bits of a
        word give layer and sign
    """
    width, bound = layers
    a, b, c, n = words[0], words[1], words[2], words[3]
    last_duration, sigma = -1.0, 0.0
    for k in range(len(rates)):
        if duration[k] != last_duration:
            last_duration = duration[k]
            sigma = size / np.sqrt(last_duration)
        for i in range(rates.shape[1]):
            r = a + n + b
            layer = r & BY_LAYER
            m = np.int64(r >> BELOW_SIGN) & OF_MANTISSA
            x = m * width[layer]
            if m < bound[layer]:
                n += ONE
                a, b, c = b ^ (b >> XOR_BY), c * NINE, ((c << ROTATE) | (c >> ROTATE_BACK)) + r
            else:
                words[0], words[1], words[2], words[3] = a, b, c, n
                x = rng.standard_normal()
                a, b, c, n = words[0], words[1], words[2], words[3]
            out[k, i] = rates[k, i] + x * sigma
    words[0], words[1], words[2], words[3] = a, b, c, n
