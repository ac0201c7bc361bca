"""SPICE C-kernels and spacecraft clocks: kernels that NAIF's toolkit writes are read, and it reads what is written here."""

import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError, Interval, Recording, attitude
from gyrocal.importing import ck, units
from studies.validation import mems_log
from tests.builders import piecewise_recording
from tests.gyrocal.importing import mems

toolkit = pytest.importorskip("spiceypy")

EPOCH = "2020-08-16T12:02:08.250Z"
RECORDING = replace(piecewise_recording(series_s=20.0), epoch=EPOCH, time_scale="UTC", title="a craft <&>")
A = attitude.matrix_from_quaternion(RECORDING.attitudes.quaternions)
INSTRUMENT, SPACECRAFT = -95001, -95
HALF = np.sqrt(0.5)
RESOLUTION_S = 2e-7  # of seconds past J2000 in a double


@pytest.fixture
def kernels(tmp_path):
    ck.write_ck(RECORDING, tmp_path / "a.bc", tmp_path / "a.tsc", instrument=INSTRUMENT)
    return tmp_path / "a.bc", tmp_path / "a.tsc"


@pytest.fixture
def spice(tmp_path):
    """The toolkit, with the leap seconds and the constants of NAIF's kernels; its kernels are unloaded afterwards."""
    leaps = "\n".join(
        f"{19 + k}, @{month[:4]}-{'JAN' if month.endswith('01') else 'JUL'}-1" for k, month in enumerate(units.LEAP_MONTHS, 1)
    )
    (tmp_path / "leaps.tls").write_text(
        "KPL/LSK\n\\begindata\nDELTET/DELTA_T_A = 32.184\nDELTET/K = 1.657D-3\nDELTET/EB = 1.671D-2\n"
        f"DELTET/M = ( 6.239996D0 1.99096871D-7 )\nDELTET/DELTA_AT = ( 19, @1980-JAN-1\n{leaps} )\n\\begintext\n"
    )
    toolkit.furnsh(str(tmp_path / "leaps.tls"))
    yield toolkit
    toolkit.kclear()


def write_clock(path, system=2, coefficients="0 650851397.434 1"):
    """A clock of 1024 ticks a second."""
    path.write_text(f"""KPL/SCLK
Text that is no data: SCLK_DATA_TYPE_95 = ( 3 )
\\begindata
SCLK_KERNEL_ID = ( @2020-01-01 )
SCLK_DATA_TYPE_95 = ( 1 )
SCLK01_TIME_SYSTEM_95 = ( {system} )
SCLK01_N_FIELDS_95 = ( 3 )
SCLK01_MODULI_95 = ( 1000000000, 256, 4 )
SCLK01_OFFSETS_95 = ( 0 0 0 )
SCLK01_OUTPUT_DELIM_95 = ( 1 )
SCLK_PARTITION_START_95 = ( 0 )
SCLK_PARTITION_END_95 = ( 1.0D12 )
SCLK01_COEFFICIENTS_95 = ( {coefficients} )
\\begintext
""")
    return path


def write_pointing(path, kind, ticks, matrices, rates=False, frame="J2000", quaternions=None):
    """A kernel of one segment by the toolkit; type 3 has more than a hundred starts, so that they have a directory."""
    q = np.array([toolkit.m2q(one.copy()) for one in matrices]) if quaternions is None else np.array(quaternions)
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


def test_what_is_written_is_read(kernels):
    found = ck.read_ck(*kernels)
    assert found.frames == ("J2000", str(INSTRUMENT))
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q), A, rtol=0, atol=1e-15)
    utc = units.convert_to_utc(found.clock)
    assert utc.whole[0] == 1597579328
    np.testing.assert_allclose(utc.subtract(1597579328) - 0.25, RECORDING.attitudes.t_s, rtol=0, atol=RESOLUTION_S)


