"""Every claim of README and docs: the result that it is read from, and how it is written."""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from studies.natanson import reproduce
from studies.robertson import report
from studies.robertson.calendar import PERIODS

GTSAM_CPP_NS = 152.0  # a sample of gtsam's own benchmark in C++: full navigation state and covariance (gtsam issue 2765)
SCALE_WORKERS = 1000  # of the cluster that docs/scale.md is about
EXAMS = Path("studies") / "validation" / "exam"
HISTORY = {  # columns of the history of exams by the rates of a score
    "false alarms": "no effect: a false alarm",
    "one effect, SNR ≥ 8: right, or in its group": "one effect of SNR 8 and more: right or in the group",
    "two effects, SNR ≥ 8: both right, or in their groups": "two effects of SNR 8 and more: both right or in the groups",
    "outside the library, SNR ≥ 12: unknown": "unlisted of SNR 12 and more: unknown",
    "outside the library: wrong name": "unlisted and detected: a confident wrong name",
    "mixed: named causes that are there": "mixed: causes stated that are there",
}
TABLE3 = {  # lines of R Table 3, and the digits that R prints
    "attitude_accuracy_deg": ("attitude accuracy", 3),
    "yaw_update_deg": ("yaw update", 2),
    "gyro_bias_std_deg_h": ("bias scatter", 3),
}
PERIOD_WORDS = ("before", "with alignment", "calibrated")


Claim = Callable[[Path], str]  # from the root of the checkout to what is written


def _json(root: Path, *path: str) -> Any:
    return json.loads(root.joinpath(*path).read_text())


def _checks(root: Path, study: str) -> pd.DataFrame:
    return pd.read_csv(root / "results" / "studies" / study / "checks.csv")


