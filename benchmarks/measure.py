"""All measurements of one run, as a document."""

import ctypes
import platform
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from os import cpu_count
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import c_kernel, mission_loop, references
from benchmarks.processes import measure_starts, run_module
from benchmarks.streams import Flight, compute_disagreement, run_packed, run_unpacked
from studies.montecarlo.manifest import REPORTED_PACKAGES, read_commit

METHOD = (
    "One thread. The candidates of a comparison take turns, one untimed and one timed call each a round, and the least time of "
    "each is kept; a ratio is between two such times. The project's kernel and the C kernel start from increments already "
    "packed, each in its own layout, and end with R and the sums of every interval; packing is the extra time of the first "
    "pass over a recording's own rows. Cases, diagnoses and the plain Mission Mode loop run in processes of their own."
)
AGREEMENT = 1e-12  # relative, of any candidate with the project's kernel at 48 000 samples
LONG_AGREEMENT = 1e-10  # at ten and a hundred times as many steps their rounding adds up
ALL_EFFECTS = 1000  # more than there are
START_ROUNDS = 4  # the first one fills the caches of the file system
LEFT_OUT = "left out by --quick"
GOALS = {  # largest values of numbers that the project promises
    "kernel_vs_c_48k": 1.2,
    "kernel_vs_c_4800k": 1.6,
    "case_vs_c_48k": 4.2,
    "cpu_ms_per_case": 1.0,
    "mission_30_days_s": 60.0,
    "calibrate_cold_cpu_s": 15.0,
    "calibrate_warm_cpu_s": 2.0,
    "help_cpu_s": 0.3,
    "import_gyrocal_cpu_s": 0.05,
    "diagnosis_cpu_s": 20.0,
    "diagnosis_peak_rss_mb": 1000.0,
}


class Candidate(NamedTuple):
    """Something to be timed: the work, prepared so that nothing else is timed, and in how many rounds it takes part."""

    call: Callable[[], Any]
    rounds: int


def interleave(candidates: Mapping[str, Candidate]) -> dict[str, float]:
    """Measure the least time of each candidate, ms.

    A turn is an untimed call, then a timed one, so that each candidate finds its own data in the caches whichever came before
    it. A candidate with a single round is called once.
    """
    total = max(candidate.rounds for candidate in candidates.values())
    least = dict.fromkeys(candidates, float("inf"))
    for turn in range(total):
        for name, candidate in candidates.items():
            if turn * candidate.rounds // total == (turn + 1) * candidate.rounds // total:
                continue  # its next turn is a later one
            if candidate.rounds > 1:
                candidate.call()
            start = time.perf_counter()
            candidate.call()
            least[name] = min(least[name], time.perf_counter() - start)
    return {name: 1e3 * value for name, value in least.items()}


@dataclass(frozen=True)
class Effort:
    """Numbers of rounds, cases and sizes that are measured."""

    # factor on the number of samples → rounds of kernel and C
    sizes: dict[int, int] = field(default_factory=lambda: {1: 400, 10: 60, 100: 12})
    slow: int = 10  # rounds of gtsam
    cases: tuple[int, ...] = (100, 10_000)  # numbers of Monte Carlo cases
    # days of Mission Mode, seconds of it compiled and plain in turn, rounds
    mission: tuple[float, float, int] = (30.0, 6000.0, 3)
    # samples, references and effects of each diagnosis, and whether there is a misfit in it
    diagnoses: tuple[tuple[int, int, int, int], ...] = (
        *((samples, 2000, ALL_EFFECTS, 0) for samples in (10**4, 10**5, 10**6)),
        (10**6, 2000, ALL_EFFECTS, 1),
    )


QUICK = Effort({1: 20}, 2, (100,), (1.0, 120.0, 1), ((4000, 60, 1, 0),))


