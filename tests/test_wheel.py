"""The wheel is small, holds no tests and no results, and works where there is no checkout."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests import ROOT

LARGEST_MB = 3.0
ONLY_CHECKOUT = ("results/", "tests/")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(out), "."]
    subprocess.run(build, cwd=ROOT, check=True)
    (path,) = out.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """An environment of its own, with the dependencies of this one and the wheel in place of the checkout."""
    place = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
    python = place / ("Scripts" if sys.platform == "win32" else "bin") / Path(sys.executable).name
    packages = Path(
        subprocess.check_output([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True).strip()
    )
    subprocess.run(
        [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index", str(wheel)],
        check=True,
    )
    (packages / "dependencies.pth").write_text(
        sysconfig.get_path("purelib") + "\n"
    )  # .pth files there, as of a checkout, are not read
    return python


def test_it_is_small_and_holds_the_program_alone(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert wheel.stat().st_size < LARGEST_MB * 1e6
    assert not [name for name in names if name.startswith(ONLY_CHECKOUT)]
    files = {"gyrocal/__init__.py", "simulator/scenarios/trmm.toml", "studies/report/templates/page.html"}
    assert files <= set(names)
    data = {path.relative_to(ROOT).as_posix() for path in (ROOT / "studies" / "data").rglob("*.csv")}
    assert data <= set(names)


@pytest.fixture
def run(installed, tmp_path):
    """Run the interpreter of that environment in a folder that holds the script of the tutorial."""
    (tmp_path / "own_log.py").write_text((ROOT / "docs" / "examples" / "own_log.py").read_text())
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*arguments):
        done = subprocess.run([installed, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


COLUMNS = ["--time", "time_ms:ms", "--gyro", "gx,gy,gz:deg/s"]


@pytest.mark.long
def test_the_tutorial_begins_outside_the_checkout(run, tmp_path):
    run("own_log.py", "desk")
    tables = ["desk/gyro.csv", "desk/mocap.csv", "desk/rec", "--quat", "qw,qx,qy,qz:body-to-inertial"]
    run("-m", "gyrocal", "import", "csv", *tables, *COLUMNS)
    calibrated = run("-m", "gyrocal", "calibrate", "desk/rec", "--report", "calibration.html")
    assert "Use the sigmas with remainder" in " ".join(calibrated.split())
    assert (tmp_path / "calibration.html").stat().st_size > 10_000