def _table(rows: Iterable[Iterable[object]], head: Iterable[str]) -> str:
    names = list(head)
    lines = [names, ["---"] * len(names), *([str(cell) for cell in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def share(row: Mapping[str, Any]) -> str:
    """Write a rate with its 95 % interval."""
    bounds = f"{100 * row['low']:.1f} to {100 * row['high']:.1f}"
    return f"{row['count']:.0f} of {row['cases']:.0f} ({100 * row['share']:.0f} %; {bounds} %)"


# ---- exams ---------------------------------------------------------------------------------------------------------------


def scores(root: Path) -> list[dict[str, Any]]:
    """Read the scores of all exams in their order."""
    return [json.loads(path.read_text()) for path in sorted((root / EXAMS).glob("*/score.json"))]


def exam_history(root: Path) -> str:
    """Tabulate every exam that was taken, a line a question and a column an exam."""
    every = scores(root)
    rows = [
        ["recordings", *(str(one["recordings"]) for one in every)],
        ["not answered", *(str(one["failed"]) for one in every)],
        ["code", *(f"`{one['commit'][:7]}`" for one in every)],
    ]
    for title, what in HISTORY.items():
        rates = [{rate["what"]: rate for rate in one["rates"]} for one in every]
        rows.append([title, *(share(rate[what]) if what in rate else "–" for rate in rates)])
    rows.append(["calibration error of the stated probabilities", *(f"{one['calibration_error']:.3f}" for one in every)])
    return _table(rows, ["first-sight exam", *(one["exam"] for one in every)])


def exam_outcomes(root: Path) -> str:
    """Tabulate the outcomes of every exam by kind."""
    rows = [[one["exam"], *(row.values())] for one in scores(root) for row in one["outcomes"]]
    names = list(scores(root)[0]["outcomes"][0])
    return _table(rows, ["exam", *names])


def exam_rates(root: Path) -> str:
    """Tabulate all rates of every exam."""
    rows = [[one["exam"], rate["what"], share(rate)] for one in scores(root) for rate in one["rates"]]
    return _table(rows, ["exam", "what", "found, with its 95 % interval"])


# ---- papers --------------------------------------------------------------------------------------------------------------


def _summary(root: Path) -> dict[str, Any]:
    return dict(_json(root, "results", "reproduction", "summary.json"))


def natanson_questions(root: Path, chosen: tuple[str, ...] = ()) -> str:
    """Tabulate what parted simulated and flown numbers of N."""
    table = reproduce.build_question_table(_summary(root))
    rows = [row for row in table.itertuples(index=False) if not chosen or row[0] in chosen]
    return _table(rows, table.columns)


def natanson_estimates(root: Path, chosen: tuple[str, ...] = tuple(reproduce.ESTIMATES)) -> str:
    """Tabulate the answers on N's estimates."""
    table = reproduce.build_estimates_table(_summary(root))
    return _table([row for row in table.itertuples(index=False) if row.question in chosen], table.columns)


def _digits(root: Path) -> dict[str, int]:
    """Count the printed digits that N's second iteration changes at 0.5 s."""
    return dict(_summary(root)["own_digits_changed"]["0.5"])


def _mission_factor(before: str, after: str) -> Claim:
    def text(root: Path) -> str:
        ladder = pd.read_csv(root / "results" / "mission" / "ladder.csv")
        first, (value, low, high) = ladder[before].iloc[0], (ladder[f"{after}{end}"].iloc[-1] for end in ("", "_low", "_high"))
        return f"×{first:.2f} to ×{value:.2f} ({low:.2f} to {high:.2f})"

    return text


def mission_summary(root: Path) -> str:
    """Tabulate the answers on the nominal spacecraft."""
    table = report.build_answers_table(_json(root, "results", "mission", "summary.json"))
    return _table(table[["question", "answer"]].itertuples(index=False), ["question", "answer"])


def mission_table3(root: Path) -> str:
    """Tabulate R Table 3, flown and simulated, by period."""
    table = pd.read_csv(root / "results" / "mission" / "table3.csv").set_index(["parameter", "axis", "period"])
    rows = []
    for (parameter, axis), own in table.groupby(level=["parameter", "axis"], sort=False):
        name, digits = TABLE3[str(parameter)]
        there = {period: own.loc[(parameter, axis, period)] for period in PERIODS if (parameter, axis, period) in own.index}
        cells = [f"{row['flight']:.{digits}f} → {row['simulated']:.3f}" for row in there.values()]
        rows.append([name, axis, *[""] * (len(PERIODS) - len(cells)), *cells])
    return _table(rows, ["", "axis", *PERIOD_WORDS])


def mission_mountings(root: Path) -> str:
    """Tabulate the yaw updates of a day under each mounting, deg."""
    table = pd.read_csv(root / "results" / "mission" / "mountings.csv")
    rows = [[row.mounting, *(f"{getattr(row, period):.2f}" for period in PERIODS)] for row in table.itertuples(index=False)]
    return _table(rows, ["mounting", *PERIOD_WORDS])


# ---- studies and benchmarks ----------------------------------------------------------------------------------------------


def studies(root: Path) -> str:
    """Tabulate the committed studies with the checks that they pass."""
    rows = []
    for folder in sorted((root / "results" / "studies").iterdir()):
        checks = folder / "checks.csv"
        if not checks.exists():
            continue
        verdicts = pd.read_csv(checks)["verdict"]
        title = (folder / "report.md").read_text().splitlines()[0].removeprefix(f"# Study {folder.name}: ")
        passed, judged = int((verdicts == "pass").sum()), int(verdicts.isin(["pass", "fail"]).sum())
        rows.append([f"[{folder.name}](../results/studies/{folder.name}/report.md)", title, f"{passed} of {judged}"])
    return _table(rows, ["study", "what it answers", "checks passed"])


def _benchmark(root: Path) -> dict[str, Any]:
    return dict(_json(root, "results", "benchmarks", "benchmark.json"))


def kernel_ns(root: Path) -> float:
    """Processor time of one sample in the kernel, ns."""
    first = _benchmark(root)["growth"]["samples"][0]
    return float(1e6 * first["kernel_ms"] / first["samples"])


def _scale(root: Path) -> dict[str, Any]:
    return dict(_json(root, "results", "benchmarks", "scale.json"))


def scale_costs(root: Path) -> str:
    """Tabulate what a case and a task cost on a cluster."""
    found = _scale(root)
    costs, megabytes = {name: f"{1e3 * value:.2g} ms" for name, value in found["costs"].items()}, found["bytes_of_a_case"] / 1e6
    rows = [
        ["case of the study `paper`", costs["case_s"], "", ""],
        ["task, however many cases it has", "", costs["parent_task_s"], costs["scheduler_task_s"]],
        ["each case of a task", "", costs["parent_case_s"], costs["scheduler_case_s"]],
        ["part file of a study that is resumed", "", f"{1e3 * found['inspect_part_s']:.2g} ms", ""],
        ["result of a case, as it is sent", f"{megabytes:.3f} MB", "", ""],
        ["row of a case in the table in memory", "", f"{found['table_bytes_of_a_case'] / 1e6:.3f} MB", ""],
    ]
    return _table(rows, ["", "worker", "parent", "scheduler"])


def scale_table(root: Path) -> str:
    """Tabulate the simulated million of cases on a thousand workers."""
    rows = []
    for one in _scale(root)["rows"]:
        minutes = [f"{one[name] / 60:.0f} min" for name in ("wall_s", "bound_s")]
        rows.append([f"{one['case_s']:.2g} s", one["chunk"], *minutes, f"{100 * one['busy']:.0f} %", f"{one['parts']:,}"])
    return _table(rows, ["a case", "chunk", "duration", "bound", "workers busy", "part files"])


def _compare_real_run(root: Path) -> str:
    real = _scale(root)["real_run"]
    return f"{real['wall_s']:.1f} s against {real['simulated_s']:.1f} s"


CLAIMS: dict[str, Claim] = {
    "scale_costs": scale_costs,
    "scale_table": scale_table,
    "scale_real_run": _compare_real_run,
    "scale_parent_case": lambda root: f"{1e3 * _scale(root)['costs']['parent_case_s']:.2f} ms",
    "scale_least_case": lambda root: f"{SCALE_WORKERS * _scale(root)['costs']['parent_case_s']:.2f} s",
    "scale_enough_workers": lambda root: (
        f"{_scale(root)['costs']['case_s'] / _scale(root)['costs']['parent_case_s']:.0f} workers"
    ),
    "scale_table_memory": lambda root: f"{2 * _scale(root)['table_bytes_of_a_case'] * 1e6 / 1e9:.0f} GB",
    "exam_history": exam_history,
    "exam_outcomes": exam_outcomes,
    "exam_rates": exam_rates,
    "studies": studies,
    "natanson_questions": natanson_questions,
    "natanson_estimates": natanson_estimates,
    "digits_table2": lambda root: f"{_digits(root)['table2']} of the 18",
    "digits_table4": lambda root: f"{_digits(root)['table4']} of 6",
    "mission_summary": mission_summary,
    "mission_table3": mission_table3,
    "mission_mountings": mission_mountings,
    "mission_18": _mission_factor("factor_18", "factor_unfitted"),
    "mission_12": _mission_factor("factor_12", "factor_12"),
    "mission_loop": lambda root: f"{_benchmark(root)['mission_loop']['plain_vs_compiled']:.0f} times",
    "kernel_ns": lambda root: f"{kernel_ns(root):.1f} ns",
    "gtsam_python": lambda root: f"{_benchmark(root)['ratios']['gtsam_vs_kernel']:.0f} times",
    "gtsam_cpp": lambda root: f"{GTSAM_CPP_NS / kernel_ns(root):.0f} times",
    "textbook": lambda root: f"{_benchmark(root)['ratios']['textbook_vs_kernel']:.0f} times",
}
