"""What importing the library loads, and what it leaves until it is asked for."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("packages", "heavy"),
    [
        ("gyrocal, simulator", ("pandas", "pyarrow", "matplotlib")),
        ("gyrocal", ("numpy", "scipy", "numba", "importlib.metadata")),
        ("studies.report.calibration, gyrocal.estimation.held_out", ("gyrocal.public", "gyrocal.estimation.mekf")),
        ("studies.cli.calibrate, studies.cli.import_, studies.cli.allan", ("gyrocal.importing", "pandas", "scipy.signal")),
    ],
)
def test_what_is_heavy_is_loaded_when_it_is_used(packages, heavy):
    """So that `import gyrocal` takes hundredths of a second, and a simulation loads no tables."""
    code = f"import sys, {packages}; print([name for name in {heavy!r} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
