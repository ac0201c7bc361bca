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


def test_it_is_small_and_holds_the_program_alone(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert wheel.stat().st_size < LARGEST_MB * 1e6
    assert not [name for name in names if name.startswith(ONLY_CHECKOUT)]
    files = {"gyrocal/__init__.py", "simulator/scenarios/trmm.toml", "studies/report/templates/page.html"}
    assert files <= set(names)
    data = {path.relative_to(ROOT).as_posix() for path in (ROOT / "studies" / "data").rglob("*.csv")}
    assert data <= set(names)


def install(wheel, place):
    """An environment of its own, with the dependencies of this one and the wheel in place of the checkout; its interpreter."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
    python = place / "bin" / Path(sys.executable).name
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(subprocess.check_output([python, "-c", code], text=True).strip())
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(pip, check=True)
    # Files .pth there, as of a checkout, are not read.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


@pytest.mark.long
def test_the_tutorial_begins_outside_the_checkout(wheel, tmp_path):
    python = install(wheel, tmp_path / "environment")
    (tmp_path / "own_log.py").write_text((ROOT / "docs" / "examples" / "own_log.py").read_text())
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*arguments):
        done = subprocess.run([python, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert str(ROOT) not in run("-c", "import gyrocal, studies; print(gyrocal.__file__, studies.__file__)")
    run("own_log.py", "desk")
    words = ["--time", "time_ms:ms", "--gyro", "gx,gy,gz:deg/s", "--quat", "qw,qx,qy,qz:body-to-inertial"]
    run("-m", "gyrocal", "import", "csv", "desk/gyro.csv", "desk/mocap.csv", "desk/rec", *words)
    calibrated = run("-m", "gyrocal", "calibrate", "desk/rec", "--report", "calibration.html")
    assert "Use the sigmas with remainder" in " ".join(calibrated.split())
    assert (tmp_path / "calibration.html").stat().st_size > 10_000
