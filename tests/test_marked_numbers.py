"""Marked numbers and tables of README and docs are those of the results; ``python -m tests.test_marked_numbers`` writes them.

``46 times<!--=mission_loop-->`` is a marked number; a table stands between ``<!--begin NAME-->`` and ``<!--end-->``.
"""

import json
import re

import pandas as pd
import pytest

from studies.natanson import reproduce
from studies.robertson.calendar import PERIODS
from tests import ROOT

RESULTS = ROOT / "results"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
NUMBER = re.compile(r"<!--=(\w+)-->")
TABLE = re.compile(r"<!--begin (\w+)-->\n(.*?)<!--end-->", re.DOTALL)
GTSAM_CPP_NS = 152.0  # a sample of gtsam's own benchmark in C++: full navigation state and covariance (gtsam issue 2765)
TABLE3 = {  # lines of R Table 3, and the digits that R prints
    "attitude_accuracy_deg": ("attitude accuracy", 3),
    "yaw_update_deg": ("yaw update", 2),
    "gyro_bias_std_deg_h": ("bias scatter", 3),
}
PERIOD_WORDS = ("before", "with alignment", "calibrated")


def read_json(path):
    return json.loads((RESULTS / path).read_text())


def format_table(rows, head):
    lines = [list(head), ["---"] * len(list(head)), *([str(cell) for cell in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def tabulate_withheld():
    folder = RESULTS / "studies" / "withheld"
    manifest = read_json(folder.relative_to(RESULTS) / "manifest.json")
    rows = [["cases", manifest["done"] - manifest["failed"]]]
    for one in pd.read_csv(folder / "rates.csv").itertuples():
        bounds = f"{100 * one.share:.0f} %; {100 * one.low:.0f} to {100 * one.high:.0f} %"
        rows.append([one.what, f"{one.hits} of {one.cases} ({bounds})"])
    for one in pd.read_csv(folder / "statements.csv").itertuples():
        rows.append(
            [f"causes stated {one.stated}: right", f"{one.right} of {one.causes}, expected {one.expected:.1f}, z {one.z:.1f}"]
        )
    return format_table(rows, ["what", "found"])


def read_withheld_runs():
    """Read the rates of the study's runs before and of the present one, by entropy."""
    folder = RESULTS / "studies" / "withheld"
    entropy = read_json(folder / "manifest.json")["config"]["entropy"]
    runs = pd.concat([pd.read_csv(RESULTS / "withheld_before.csv"), pd.read_csv(folder / "rates.csv").assign(entropy=entropy)])
    return {str(value): run.set_index("what") for value, run in runs.groupby("entropy", sort=False)}


def compute_conformal_share():
    runs = pd.concat(read_withheld_runs().values()).loc["90 % set of explanations holds the truth"]
    return f"{100 * runs['hits'].sum() / runs['cases'].sum():.0f} %"


def tabulate_withheld_runs():
    """The study's rates of the runs before, of the present one, and of all together."""
    by_entropy = read_withheld_runs()
    rows = []
    for what in next(iter(by_entropy.values())).index:
        counts = [(run.hits[what], run.cases[what]) for run in by_entropy.values()]
        hits, cases = (sum(column) for column in zip(*counts, strict=True))
        rows.append([what, *(f"{hit} of {of}" for hit, of in counts), f"{hits} of {cases} ({100 * hits / cases:.0f} %)"])
    return format_table(rows, ["what", *(f"entropy {value}" for value in by_entropy), "all"])


def tabulate_natanson_estimates():
    table = reproduce.build_estimates_table(read_json("reproduction/summary.json"))
    return format_table([row for row in table.itertuples(index=False) if row.question in reproduce.ESTIMATES], table.columns)


def count_changed_digits(table):
    return read_json("reproduction/summary.json")["own_digits_changed"]["0.5"][table]


def format_mission_factors(before, after):
    ladder = pd.read_csv(RESULTS / "mission" / "ladder.csv")
    value, low, high = (ladder[f"{after}{end}"].iloc[-1] for end in ("", "_low", "_high"))
    return f"×{ladder[before].iloc[0]:.2f} to ×{value:.2f} ({low:.2f} to {high:.2f})"


def tabulate_mission_table3():
    table = pd.read_csv(RESULTS / "mission" / "table3.csv").set_index(["parameter", "axis", "period"])
    rows = []
    for (parameter, axis), own in table.groupby(level=["parameter", "axis"], sort=False):
        name, digits = TABLE3[parameter]
        there = [own.loc[(parameter, axis, period)] for period in PERIODS if (parameter, axis, period) in own.index]
        cells = [f"{row['flight']:.{digits}f} → {row['simulated']:.3f}" for row in there]
        rows.append([name, axis, *[""] * (len(PERIODS) - len(cells)), *cells])
    return format_table(rows, ["", "axis", *PERIOD_WORDS])


def tabulate_studies():
    rows = []
    for path in sorted((RESULTS / "studies").glob("*/checks.csv")):
        verdicts, name = pd.read_csv(path)["verdict"], path.parent.name
        title = path.with_name("report.md").read_text().splitlines()[0].removeprefix(f"# Study {name}: ")
        passed, judged = int((verdicts == "pass").sum()), int(verdicts.isin(["pass", "fail"]).sum())
        rows.append([f"[{name}](../results/studies/{name}/report.md)", title, f"{passed} of {judged}"])
    return format_table(rows, ["study", "what it answers", "checks passed"])


def read_benchmark():
    return read_json("benchmarks/benchmark.json")


def compute_kernel_ns():
    first = read_benchmark()["growth"]["samples"][0]
    return 1e6 * first["kernel_ms"] / first["samples"]


VALUES = {
    "withheld": tabulate_withheld,
    "withheld_runs": tabulate_withheld_runs,
    "conformal_share": compute_conformal_share,
    "natanson_estimates": tabulate_natanson_estimates,
    "digits_table2": lambda: f"{count_changed_digits('table2')} of the 18",
    "digits_table4": lambda: f"{count_changed_digits('table4')} of 6",
    "mission_table3": tabulate_mission_table3,
    "mission_18": lambda: format_mission_factors("factor_18", "factor_unfitted"),
    "mission_12": lambda: format_mission_factors("factor_12", "factor_12"),
    "mission_loop": lambda: f"{read_benchmark()['mission_loop']['plain_vs_compiled']:.0f} times",
    "studies": tabulate_studies,
    "kernel_ns": lambda: f"{compute_kernel_ns():.1f} ns",
    "gtsam_python": lambda: f"{read_benchmark()['ratios']['gtsam_vs_kernel']:.0f} times",
    "gtsam_cpp": lambda: f"{GTSAM_CPP_NS / compute_kernel_ns():.0f} times",
    "textbook": lambda: f"{read_benchmark()['ratios']['textbook_vs_kernel']:.0f} times",
}


def update(text):
    """Write values into their places; a number has as many words as its value."""
    text = TABLE.sub(lambda found: f"<!--begin {found[1]}-->\n{VALUES[found[1]]()}<!--end-->", text)
    for name in NUMBER.findall(text):
        value = VALUES[name]()
        words = rf"(?:[^\s|(]+ ){{{value.count(' ')}}}[^\s|(]+(<!--={name}-->)"
        text = re.sub(words, lambda found, value=value: value + found[1], text)
    return text


@pytest.mark.parametrize("page", [page for page in PAGES if "<!--" in page.read_text()], ids=lambda page: page.name)
def test_marked_numbers_and_tables_are_those_of_the_results(page):
    assert page.read_text() == update(page.read_text())


def test_every_value_stands_on_a_page_and_a_wrong_one_is_replaced():
    text = "".join(page.read_text() for page in PAGES)
    assert {*NUMBER.findall(text), *(name for name, _ in TABLE.findall(text))} == set(VALUES)
    assert update("| 3 times<!--=mission_loop--> |") == f"| {VALUES['mission_loop']()}<!--=mission_loop--> |"


if __name__ == "__main__":
    for one in PAGES:
        one.write_text(update(one.read_text()))
