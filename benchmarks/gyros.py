"""What more gyros than three cost over one pass: their body rates, which then are packed and propagated as those of three.

The pass itself is the same for any number of gyros, since attitude sees the body rates G (ω_raw − c) and nothing else
(`gyrocal.calibration.gyros`). What n gyros add is this product over all samples, 6n flops a sample, and their n columns read.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.streams import Flight, disagreement, run_packed
from benchmarks.timing import Candidate, interleaved
from gyrocal import Arcs

TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
GOLDEN = (1 + np.sqrt(5)) / 2
SIX = np.array([[0, 1, GOLDEN], [0, 1, -GOLDEN], [1, GOLDEN, 0], [-1, GOLDEN, 0], [GOLDEN, 0, 1], [GOLDEN, 0, -1]])
AXES = {4: TETRAHEDRON, 6: SIX / np.sqrt(1 + GOLDEN**2)}
AGREEMENT = 1e-12  # relative, of R and the sums with those of three gyros on the same motion


def run(flight: Flight, rounds: int) -> list[dict[str, Any]]:
    """Times (ms) for four and six gyros on the motion of the flight.

    Raises
    ------
    AssertionError
        Their propagation is not that of three gyros.
    """
    three = flight.arcs()
    expected, out = run_packed(three, flight.initial), []
    for count, axes in AXES.items():
        raw, G = np.ascontiguousarray(three.raw @ axes.T), np.linalg.pinv(axes)
        arcs = Arcs(raw @ G.T, three.dt, np.arange(len(raw)), three.first, three.last, three.arc)
        apart = disagreement(run_packed(arcs, flight.initial), expected)
        if not apart < AGREEMENT:
            raise AssertionError(f"{count} gyros differ from three by {apart:.1e}, more than {AGREEMENT:g}")
        ms = interleaved(
            {
                "kernel": Candidate(partial(run_packed, arcs, flight.initial), 10 * rounds),
                "rates": Candidate(partial(np.matmul, raw, G.T), 5 * rounds),
                "packing": Candidate(partial(_packed, arcs), 5 * rounds),
            }
        )
        out.append({"gyros": count, "samples": len(raw), **{f"{name}_ms": value for name, value in ms.items()}})
    return out


def _packed(arcs: Arcs) -> object:
    return arcs.with_rates(arcs.rates).increments


def ratios(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Body rates over the pass, by the number of gyros."""
    return {f"rates_of_{row['gyros']}_gyros_vs_kernel": row["rates_ms"] / row["kernel_ms"] for row in rows}
