"""Recordings from memory, what they look like, and how a user's own script fares with the library."""

import re
import subprocess
import sys

import numpy as np
import pytest

import gyrocal
from gyrocal import InputError, Recording
from gyrocal.importing.mapping import TETRAHEDRON
from tests import ROOT
from tests.builders import piecewise_recording

RECORDING = piecewise_recording(series_s=100.0)


def arrays(recording=RECORDING, **changes):
    gyro, references = recording.gyro, recording.attitudes
    options = {"sigma": references.sigma, "arw": gyro.arw, "intervals": recording.intervals} | changes
    return Recording.from_arrays(gyro.t_s, options.pop("rates", gyro.rates), references.t_s, references.quaternions, **options)


def test_arrays_and_frames_make_the_recording_they_came_from():
    for made in (
        arrays(),
        Recording.from_frame(
            RECORDING.to_frame("gyro"), RECORDING.to_frame("attitude"), arw_deg_per_sqrt_s=0.0, intervals=RECORDING.intervals
        ),
    ):
        np.testing.assert_allclose(made.gyro.rates, RECORDING.gyro.rates, rtol=1e-14)
        np.testing.assert_allclose(made.attitudes.sigma, RECORDING.attitudes.sigma, rtol=1e-14)
        assert made.gyro.sample_s == RECORDING.gyro.sample_s
        assert made.intervals == RECORDING.intervals


def test_four_gyros_are_their_body_rates():
    axes = np.array(TETRAHEDRON)
    made = arrays(rates=RECORDING.gyro.rates @ axes.T, G=np.linalg.pinv(axes))
    np.testing.assert_allclose(made.gyro.rates, RECORDING.gyro.rates, atol=1e-16)
    np.testing.assert_array_equal(made.gyro.apriori_G, np.eye(3))
    with pytest.raises(InputError, match="G must be 3×4"):
        arrays(rates=RECORDING.gyro.rates @ axes.T)


def test_options_are_taken():
    made = arrays(sigma=1e-4, bias=[1e-6, 0, 0], intervals=None, title="mine")
    assert made.title == "mine"
    assert (made.attitudes.sigma == 1e-4).all()
    assert made.gyro.apriori_bias[0] == 1e-6
    assert len(made.intervals) == 1
    framed = Recording.from_frame(
        RECORDING.to_frame(), RECORDING.to_frame("attitude"), arw_deg_per_sqrt_s=1.0, bias_deg_s=[180.0, 0, 0]
    )
    assert framed.gyro.apriori_bias[0] == pytest.approx(np.pi)
    assert framed.gyro.arw == pytest.approx(np.pi / 180)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: arrays(rates=np.zeros((3, 3))), "rates must be"),
        (lambda: Recording.from_arrays([0.0, 1.0], np.zeros((2, 3)), [0.0, 1.0], np.zeros((2, 4)), sigma=1, arw=0), "norm 0"),
        (
            lambda: Recording.from_arrays([0.0, 1.0], np.zeros((2, 3)), [0.0], np.zeros((2, 4)), sigma=1, arw=0),
            "quaternions must",
        ),
        (lambda: RECORDING.to_frame("sun_sensor"), "no such table; there are gyro, attitude"),
        (lambda: Recording.from_frame(RECORDING.to_frame(), RECORDING.to_frame(), arw_deg_per_sqrt_s=0), "column q1, q2"),
    ],
)
def test_what_does_not_fit_is_said(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_on_a_screen_everything_is_short():
    result = gyrocal.calibrate(RECORDING, apriori_covariance=np.diag([1e-4] * 9 + [1e-10] * 3))
    for thing in (RECORDING, result):
        lines = repr(thing).splitlines()
        assert 5 < len(lines) <= 15
        assert max(map(len, lines)) < 140
        page = thing._repr_html_()
        assert page.count("<tr>") == page.count("</tr>") >= len(lines) - 1
    assert "deg/s" in repr(result)
    np.testing.assert_allclose(result.bias_deg_s, np.rad2deg(result.bias))
    assert result.to_frame().equals(result.summary())
    escaped = gyrocal.recording.arrays.page("<b>", [("a", "<script>")])
    assert "<script>" not in escaped


def test_version_and_module_are_those_of_the_package():
    assert gyrocal.__version__.count(".") == 2
    done = subprocess.run([sys.executable, "-m", "gyrocal", "--version"], capture_output=True, text=True, check=True, cwd=ROOT)
    assert gyrocal.__version__ in done.stdout


def test_a_csv_recording_is_calibrated_without_matplotlib_and_pyarrow(tmp_path):
    gyrocal.save(RECORDING, tmp_path)
    for name in ("gyro", "attitude"):
        RECORDING.to_frame(name).to_csv(tmp_path / f"{name}.csv", index=False)
        (tmp_path / f"{name}.parquet").unlink()
    code = (
        "import sys; sys.modules.update(matplotlib=None, pyarrow=None)\n"
        f"import gyrocal; print(gyrocal.calibrate(gyrocal.load({str(tmp_path)!r}), solve_for='bias'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "b_x" in done.stdout


SCRIPT = """
import numpy as np

import gyrocal
from gyrocal.importing import import_csv


def bias_of(folder: str) -> list[float]:
    recording = gyrocal.load(folder)
    made = gyrocal.Recording.from_arrays(
        recording.gyro.t_s,
        recording.gyro.rates,
        recording.attitudes.t_s,
        recording.attitudes.quaternions,
        sigma=1e-4,
        arw=1e-7,
    )
    result = gyrocal.calibrate(made, solve_for="bias", psi="full")
    values: list[float] = result.bias_deg_s.tolist()
    print(result.to_frame()["sigma"].sum(), made.to_frame("gyro").shape, gyrocal.__version__)
    return values


def imported(path: str) -> float:
    return import_csv(path, time="t:s", gyro="x,y,z:deg/s", quat="w,x,y,z:body-to-world").recording.gyro.arw


print(bias_of("/tmp"), np.rad2deg(imported("log.csv")))
"""


@pytest.mark.parametrize(("script", "status"), [(SCRIPT, 0), (SCRIPT.replace('psi="full"', 'psi="fully"'), 1)])
def test_a_user_s_script_is_checked_by_mypy_strict(tmp_path, script, status):
    path = tmp_path / "mine.py"
    path.write_text(script)
    arguments = ["--strict", "--cache-dir", str(tmp_path.parent / "mypy"), "--follow-imports", "silent", str(path)]
    done = subprocess.run([sys.executable, "-m", "mypy", *arguments], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == status, done.stdout + done.stderr


def test_the_package_says_that_it_is_typed():
    assert (ROOT / "gyrocal" / "py.typed").is_file()


def test_the_page_s_example(capsys):
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "library.md").read_text(), flags=re.DOTALL)
    namespace = {}
    exec(compile(block, "library.md", "exec"), namespace)
    np.testing.assert_allclose(namespace["result"].bias, [1e-4, 0, 0], atol=1e-9)
    np.testing.assert_allclose(namespace["same"].gyro.rates, namespace["rates"], rtol=1e-12)
    assert "angle random walk" in capsys.readouterr().out