def test_spice_reads_what_is_written(kernels, spice):
    for path in kernels:
        spice.furnsh(str(path))
    ticks = np.round(1e9 * RECORDING.attitudes.t_s)
    for k in range(0, len(ticks), 7):
        C, when = spice.ckgp(INSTRUMENT, ticks[k], 0.0, "J2000")
        assert when == ticks[k]
        np.testing.assert_allclose(C, A[k], rtol=0, atol=1e-12)
    # Half way between two references of an interval SPICE turns at a constant rate, as the body does.
    middle, _ = spice.ckgp(INSTRUMENT, 0.5 * (ticks[3] + ticks[4]), 0.0, "J2000")
    rate = Rotation.from_matrix(A[4] @ A[3].T).as_rotvec()
    np.testing.assert_allclose(middle, Rotation.from_rotvec(0.5 * rate).as_matrix() @ A[3], rtol=0, atol=1e-12)
    # Between two intervals there is nothing.
    last = np.flatnonzero(RECORDING.attitudes.t_s <= RECORDING.intervals[0].stop_s)[-1]
    with pytest.raises(spice.NotFoundError):
        spice.ckgp(INSTRUMENT, ticks[last] + 1e9, 0.0, "J2000")
    # Seconds past J2000 have a resolution of 1e-7 s.
    for k in (0, 1, len(ticks) - 1):
        utc = np.datetime64("2020-08-16T12:02:08.250000") + np.timedelta64(round(1e6 * RECORDING.attitudes.t_s[k]), "us")
        assert spice.et2utc(spice.sct2e(SPACECRAFT, ticks[k]), "ISOC", 6) == str(utc)


@pytest.mark.parametrize("rates", [False, True])
@pytest.mark.parametrize("kind", [1, 3])
def test_attitudes_that_spice_writes_are_read(tmp_path, kind, rates):
    ticks = 1024.0 * np.arange(250)
    path = write_pointing(tmp_path / "theirs.bc", kind, ticks, A[:250], rates)
    found = ck.read_ck(path, write_clock(tmp_path / "c.tsc"))
    assert found.frames == ("J2000", str(INSTRUMENT))
    np.testing.assert_allclose(found.clock.subtract(1281614546) - 0.25, np.arange(250), rtol=0, atol=RESOLUTION_S)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q), A[:250], rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 101])
def test_turns_of_constant_rate_that_spice_writes_are_read(tmp_path, count):
    starts = 100.0 * np.arange(count)
    stops = starts + 60.0
    stops[count // 2] += 40.0  # reaches the next start
    path = write_pointing(tmp_path / "theirs.bc", 2, (starts, stops), A[:count])
    found = ck.read_ck(path, write_clock(tmp_path / "c.tsc"))
    assert len(found.q) == 2 * count - (count > 1)
    # C(t) = C(start) exp(−[ω×](t − start)), of 0.25 s a tick.
    turned = A[0] @ Rotation.from_rotvec(-60.0 * 0.25 * np.array([0.01, -0.02, 0.03])).as_matrix()
    last = turned if count > 1 else A[0] @ Rotation.from_rotvec(-100.0 * 0.25 * np.array([0.01, -0.02, 0.03])).as_matrix()
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


def test_a_quarter_turn_by_hand(tmp_path):
    # The instrument's frame is the reference frame turned by +90 deg about z: C takes the reference's x to (0, −1, 0). SPICE's
    # matrix of (cos, sin z) turns vectors by +90 deg, so its quaternion is that of −90 deg: (√½, 0, 0, −√½).
    path = write_pointing(tmp_path / "hand.bc", 1, np.array([5.0]), [], quaternions=[[HALF, 0.0, 0.0, -HALF]])
    found = ck.read_ck(path, write_clock(tmp_path / "c.tsc"))
    np.testing.assert_allclose(found.q, [[0.0, 0.0, HALF, HALF]], atol=1e-15)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q[0]) @ [1, 0, 0], [0, -1, 0], atol=1e-15)


def test_the_pool_is_left_as_it_was(kernels, spice):
    before = spice.ktotal("ALL"), spice.gdpool("DELTET/K", 0, 9).tolist()
    ck.read_ck(*kernels)
    with pytest.raises(InputError):
        ck.read_ck(kernels[1], kernels[1])
    assert (spice.ktotal("ALL"), spice.gdpool("DELTET/K", 0, 9).tolist()) == before
    spice.kclear()
    ck.read_ck(*kernels)
    assert (spice.ktotal("ALL"), spice.expool("DELTET/K"), spice.expool("SCLK_DATA_TYPE_95")) == (0, False, False)


