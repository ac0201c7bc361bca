"""What importing the library loads, and what it leaves until it is asked for."""

import subprocess
import sys

import gyrocal


def test_simulating_and_calibrating_load_no_tables():
    heavy = "pandas", "pyarrow", "matplotlib"
    code = f"import sys, gyrocal, simulator; print([name for name in {heavy!r} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_the_library_loads_nothing_heavy_until_a_name_is_used():
    """So that `import gyrocal` takes hundredths of a second."""
    code = "import sys, gyrocal; print([name for name in ('numpy', 'scipy', 'numba') if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_every_public_name_is_there():
    assert set(gyrocal.__all__) <= set(dir(gyrocal))
    assert all(getattr(gyrocal, name) is not None for name in gyrocal.__all__)
    assert not hasattr(gyrocal, "no_such_name")