def run(quick: bool = False, report: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Measure everything.

    Parameters
    ----------
    quick : only a check that everything works; omitted numbers are null
    report : takes the present stage
    """
    effort, flight, reasons = QUICK if quick else Effort(), Flight.load_trmm(), dict[str, str]()
    report("the kernel against C")
    library = _build_library(reasons)
    growth = [_measure_growth(flight, finer, rounds, library) for finer, rounds in effort.sizes.items()]
    report("the kernel against a textbook loop and gtsam")
    ms, disagreements = _measure_others(flight, effort, reasons)
    report("starts of fresh processes")
    starts = measure_starts(flight.recording, 1 if quick else START_ROUNDS)
    report("Monte Carlo cases")
    cases = [run_module("benchmarks.cases", count) for count in effort.cases]
    report("diagnoses")
    diagnoses = [run_module("benchmarks.diagnosis", *diagnose) for diagnose in effort.diagnoses]
    report("the Mission Mode loop")
    mission = mission_loop.run(*effort.mission)
    cpu_ms = cases[-1]["cpu_ms_per_case_least"] or cases[-1]["cpu_ms_per_case_mean"]
    first, last = growth[0], growth[-1] if len(growth) > 1 else {}
    ratios = {
        "kernel_vs_c_48k": first["kernel_vs_c"],
        "kernel_vs_c_4800k": last.get("kernel_vs_c"),
        "pack_vs_kernel_48k": first["pack_vs_kernel"],
        "pack_vs_kernel_4800k": last.get("pack_vs_kernel"),
        "case_vs_c_48k": first["c_ms"] and cpu_ms / first["c_ms"],
        "textbook_vs_kernel": ms["textbook"] / ms["kernel"],
        "gtsam_vs_kernel": ms["gtsam"] / ms["kernel"] if "gtsam" in ms else None,
        "mission_plain_vs_compiled": mission["plain_vs_compiled"],
    }
    for name, value in ratios.items():
        if value is None:
            reasons.setdefault(name, LEFT_OUT)
    values = {**ratios, **starts, "cpu_ms_per_case": cpu_ms, "mission_30_days_s": mission["wall_s_30_days"]}
    values |= {f"diagnosis_{name}": max(row[name] for row in diagnoses) for name in ("cpu_s", "peak_rss_mb")}
    return {
        "command": "python -m benchmarks" + (" --quick" if quick else ""),
        "commit": read_commit(),
        "method": METHOD,
        "machine": describe_machine(),
        "ratios": ratios,
        "cpu_ms_per_case": cpu_ms,
        "mission_loop": mission,
        "growth": {"samples": growth, "cases": cases, "diagnoses": diagnoses},
        "absolute_ms": ms,
        "agreement": disagreements,
        "goals": {
            name: {"value": value, "goal": limit, "met": None if value is None else value <= limit}
            for name, limit in GOALS.items()
            for value in [values[name]]
        },
        "reasons": reasons,
    }


def describe_machine() -> dict[str, Any]:
    """Describe CPU, cores and versions."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    installed = {package.metadata["Name"]: package.version for package in metadata.distributions()}
    return {
        "cpu": models[0] if models else platform.processor() or platform.machine(),
        "cores": cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "compiler": c_kernel.read_compiler_version(),
        "packages": {name: installed.get(name) for name in (*REPORTED_PACKAGES, "gtsam")},
    }


def _build_library(reasons: dict[str, str]) -> ctypes.CDLL | None:
    """Build the C kernel; None without one, with the reason for each number that needs it."""
    with tempfile.TemporaryDirectory() as folder:  # a loaded library outlives its file
        try:
            return c_kernel.build(Path(folder))
        except RuntimeError as error:
            reasons.update(dict.fromkeys(("kernel_vs_c_48k", "kernel_vs_c_4800k", "case_vs_c_48k"), str(error)))
            return None


def _measure_growth(flight: Flight, finer: int, rounds: int, library: ctypes.CDLL | None) -> dict[str, Any]:
    """Measure kernel, packing and C at so many times the samples."""
    arcs, parameters = flight.build_arcs(finer), flight.initial
    if arcs.is_beyond_series(parameters.G, parameters.bias):
        raise ValueError("the steps are too long for the series both kernels are compared with")
    expected = run_packed(arcs, parameters)
    candidates, difference = {}, None
    if library is not None:
        call = c_kernel.prepare_call(library, c_kernel.pack(arcs), parameters.G, parameters.bias)
        difference = compute_disagreement(call(), expected)
        _check(f"C at {len(arcs.dt)} samples", difference, AGREEMENT if finer == 1 else LONG_AGREEMENT)
        candidates["c"] = Candidate(call, rounds)
    first_pass = compute_disagreement(run_unpacked(arcs, parameters), expected)
    _check(f"the first pass over {len(arcs.dt)} samples", first_pass, AGREEMENT)
    candidates["kernel"] = Candidate(lambda: run_packed(arcs, parameters), rounds)
    candidates["first_pass"] = Candidate(lambda: run_unpacked(arcs, parameters), rounds)
    ms = interleave(candidates)
    c_ms = ms.get("c")
    return {
        "samples": len(arcs.dt),
        "kernel_ms": ms["kernel"],
        "c_ms": c_ms,
        "kernel_vs_c": None if c_ms is None else ms["kernel"] / c_ms,
        "pack_vs_kernel": ms["first_pass"] / ms["kernel"] - 1,
        "c_disagreement": difference,
    }


def _measure_others(flight: Flight, effort: Effort, reasons: dict[str, str]) -> tuple[dict[str, float], dict[str, float]]:
    """Measure times (ms) of the kernel and the alternatives over the same samples, and their differences."""
    arcs, parameters = flight.build_arcs(), flight.initial
    expected = run_packed(arcs, parameters)
    textbook_results: list[tuple[Any, Any]] = []  # the textbook loop is too slow to run again for its result
    candidates = {
        "kernel": Candidate(lambda: run_packed(arcs, parameters), 10 * effort.slow),
        "textbook": Candidate(lambda: textbook_results.append(references.propagate_textbook(arcs, parameters)), 1),
    }
    differences = {}
    try:
        integrate = references.prepare_gtsam(arcs, parameters)
        differences["gtsam"] = float(abs(integrate() - expected.R).max())
        candidates["gtsam"] = Candidate(integrate, effort.slow)
    except ImportError:
        reasons["gtsam_vs_kernel"] = "gtsam is not installed"
    ms = interleave(candidates)
    R, Theta = textbook_results[0]
    largest = abs(expected.Theta).max(axis=(0, 1))
    differences["textbook"] = float(max(abs(R - expected.R).max(), (abs(Theta - expected.Theta) / largest).max()))
    for name, value in differences.items():
        _check(name, value, AGREEMENT)
    return ms, differences


def _check(name: str, difference: float, limit: float) -> None:
    """Raise `AssertionError` if a candidate differs from the project's kernel."""
    if not difference < limit:
        raise AssertionError(f"{name} differs from the project's kernel by {difference:.1e}, more than {limit:g}")
