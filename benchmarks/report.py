"""The measurements on the terminal, and as JSON, CSV and a figure."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from studies.montecarlo.files import write_csv, write_json
from studies.report import panels

VERDICT = {True: "met", False: "not met", None: "–"}


def write(document: dict[str, Any], folder: Path) -> None:
    """benchmark.json, growth.csv and growth.svg into the folder, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "benchmark.json", document)
    growth = document["growth"]
    samples = pd.DataFrame(growth["samples"]).drop(columns=["c_variant", "c_disagreement"])
    # One table, a row a point, so that either curve is a filter away.
    tables = [samples.melt("samples", var_name="quantity"), pd.DataFrame(growth["cases"]).melt("cases", var_name="quantity")]
    tables = [table.rename(columns={table.columns[0]: "n"}).assign(of=table.columns[0]) for table in tables]
    rows = pd.concat([table.astype({"value": float}) for table in tables])
    write_csv(folder / "growth.csv", rows[["of", "n", "quantity", "value"]], digits=6)
    _figure(growth, folder / "growth.svg")


def _figure(growth: dict[str, Any], path: Path) -> None:
    samples, cases = pd.DataFrame(growth["samples"]), pd.DataFrame(growth["cases"])
    with mpl.rc_context(panels.PANEL_STYLE):
        figure = Figure(figsize=(9.0, 2.9), layout="constrained")
        time, wall, memory = figure.subplots(1, 3)
        curves = {"kernel_ms": ("kernel", "#d1495b"), "c_ms": ("C", "#30343f"), "packing_ms": ("packing", "#00798c")}
        for name, (label, colour) in curves.items():
            values = samples[name].astype(float)
            if values.notna().any():
                time.loglog(samples["samples"], values, "o-", color=colour, label=label)
        time.set(xlabel="samples", ylabel="ms, one propagation")
        time.legend()
        wall.loglog(cases["cases"], cases["wall_s"], "o-", color="#d1495b")
        wall.set(xlabel="cases", ylabel="s, noise and one iteration")
        memory.semilogx(cases["cases"], cases["peak_rss_mb"], "o-", color="#d1495b")
        memory.set(xlabel="cases", ylabel="peak memory (MB)", ylim=(0, None))
        panels.save(figure, path)


def show(document: dict[str, Any], console: Console) -> None:
    """Goals first, then times for information."""
    table = Table(title="Benchmark: ratios within this run", title_justify="left")
    for column in ("quantity", "value", "goal", ""):
        table.add_column(column, justify="right" if column == "value" else "left")
    for name, row in document["goals"].items():
        value = "null" if row["value"] is None else f"{row['value']:.4g}"
        table.add_row(name, value, row["goal"] or "–", VERDICT[row["met"]])
    console.print(table)
    _show_growth(document, console)
    times = ", ".join(f"{name} {value:.4g}" for name, value in document["absolute_ms"].items())
    sizes = [row["samples"] for row in document["growth"]["samples"]]
    console.print(f"For information, ms at {sizes[0]} samples (loads: {sizes[-1]}): {times}", highlight=False)
    loop = document["mission_loop"]
    console.print(
        f"Mission Mode, simulated s per s: compiled {loop['compiled_simulated_s_per_s']:.4g} over {loop['days']:g} days, plain "
        f"{loop['plain_simulated_s_per_s']:.4g}; they differ by {loop['difference_deg']:.1e} deg",
        highlight=False,
    )
    for name, reason in document["reasons"].items():
        console.print(f"{name}: {reason}", highlight=False)
    cpu = document["machine"]
    console.print(f"{cpu['cpu']}, {cpu['cores']} cores; {cpu['compiler'] or 'no C compiler'}", highlight=False)


def _cell(value: float | str | None) -> str:
    """Counts whole, measurements with four digits."""
    return "null" if value is None else str(value) if isinstance(value, int | str) else f"{value:.4g}"


def _show_growth(document: dict[str, Any], console: Console) -> None:
    for of, names in {
        "samples": ("samples", "kernel_ms", "c_ms", "kernel_vs_c", "packing_ms", "pack_vs_kernel"),
        "cases": ("cases", "wall_s", "cpu_ms_per_case_mean", "page_faults_per_case", "peak_rss_mb"),
        "diagnoses": ("samples", "references", "effects", "gap", "verdict", "cpu_s", "silence_s", "peak_rss_mb"),
    }.items():
        table = Table(*names)
        for row in document["growth"][of]:
            table.add_row(*(_cell(row[name]) for name in names))
        console.print(table)
    variant = document["growth"]["samples"][0]["c_variant"]
    if variant:
        chosen = ", ".join(f"{name} {value}" for name, value in variant.items())
        console.print(f"Fastest C at the first size: {chosen}", highlight=False)
