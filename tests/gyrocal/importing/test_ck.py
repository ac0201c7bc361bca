"""SPICE C-kernels and spacecraft clocks, as NAIF's toolkit writes them."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import ck
from tests.builders import piecewise_recording
from tests.gyrocal.importing import mems, mems_log
from tests.gyrocal.importing.mems import INSTRUMENT, write_clock

toolkit = pytest.importorskip("spiceypy")

A = attitude.matrix_from_quaternion(piecewise_recording(series_s=20.0).attitudes.quaternions)
RESOLUTION_S = 2e-7  # of seconds past J2000 in a double


def write_pointing(path, kind, ticks, matrices, rates=False, frame="J2000", quaternions=None):
    """A kernel of one segment by the toolkit; type 3 has more than a hundred starts, so that they have a directory."""
    q = np.array([toolkit.m2q(matrix.copy()) for matrix in matrices]) if quaternions is None else np.array(quaternions)
    handle, count, turn = toolkit.ckopn(str(path), "theirs", 0), len(ticks), np.tile([0.01, -0.02, 0.03], (len(q), 1))
    if kind == 1:
        toolkit.ckw01(handle, ticks[0], ticks[-1], INSTRUMENT, frame, rates, "s", count, ticks, q, turn)
    elif kind == 2:
        starts, stops = ticks
        numbers = (len(starts), starts, stops, q, turn, np.full(len(starts), 0.25))
        toolkit.ckw02(handle, starts[0], stops[-1], INSTRUMENT, frame, "s", *numbers)
    elif kind == 3:
        starts = ticks[::2].copy()
        toolkit.ckw03(handle, ticks[0], ticks[-1], INSTRUMENT, frame, rates, "s", count, ticks, q, turn, len(starts), starts)
    else:
        toolkit.ckw05(handle, 1, 1, ticks[0], ticks[-1], INSTRUMENT, frame, rates, "s", ticks, q, 1.0, 1, ticks[:1].copy())
    toolkit.ckcls(handle)
    return path


@pytest.mark.parametrize("rates", [False, True])
@pytest.mark.parametrize("kind", [1, 3])
def test_attitudes_that_spice_writes_are_read(tmp_path, kind, rates):
    ticks = 1024.0 * np.arange(250)
    path = write_pointing(tmp_path / "theirs.bc", kind, ticks, A[:250], rates)
    found = ck.read_ck(path, write_clock(tmp_path / "c.tsc"))
    assert found.frames == ("J2000", str(INSTRUMENT))
    np.testing.assert_allclose(found.clock.subtract(1281614546) - 0.25, np.arange(250), rtol=0, atol=RESOLUTION_S)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q), A[:250], rtol=0, atol=1e-12)


def test_turns_of_constant_rate_that_spice_writes_are_read(tmp_path):
    count = 101
    starts = 100.0 * np.arange(count)
    stops = starts + 60.0
    stops[count // 2] += 40.0  # reaches the next start
    path = write_pointing(tmp_path / "theirs.bc", 2, (starts, stops), A[:count])
    found = ck.read_ck(path, write_clock(tmp_path / "c.tsc"))
    assert len(found.q) == 2 * count - 1
    # C(t) = C(start) exp(−[ω×](t − start)), of 0.25 s a tick.
    last = A[0] @ Rotation.from_rotvec(-60.0 * 0.25 * np.array([0.01, -0.02, 0.03])).as_matrix()
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q[1]), last, rtol=0, atol=1e-12)


@pytest.mark.parametrize("system", [1, 2])
def test_a_clock_with_several_rates(tmp_path, system):
    clock = write_clock(tmp_path / "c.tsc", system, "0.0 6.0E8 1.0000001D0 1024000000 601000000.125 0.9999998")
    ticks = np.array([0.0, 1024.0, 5e8, 1.024e9, 1.5e9, 3e9])
    path = write_pointing(tmp_path / "theirs.bc", 1, ticks, A[:6])
    seconds = np.where(ticks < 1.024e9, 6e8 + 1.0000001 * ticks / 1024, 601000000.125 + 0.9999998 * (ticks / 1024 - 1e6))
    # TDB − TT of NAIF's leap second kernels; GPS time is TT less 51.184 s.
    M = 6.239996 + 1.99096871e-7 * seconds
    tt = seconds - (1.657e-3 * np.sin(M + 1.671e-2 * np.sin(M)) if system == 1 else 0.0)
    found = ck.read_ck(path, clock).clock
    assert ((found.part >= 0) & (found.part < 1)).all()
    np.testing.assert_allclose(found.subtract(0) + 51.184 - (7300 * 86400 + 43200), tt, rtol=0, atol=3e-7)


def test_what_a_ck_lacks_is_said(tmp_path):
    clock, ticks = write_clock(tmp_path / "c.tsc"), np.array([5.0, 6.0])
    kernel = write_pointing(tmp_path / "a.bc", 1, ticks, A[:2])
    types = write_pointing(tmp_path / "five.bc", 5, ticks, [], quaternions=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    (tmp_path / "half.bc").write_bytes(kernel.read_bytes()[:2500])
    damaged = bytearray(kernel.read_bytes())
    at = damaged.rindex(np.float64(2.0).tobytes())  # the number of attitudes, the last one of the segment
    (tmp_path / "many.bc").write_bytes(damaged[:at] + np.float64(1e300).tobytes() + damaged[at + 8 :])
    for read, words in (
        (lambda: ck.read_ck(types, clock), "segment 's' is of type 5; read are 1, 2 and 3"),
        (lambda: ck.read_ck(kernel, clock, -7), "no instrument -7; there are -95001"),
        (lambda: ck.read_ck(tmp_path / "many.bc", clock), "is damaged: it states 1e.300 attitudes"),
        (lambda: ck.read_ck(tmp_path / "half.bc", clock), "SPICE: .*"),
    ):
        with pytest.raises(InputError, match=words):
            read()


def test_a_gyro_and_a_ck_are_calibrated(run_cli, tmp_path, monkeypatch):
    log = mems_log.log(np.random.default_rng(13), seconds=60.0)
    mems.write_gyro(log, tmp_path / "gyro.csv")
    mems.write_ck(log, tmp_path / "a.bc", tmp_path / "a.tsc")
    arguments = [str(tmp_path / name) for name in ("gyro.csv", "a.bc", "a.tsc", "rec")]
    (tmp_path / "mine.toml").write_text('time = "time:iso"\ngyro = "gx,gy,gz:deg/s"\ntitle = "mine"\n')
    arguments += ["--mapping", str(tmp_path / "mine.toml")]
    done = run_cli("import", "ck", *arguments)
    assert done.exit_code == 0, done.stderr
    recording = gyrocal.load(tmp_path / "rec")
    assert recording.title == "mine"
    assert mems.largest_error(recording, log) < 4
    monkeypatch.setitem(sys.modules, "spiceypy", None)
    refused = run_cli("import", "ck", *arguments, "--force")
    assert refused.exit_code == 2
    assert 'pip install "gyrocal[spice]"' in refused.stderr
