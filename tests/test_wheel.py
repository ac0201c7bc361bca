"""The wheel is small, holds no test world and no results, and works where there is no checkout."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests import ROOT

LARGEST_MB = 3.0
ONLY_CHECKOUT = ("results/", "tests/", "studies/validation/world/", "studies/validation/exam/")


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
    assert {"gyrocal/__init__.py", "simulator/scenarios/trmm.toml"} <= set(names)


def test_the_tutorial_begins_outside_the_checkout(installed, tmp_path):
    script = (ROOT / "docs" / "examples" / "own_log.py").read_text()
    (tmp_path / "own_log.py").write_text(script)

    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*arguments):
        return subprocess.run([installed, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True)

    where = run("-c", "import gyrocal, studies; print(gyrocal.__file__, studies.__file__)").stdout
    assert str(ROOT) not in where
    assert str(installed.parents[1]) in where
    assert run("own_log.py", "desk").returncode == 0
    command = "gyrocal"
    tables = ["desk/gyro.csv", "desk/mocap.csv", "desk/rec", "--time", "time_ms:ms", "--gyro", "gx,gy,gz:deg/s"]
    imported = run("-m", command, "import", "csv", *tables, "--quat", "qw,qx,qy,qz:body-to-inertial")
    assert imported.returncode == 0, imported.stderr
    calibrated = run("-m", command, "calibrate", "desk/rec", "--report", "calibration.html")
    assert "Use the sigmas with remainder" in " ".join(calibrated.stdout.split())
    assert (tmp_path / "calibration.html").stat().st_size > 10_000
