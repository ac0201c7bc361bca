"""All measurements of one run, as a document; see `goals` for what is wanted of them."""

import contextlib
import ctypes
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from os import cpu_count
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks import c_kernel, mission_loop, references
from benchmarks.c_kernel import compiler_version
from benchmarks.goals import judged
from benchmarks.streams import Flight, disagreement, run_packed, run_unpacked
from gyrocal import Arcs, GyroParameters, Recording, load, save
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from studies.cli.main import COMMAND_NAMES
from studies.montecarlo.manifest import REPORTED_PACKAGES, read_commit


@dataclass(frozen=True)
class Candidate:
    """Something to be timed."""

    call: Callable[[], Any]  # the work, prepared so that nothing else is timed
    rounds: int  # how many rounds to take part in, spread evenly over all; a slow candidate takes part in few


def interleaved(candidates: Mapping[str, Candidate]) -> dict[str, float]:
    """Least time of each, ms.

    A turn is a call that is not timed, then one that is: so each finds its own data in the caches, whoever came before it and
    whether or not that one read the same. A candidate with a single round is called once.
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


Array = NDArray[np.float64]


def finer_recording(recording: Recording, finer: int) -> Recording:
    """The same rates in so many times as many samples."""
    gyro = recording.gyro
    sample_s = gyro.sample_s / finer
    t_s = (gyro.t_s[:, None] + sample_s * np.arange(finer)).ravel()
    return replace(recording, gyro=replace(gyro, t_s=t_s, rates=np.repeat(gyro.rates, finer, axis=0), sample_s=sample_s))


@contextlib.contextmanager
def loaders(flight: Flight, finer: int) -> Iterator[dict[str, Callable[[], Array]]]:
    """Calls from the files of case 0, as Parquet and as CSV, to the residuals (m, 3) rad at its a-priori parameters."""
    with tempfile.TemporaryDirectory() as place:
        parquet, csv = Path(place, "parquet"), Path(place, "csv")
        for folder in (parquet, csv):
            save(finer_recording(flight.recording, finer), folder)
        table = csv / "gyro.parquet"
        pd.read_parquet(table).to_csv(table.with_suffix(".csv"), index=False)
        table.unlink()

        def residuals(folder: Path) -> Array:
            recording = load(folder)
            return Problem.build(recording, prepare_measurements(recording)).state(flight.initial).theta

        yield {"parquet": lambda: residuals(parquet), "csv": lambda: residuals(csv)}


NUMPY = "import numpy"
COMMAND_LINE = "from studies.cli.main import main; main()"
REFUSALS = {"wrong_option": ("calibrate", "--no-such-option"), "no_recording": ("calibrate", "no/such/recording")}


def measure_start_ups(rounds: int) -> dict[str, float]:
    """Least processor time (s) of `import numpy` in a fresh process, of each command's help, and of refusals, by name."""
    calls = {"numpy": (NUMPY,), **{f"help_{name}": (COMMAND_LINE, name, "--help") for name in COMMAND_NAMES}}
    calls |= {name: (COMMAND_LINE, *arguments) for name, arguments in REFUSALS.items()}
    calls |= {"help": (COMMAND_LINE, "--help"), "import_gyrocal": ("import gyrocal",)}
    least = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds + 1):  # the first one fills the file system's caches
        for name, call in calls.items():
            least[name] = min(least[name], _measure_processor_time(*call))
    return least


def compute_start_up_ratios(seconds: dict[str, float]) -> dict[str, float]:
    """The largest help, and each refusal, over `import numpy`."""
    slowest = max(value for name, value in seconds.items() if name.startswith("help_"))
    return {"help_vs_numpy": slowest / seconds["numpy"]} | {
        f"{name}_vs_numpy": seconds[name] / seconds["numpy"] for name in REFUSALS
    }


def measure_first_run(recording: Recording, rounds: int) -> dict[str, float]:
    """Processor time (s) of `gyrocal calibrate` with nothing compiled, and the least with what it has compiled."""
    with tempfile.TemporaryDirectory() as place:
        save(recording, Path(place, "recording"))
        call = COMMAND_LINE, "calibrate", str(Path(place, "recording"))
        cold, *warm = (_measure_processor_time(*call, NUMBA_CACHE_DIR=str(Path(place, "cache"))) for _ in range(rounds + 1))
    return {"calibrate_cold": cold, "calibrate_warm": min(warm)}


