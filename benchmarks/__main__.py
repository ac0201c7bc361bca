"""``python -m benchmarks``: measure, show, write."""

import os

# One thread, here and in the processes started from here; read when numpy and its BLAS are loaded, so before all imports.
# What numba compiles has no parallel part, and a setting of numba's would have it compiled anew.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

from pathlib import Path  # noqa: E402

import click  # noqa: E402
from rich.console import Console  # noqa: E402

from benchmarks import measure, report  # noqa: E402


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--quick", is_flag=True, help="Few repetitions and sizes: shows that it works, not how fast it is.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("results/benchmarks"),
    show_default=True,
    help="Folder to write benchmark.json, growth.csv and growth.svg to.",
)
def main(quick: bool, out: Path) -> None:
    """Measure the kernel, the calibrator and Monte Carlo cases against other ways of doing the same, in one run."""
    progress = Console(stderr=True)
    document = measure.run(quick, lambda text: progress.print(text, highlight=False))
    report.write(document, out)
    report.show(document, Console())


if __name__ == "__main__":
    main()