def test_what_a_ck_lacks_is_said(tmp_path, kernels):
    clock, ticks = write_clock(tmp_path / "c.tsc"), np.array([5.0, 6.0])
    types = write_pointing(tmp_path / "five.bc", 5, ticks, [], quaternions=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    body = write_pointing(tmp_path / "body.bc", 1, ticks, A[:2], frame="IAU_EARTH")
    early = write_clock(tmp_path / "early.tsc", coefficients="7 650851397.434 1")
    (tmp_path / "half.bc").write_bytes(kernels[0].read_bytes()[:2500])
    hand = write_pointing(tmp_path / "hand.bc", 1, ticks, A[:2])
    for read, words in (
        (lambda: ck.read_ck(types, clock), "segment 's' is of type 5; read are 1, 2 and 3"),
        (lambda: ck.read_ck(body, clock), "the reference frame is 10013; one inertial frame"),
        (lambda: ck.read_ck(kernels[0], clock, -7), "no instrument -7; there are -95001"),
        (lambda: ck.read_ck(*kernels, spacecraft=-7), r"a.bc, .*a.tsc: SPICE: .*SCLK_DATA_TYPE_7 was not found"),
        (lambda: ck.read_ck(kernels[0], tmp_path / "none.tsc"), "SPICE: .*could not be located"),
        (lambda: ck.read_ck(clock, clock), "not a binary C-kernel"),
        (lambda: ck.read_ck(hand, early), "SPICE: .*"),
        (lambda: ck.read_ck(tmp_path / "half.bc", clock), "SPICE: .*"),
        (lambda: ck.write_ck(replace(RECORDING, time_scale="s"), clock, clock), "a CK needs dates"),
        (lambda: ck.write_ck(RECORDING, clock, clock, instrument=5), "instrument 5 must be -1000 or less"),
    ):
        with pytest.raises(InputError, match=words) as fault:
            read()
        assert "\n" not in str(fault.value)


def test_a_clock_is_as_fine_as_a_double_can_count(tmp_path):
    for days, per_second in ((1.0, 10**9), (200.0, 10**6)):
        t = np.array([0.0, days * 86400.0])
        made = Recording.from_arrays(
            t, np.zeros((2, 3)), t, np.tile([0, 0, 0, 1.0], (2, 1)), sigma=1e-3, arw=1e-6, sample_s=days * 86400.0,
            epoch="2020-01-01T00:00:00", time_scale="GPS", intervals=[Interval("a", "", 0.0, t[1])],
        )  # fmt: skip
        ck.write_ck(made, tmp_path / "a.bc", tmp_path / "a.tsc", instrument=INSTRUMENT)
        assert f"{2**53 // per_second} {per_second} )" in (tmp_path / "a.tsc").read_text()
        clock = ck.read_ck(tmp_path / "a.bc", tmp_path / "a.tsc").clock
        start = round((pd.Timestamp("2020-01-01") - pd.Timestamp("1980-01-06")).total_seconds())
        np.testing.assert_allclose(clock.subtract(start), t, rtol=0, atol=1e-6)


def test_a_gyro_and_a_ck_are_calibrated_and_the_way_back(run_cli, tmp_path, monkeypatch):
    log = mems_log.log(np.random.default_rng(13), seconds=60.0)
    mems.write_gyro(log, tmp_path / "gyro.csv")
    ck.write_ck(mems.references(log), tmp_path / "a.bc", tmp_path / "a.tsc")
    arguments = [str(tmp_path / name) for name in ("gyro.csv", "a.bc", "a.tsc", "rec")]
    refused = run_cli("import", "ck", *arguments, "--time", "time:iso")
    assert (refused.exit_code, "gyro is missing" in refused.stderr) == (2, True)
    (tmp_path / "mine.toml").write_text('time = "time:iso"\ngyro = "gx,gy,gz:deg/s"\ntitle = "mine"\n')
    done = run_cli("import", "ck", *arguments, "--mapping", str(tmp_path / "mine.toml"))
    assert done.exit_code == 0, done.stderr
    recording = gyrocal.load(tmp_path / "rec")
    assert recording.title == "mine"
    assert mems.largest_error(recording, log) < 4
    arguments = ["export", "ck", str(tmp_path / "rec"), str(tmp_path / "b.bc"), str(tmp_path / "b.tsc")]
    back = run_cli(*arguments)
    assert back.exit_code == 0, back.stderr
    again = attitude.matrix_from_quaternion(ck.read_ck(tmp_path / "b.bc", tmp_path / "b.tsc").q)
    np.testing.assert_allclose(again, attitude.matrix_from_quaternion(recording.attitudes.quaternions), rtol=0, atol=1e-14)
    monkeypatch.setitem(sys.modules, "spiceypy", None)
    refused = run_cli(*arguments)
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert 'pip install "gyrocal[spice]"' in refused.stderr