def _measure_processor_time(code: str, *arguments: str, **settings: str) -> float:
    """Processor time of a fresh process, s, with settings of its environment; Python keeps its own bytecode."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | settings
    call, where = [sys.executable, "-c", code, *arguments], Path(__file__).parents[1]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(call, cwd=where, env=environment, capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


OPTIONAL = ("gtsam",)


def machine() -> dict[str, Any]:
    """CPU, cores, versions."""
    return {
        "cpu": _cpu_model(),
        "cores": cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "compiler": compiler_version(),
        "packages": {name: _version(name) for name in (*REPORTED_PACKAGES, *OPTIONAL)},
    }


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


Libraries = dict[c_kernel.Variant, ctypes.CDLL]
Say = Callable[[str], None]

METHOD = (
    "One thread. The candidates of a comparison take turns, one untimed and one timed call each a round, and the least time of "
    "each is kept; a ratio is between two such times. The project's kernel and the C kernel start from increments already "
    "packed, each in its own layout, and end with R and the sums of every interval; packing is what the first pass over a "
    "recording's own rows takes longer. Loading is from the files, read before, to the residuals at the a-priori parameters. "
    "Processor time a case is the least mean over a block of 1000 cases; every count of cases runs in a fresh process. The "
    "long run of Mission Mode is flown once, compiled before; as plain Python it runs in a process of its own, in turn with "
    "the compiled."
)
AGREEMENT = 1e-12  # relative, of any candidate with the project's kernel at 48 000 samples
LONG_AGREEMENT = 1e-10  # at ten and a hundred times as many steps their rounding adds up
FAULTS = 50  # a case; more means that arrays go back to the system and are mapped anew for every case
ALL_EFFECTS = 1000  # more than there are
KEPT = 6  # C variants that stay in after the first comparison


@dataclass(frozen=True)
class Effort:
    """How much of everything is done."""

    # factor on the number of samples → rounds of kernel and C
    sizes: dict[int, int] = field(default_factory=lambda: {1: 400, 10: 60, 100: 12})
    loads: int = 2  # rounds of loading a recording of the largest size
    scouting: int = 30  # rounds of the first comparison of the C variants
    variants: tuple[c_kernel.Variant, ...] = c_kernel.VARIANTS  # C variants to compile
    slow: int = 10  # rounds of gtsam, scipy, least squares
    cases: tuple[int, ...] = (1, 10, 100, 1000, 10_000)  # numbers of Monte Carlo cases
    # days of Mission Mode, seconds of it compiled and plain in turn, rounds
    mission: tuple[float, float, int] = (30.0, 6000.0, 3)
    # samples, references and effects of each diagnosis, and whether there is a gap in it
    diagnoses: tuple[tuple[int, int, int, int], ...] = (
        *((samples, 2000, ALL_EFFECTS, 0) for samples in (10**4, 10**5, 10**6, 10**7)),
        *((samples, 2000, ALL_EFFECTS, 1) for samples in (10**5, 10**6)),
        (18_000, 1800, ALL_EFFECTS, 1),  # three minutes at 100 Hz, with ten references a second
        *((10**5, references, ALL_EFFECTS, 0) for references in (50, 200, 20_000)),
        *((10**5, 2000, effects, 0) for effects in (1, 10)),
    )
    references: int = 100_000  # of a prediction and of a calibration


QUICK = Effort({1: 20}, 1, 3, c_kernel.QUICK_VARIANTS, 2, (1, 100), (1.0, 120.0, 1), ((4000, 60, 1, 0),), 4000)
LEFT_OUT = "left out by --quick"


def run(quick: bool = False, say: Say = lambda text: None) -> dict[str, Any]:
    """Measure everything.

    Parameters
    ----------
    quick : only what shows that everything works; what is left out is null
    say : told what is being done
    """
    effort = QUICK if quick else Effort()
    flight = Flight.trmm()
    reasons: dict[str, str] = {}
    with _libraries(effort.variants, reasons) as libraries:
        say("the kernel against C")
        kept = _scouted(libraries, flight, effort.scouting)
        growth = [_growth(flight, finer, rounds, kept) for finer, rounds in effort.sizes.items()]
    say("from the file to the residuals")
    load_ms, checks = _loads(flight, max(effort.sizes), effort.loads)
    say("the kernel against a textbook loop, gtsam and scipy")
    others, apart = _others(flight, effort, reasons)
    checks |= apart
    say("least squares against the calibrator")
    solvers, checks["least_squares_G"] = _solvers(flight, effort.slow)
    say("Monte Carlo cases")
    cases = [_cases(count) for count in effort.cases]
    say("diagnoses")
    diagnoses = [_alone("benchmarks.diagnosis", *one) for one in effort.diagnoses]
    many = _alone("benchmarks.diagnosis", effort.references)
    say("starts of the command line")
    starts = measure_start_ups(min(effort.slow, 3)) | measure_first_run(flight.recording, min(effort.slow, 3))
    say("the Mission Mode loop")
    mission = mission_loop.run(*effort.mission)
    document = _document(growth, load_ms, others | solvers, cases, diagnoses, mission, reasons)
    document["many_references"] = many
    document["ratios"] |= compute_start_up_ratios(starts)
    document["start_up_cpu_s"] = starts
    return {
        "command": "python -m benchmarks" + (" --quick" if quick else ""),
        "commit": read_commit(),
        "method": METHOD,
        "machine": machine(),
        **document,
        "agreement": checks,
        "goals": judged(document),
        "reasons": reasons,
    }


@contextlib.contextmanager
def _libraries(variants: tuple[c_kernel.Variant, ...], reasons: dict[str, str]) -> Iterator[Libraries]:
    with tempfile.TemporaryDirectory() as folder:
        try:
            libraries = c_kernel.build(variants, Path(folder))
        except RuntimeError as error:
            reasons.update(dict.fromkeys(("kernel_vs_c_48k", "kernel_vs_c_4800k", "case_vs_c_48k"), str(error)))
            libraries = {}
        yield libraries


def _prepare_calls(libraries: Libraries, arcs: Arcs, parameters: GyroParameters) -> dict[c_kernel.Variant, Callable[[], Any]]:
    packed = {lanes: c_kernel.pack(arcs, lanes) for lanes in {variant.lanes for variant in libraries}}
    return {
        one: c_kernel.prepared(library, packed[one.lanes], parameters.G, parameters.bias) for one, library in libraries.items()
    }


def _scouted(libraries: Libraries, flight: Flight, rounds: int) -> Libraries:
    """The variants that are fastest in a first comparison."""
    if not libraries:
        return libraries
    calls = _prepare_calls(libraries, flight.arcs(), flight.initial)
    ms = interleaved({repr(variant): Candidate(call, rounds) for variant, call in calls.items()})
    return {variant: libraries[variant] for variant in sorted(libraries, key=lambda v: ms[repr(v)])[:KEPT]}


def _growth(flight: Flight, finer: int, rounds: int, libraries: Libraries) -> dict[str, Any]:
    """Kernel, packing and the fastest C at so many times the samples."""
    arcs, parameters = flight.arcs(finer), flight.initial
    if arcs.beyond_series(parameters.G, parameters.bias):
        raise ValueError("the steps are too long for the series both kernels are compared with")
    expected = run_packed(arcs, parameters)
    calls = _prepare_calls(libraries, arcs, parameters)
    apart = max((disagreement(call(), expected) for call in calls.values()), default=None)
    _check(f"C at {len(arcs.dt)} samples", apart, AGREEMENT if finer == 1 else LONG_AGREEMENT)
    candidates = {repr(variant): Candidate(call, rounds) for variant, call in calls.items()}
    candidates["kernel"] = Candidate(lambda: run_packed(arcs, parameters), rounds)
    candidates["first_pass"] = Candidate(lambda: run_unpacked(arcs, parameters), rounds)
    _check(f"the first pass over {len(arcs.dt)} samples", disagreement(run_unpacked(arcs, parameters), expected), AGREEMENT)
    ms = interleaved(candidates)
    best = min(calls, key=lambda variant: ms[repr(variant)], default=None)
    c_ms = None if best is None else ms[repr(best)]
    return {
        "samples": len(arcs.dt),
        "kernel_ms": ms["kernel"],
        "c_ms": c_ms,
        "kernel_vs_c": None if c_ms is None else ms["kernel"] / c_ms,
        "packing_ms": ms["first_pass"] - ms["kernel"],
        "pack_vs_kernel": ms["first_pass"] / ms["kernel"] - 1,
        "c_variant": None if best is None else asdict(best),
        "c_disagreement": apart,
    }


def _loads(flight: Flight, finer: int, rounds: int) -> tuple[dict[str, float], dict[str, float]]:
    """Times (ms) from the file to the residuals, by kind of file, and how far those of the two are apart, rad."""
    with loaders(flight, finer) as calls:
        parquet, csv = (call() for call in calls.values())
        apart = float(abs(parquet - csv).max())
        _check("residuals from CSV", apart, AGREEMENT)
        return interleaved({name: Candidate(call, rounds) for name, call in calls.items()}), {"load_csv": apart}


def _others(flight: Flight, effort: Effort, reasons: dict[str, str]) -> tuple[dict[str, float], dict[str, float]]:
    """Times (ms) of the kernel and of the other ways over the same samples, and how far they are apart."""
    arcs, parameters = flight.arcs(), flight.initial
    expected = run_packed(arcs, parameters)
    kept: list[tuple[Any, Any]] = []  # the textbook loop is too slow to run again for its result
    apart = {}
    candidates = {
        "kernel": Candidate(lambda: run_packed(arcs, parameters), 10 * effort.slow),
        "rows": Candidate(lambda: references.rows(arcs, parameters), 5 * effort.slow),
        "scipy_rotation": Candidate(lambda: references.scipy_rotation(arcs, parameters), effort.slow),
        "textbook": Candidate(lambda: kept.append(references.textbook(arcs, parameters)), 1),
    }
    apart["rows"] = disagreement(references.rows(arcs, parameters), expected)
    apart["scipy_rotation"] = float(abs(references.scipy_rotation(arcs, parameters) - expected.R).max())
    try:
        integrate = references.gtsam_rotation(arcs, parameters)
        apart["gtsam"] = float(abs(integrate() - expected.R).max())
        candidates["gtsam"] = Candidate(integrate, effort.slow)
    except ImportError:
        reasons["gtsam_vs_kernel"] = "gtsam is not installed"
    ms = interleaved(candidates)
    R, Theta = kept[0]
    largest = abs(expected.Theta).max(axis=(0, 1))
    apart["textbook"] = float(max(abs(R - expected.R).max(), (abs(Theta - expected.Theta) / largest).max()))
    for name, value in apart.items():
        _check(name, value, AGREEMENT)
    return ms, apart


def _check(name: str, apart: float | None, limit: float) -> None:
    if apart is not None and not apart < limit:
        raise AssertionError(f"{name} differs from the project's kernel by {apart:.1e}, more than {limit:g}")


def _solvers(flight: Flight, rounds: int) -> tuple[dict[str, float], float]:
    solvers = references.solvers(flight)
    difference = references.agreement({name: solve() for name, solve in solvers.items()})
    return interleaved({name: Candidate(solve, rounds) for name, solve in solvers.items()}), difference


def _cases(count: int) -> dict[str, Any]:
    """So many cases in a fresh process, with the time from its start to its end."""
    start = time.perf_counter()
    result = _alone("benchmarks.cases", count)
    return {**result, "process_s": time.perf_counter() - start}


def _alone(module: str, *arguments: int) -> dict[str, Any]:
    """Return the output of a module that runs in a fresh process."""
    command = [sys.executable, "-m", module, *map(str, arguments)]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def _document(
    growth: list[dict[str, Any]],
    load_ms: dict[str, float],
    ms: dict[str, float],
    cases: list[dict[str, Any]],
    diagnoses: list[dict[str, Any]],
    mission: dict[str, Any],
    reasons: dict[str, str],
) -> dict[str, Any]:
    """The numbers under the names they are asked for by."""
    against_c, packing = (
        [row[name] for row in growth] + [None] * (3 - len(growth)) for name in ("kernel_vs_c", "pack_vs_kernel")
    )
    longest_ms = growth[2]["kernel_ms"] if len(growth) > 2 else None
    by_count = {row["cases"]: row for row in cases}
    counted = max((row for row in cases if row["cases"] >= 100), key=lambda row: row["cases"])
    cpu_ms = counted["cpu_ms_per_case_least"] or counted["cpu_ms_per_case_mean"]
    ratios = {
        "kernel_vs_c_48k": against_c[0],
        "kernel_vs_c_4800k": against_c[2],
        "pack_vs_kernel_48k": packing[0],
        "pack_vs_kernel_4800k": packing[2],
        "load_vs_kernel_4800k": longest_ms and load_ms["parquet"] / longest_ms,
        "load_csv_vs_kernel_4800k": longest_ms and load_ms["csv"] / longest_ms,
        "case_vs_c_48k": growth[0]["c_ms"] and cpu_ms / growth[0]["c_ms"],
        "textbook_vs_kernel": ms["textbook"] / ms["kernel"],
        "gtsam_vs_kernel": ms["gtsam"] / ms["kernel"] if "gtsam" in ms else None,
        "least_squares_vs_davenport": ms["least_squares"] / ms["davenport"],
        "lanes_vs_rows": ms["rows"] / ms["kernel"],
        "mission_plain_vs_compiled": mission["plain_vs_compiled"],
    }
    peaks = {str(count): by_count[count]["peak_rss_mb"] if count in by_count else None for count in (100, 10_000)}
    if counted["page_faults_per_case"] > FAULTS:
        reasons["cpu_ms_per_case"] = (
            f"{counted['page_faults_per_case']:.0f} page faults a case: the allocator gives the case's arrays back each time"
        )
    for name, value in {**ratios, **{f"peak_rss_mb_{count}": value for count, value in peaks.items()}}.items():
        if value is None:
            reasons.setdefault(name, LEFT_OUT)
    return {
        "ratios": ratios,
        "cpu_ms_per_case": cpu_ms,
        "peak_rss_mb": peaks,
        "mission_loop": mission,
        "growth": {"samples": growth, "cases": cases, "diagnoses": diagnoses},
        "absolute_ms": ms | {f"load_{name}": value for name, value in load_ms.items()},
    }
