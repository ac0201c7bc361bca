"""``python -m benchmarks``: measure, show, write."""

import os

# One thread, here and in the processes started from here; read when numpy and its BLAS are loaded, so before all imports.
# What numba compiles has no parallel part, and a setting of numba's would have it compiled anew.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

from pathlib import Path  # noqa: E402

import click  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from benchmarks import measure  # noqa: E402
from studies.montecarlo.files import write_json  # noqa: E402


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--quick", is_flag=True, help="Few repetitions and sizes: shows that it works, not how fast it is.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("results/benchmarks"),
    show_default=True,
    help="Folder to write benchmark.json to.",
)
def main(quick: bool, out: Path) -> None:
    """Measure the kernel and Monte Carlo cases against other ways of doing the same, in one run."""
    progress, console = Console(stderr=True), Console()
    document = measure.run(quick, lambda text: progress.print(text, highlight=False))
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "benchmark.json", document)
    table = Table("quantity", "value", "at most", "met", title="Benchmark: ratios within this run", title_justify="left")
    others = {name: {"value": value, "goal": None, "met": None} for name, value in document["ratios"].items()}
    for name, row in (others | document["goals"]).items():
        table.add_row(name, *("–" if value is None else str(value) for value in (row["value"], row["goal"], row["met"])))
    console.print(table)
    for name, reason in document["reasons"].items():
        console.print(f"{name}: {reason}", highlight=False)


if __name__ == "__main__":
    main()
