"""What the measurements are to reach, and whether they did."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Goal:
    """A bound on one number; `most` tells an upper bound from a lower one."""

    limit: float
    most: bool = True

    def met(self, value: float) -> bool:
        """Whether the value keeps to it."""
        return value <= self.limit if self.most else value >= self.limit

    def __str__(self) -> str:
        return f"{'≤' if self.most else '≥'} {self.limit:g}"


GOALS = {
    "kernel_vs_c_48k": Goal(1.2),
    "kernel_vs_c_4800k": Goal(1.6),
    "pack_vs_kernel_48k": Goal(0.5),
    "pack_vs_kernel_4800k": Goal(0.5),
    "case_vs_c_48k": Goal(4.2),  # two thirds of what it was while drawing called the generator for every number
    "textbook_vs_kernel": Goal(4000, most=False),
    "gtsam_vs_kernel": Goal(200, most=False),
    "lanes_vs_rows": Goal(3, most=False),
    "cpu_ms_per_case": Goal(1.0),
    "peak_rss_mb_100": Goal(250),
    "peak_rss_mb_10000": Goal(250),
    "peak_rss_10000_over_100": Goal(1.02),  # flat
    "cached_start_s": Goal(1.5),
    "help_vs_numpy": Goal(5),  # half a second, where numpy takes a tenth
    "wrong_option_vs_numpy": Goal(5),
    "no_recording_vs_numpy": Goal(10),
    "calibrate_cold_cpu_s": Goal(15),
    "calibrate_warm_cpu_s": Goal(2),
    "help_cpu_s": Goal(0.3),
    "import_gyrocal_cpu_s": Goal(0.05),
    "mission_30_days_s": Goal(60),
    "diagnosis_cpu_s_1000k": Goal(20),
    "diagnosis_peak_rss_mb_1000k": Goal(1000),
    "diagnosis_cpu_s_1000k_gap": Goal(20),
    "diagnosis_peak_rss_mb_1000k_gap": Goal(1000),
    "diagnosis_cpu_s_10000k": Goal(60),
    "predict_peak_rss_mb": Goal(1500),  # of 100,000 references; as the square of their number it would be terabytes
    "calibrate_peak_rss_mb": Goal(1500),
}


FIRST_RUN = ("calibrate_cold", "calibrate_warm", "help", "import_gyrocal")  # of the processor times of starts


def judged(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Every number with a goal, and the ratios without: value, goal, and met; null where not measured or without a goal."""
    peaks = document["peak_rss_mb"]
    flat = peaks["10000"] / peaks["100"] if peaks["10000"] and peaks["100"] else None
    million, ten_million = (_costs(document, count) for count in (10**6, 10**7))
    explained = _costs(document, 10**6, gap=1)
    values = {
        **document["ratios"],
        "cpu_ms_per_case": document["cpu_ms_per_case"],
        **{f"peak_rss_mb_{count}": value for count, value in peaks.items()},
        "peak_rss_10000_over_100": flat,
        "cached_start_s": next(row["process_s"] for row in document["growth"]["cases"] if row["cases"] == 1),
        **{f"{name}_cpu_s": document.get("start_up_cpu_s", {}).get(name) for name in FIRST_RUN},
        "mission_30_days_s": document["mission_loop"]["wall_s_30_days"],
        "diagnosis_cpu_s_1000k": million.get("cpu_s"),
        "diagnosis_peak_rss_mb_1000k": million.get("peak_rss_mb"),
        "diagnosis_cpu_s_1000k_gap": explained.get("cpu_s"),
        "diagnosis_peak_rss_mb_1000k_gap": explained.get("peak_rss_mb"),
        "diagnosis_cpu_s_10000k": ten_million.get("cpu_s"),
        **{name: document.get("many_references", {}).get(name) for name in ("predict_peak_rss_mb", "calibrate_peak_rss_mb")},
    }
    return {name: _judged(value, GOALS.get(name)) for name, value in values.items()}


def _costs(document: dict[str, Any], samples: int, gap: int = 0) -> dict[str, Any]:
    """Row of the diagnosis of so many samples, with or without a gap, empty if it was not measured."""
    rows = document["growth"]["diagnoses"]
    return next((row for row in rows if row["samples"] == samples and row.get("gap", 0) == gap), {})


def _judged(value: float | None, goal: Goal | None) -> dict[str, Any]:
    met = None if goal is None or value is None else goal.met(value)
    return {"value": value, "goal": None if goal is None else str(goal), "met": met}
