"""More gyros than three: the pass over their n columns beside C of the same, and what a first pass packs in addition.

What the arithmetic needs more than for three gyros are the products of the columns that are added, 6 (n − 3) flops of some 280
a sample, and these columns read. The candidates are those of the comparison of three gyros: the C variants that did best there
are compiled again for n columns.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import c_kernel
from benchmarks.streams import Flight, disagreement, run_array, run_packed
from benchmarks.timing import Candidate, interleaved
from gyrocal import Arcs, GyroParameters, propagate
from gyrocal.calibration.propagation import Propagation

TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
GOLDEN = (1 + np.sqrt(5)) / 2
SIX = np.array([[0, 1, GOLDEN], [0, 1, -GOLDEN], [1, GOLDEN, 0], [-1, GOLDEN, 0], [GOLDEN, 0, 1], [GOLDEN, 0, -1]])
AXES = {4: TETRAHEDRON, 6: SIX / np.sqrt(1 + GOLDEN**2)}
AGREEMENT = 1e-12  # relative, of R and the sums with those of three gyros on the same motion
ITSELF = GyroParameters(np.eye(3), np.zeros(3))


def run(flight: Flight, rounds: int, variants: Sequence[c_kernel.Variant]) -> list[dict[str, Any]]:
    """Times (ms) for four and six gyros on the motion of the flight; of C null without variants.

    Raises
    ------
    AssertionError
        Their propagation is not that of three gyros, or C's is not theirs.
    """
    return [_of(flight, axes, rounds, variants) for axes in AXES.values()]


def _of(flight: Flight, axes: np.ndarray, rounds: int, variants: Sequence[c_kernel.Variant]) -> dict[str, Any]:
    count, G, bias = len(axes), np.linalg.pinv(axes), np.zeros(3)
    three = flight.arcs()
    ends = (three.dt, three.sample, three.first, three.last, three.arc)
    arcs, body = Arcs(np.ascontiguousarray(three.raw @ axes.T), *ends), Arcs(three.raw, *ends)
    found = run_array(arcs, G, bias)
    _same(f"{count} gyros", found, run_packed(body, ITSELF))
    candidates = {
        "kernel": Candidate(partial(run_array, arcs, G, bias), rounds),
        "first_pass": Candidate(lambda: propagate(arcs.with_rates(arcs.rates), G, bias), rounds),
        "kernel_of_3": Candidate(partial(run_packed, body, ITSELF), rounds),
    }
    with tempfile.TemporaryDirectory() as folder:
        libraries = c_kernel.build(variants, Path(folder), count)
        for variant, library in libraries.items():
            call = c_kernel.prepared(library, c_kernel.pack(arcs, variant.lanes), G, bias)
            _same(f"C of {count} gyros", call(), found)
            candidates[repr(variant)] = Candidate(call, rounds)
        ms = interleaved(candidates)
    return {
        "gyros": count,
        "samples": len(arcs.dt),
        "kernel_ms": ms["kernel"],
        "c_ms": min((ms[repr(variant)] for variant in variants), default=None),
        "kernel_of_3_ms": ms["kernel_of_3"],
        "packing_ms": ms["first_pass"] - ms["kernel"],
    }


def _same(name: str, found: Propagation, expected: Propagation) -> None:
    apart = disagreement(found, expected)
    if not apart < AGREEMENT:
        raise AssertionError(f"{name} differ by {apart:.1e}, more than {AGREEMENT:g}")


def ratios(rows: list[dict[str, Any]]) -> dict[str, float | None]:
    """The pass against C, against that of three gyros, and packing against the pass, by the number of gyros."""
    out: dict[str, float | None] = {}
    for row in rows:
        n, kernel = row["gyros"], row["kernel_ms"]
        out[f"kernel_vs_c_48k_n{n}"] = row["c_ms"] and kernel / row["c_ms"]
        out[f"kernel_n{n}_vs_n3"] = kernel / row["kernel_of_3_ms"]
        out[f"pack_vs_kernel_48k_n{n}"] = row["packing_ms"] / kernel
    return out
