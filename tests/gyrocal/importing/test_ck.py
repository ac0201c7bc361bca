"""SPICE C-kernels and spacecraft clocks against NAIF's own toolkit, and by hand."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError, Interval, Recording, attitude
from gyrocal.importing import ck, daf, sclk, units
from studies.validation import mems_log
from tests.builders import piecewise_recording

EPOCH = "2020-08-16T12:02:08.250Z"
RECORDING = replace(piecewise_recording(series_s=20.0), epoch=EPOCH, time_scale="UTC", title="a craft <&>")
INSTRUMENT, SPACECRAFT = -95001, -95
HALF = np.sqrt(0.5)


@pytest.fixture
def kernels(tmp_path):
    ck.write_ck(RECORDING, tmp_path / "a.bc", tmp_path / "a.tsc", instrument=INSTRUMENT)
    return tmp_path / "a.bc", tmp_path / "a.tsc"


@pytest.fixture
def spice(tmp_path):
    """The toolkit, with the leap seconds and the constants of NAIF's kernels; its kernels are unloaded afterwards."""
    toolkit = pytest.importorskip("spiceypy")
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


def test_what_is_written_is_read(kernels):
    found = ck.read_ck(*kernels)
    assert found.frames == ("J2000", str(INSTRUMENT))
    np.testing.assert_allclose(found.q, RECORDING.attitudes.quaternions, rtol=0, atol=1e-15)
    utc = units.to_utc(found.clock)
    assert (utc.whole[0], utc.part[0]) == (1597579328, 0.25)
    np.testing.assert_allclose(utc.since(1597579328) - 0.25, RECORDING.attitudes.t_s, rtol=0, atol=1e-9)


def test_spice_reads_what_is_written(kernels, spice):
    for path in kernels:
        spice.furnsh(str(path))
    ticks = ck.read_pointing(kernels[0]).ticks
    A = attitude.matrix_from_quaternion(RECORDING.attitudes.quaternions)
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
    spice.unload(str(kernels[0]))


def spice_quaternions(spice, q):
    return np.array([spice.m2q(A.copy()) for A in attitude.matrix_from_quaternion(q)])


@pytest.mark.parametrize("rates", [False, True])
@pytest.mark.parametrize("kind", [1, 3])
def test_what_spice_writes_is_read(spice, tmp_path, kind, rates):
    q = RECORDING.attitudes.quaternions[:250]
    ticks = 1e6 + 64.0 * np.arange(250)
    path = str(tmp_path / "theirs.bc")
    handle = spice.ckopn(path, "theirs", 0)
    turn = np.zeros((250, 3))
    if kind == 1:
        spice.ckw01(handle, ticks[0], ticks[-1], INSTRUMENT, "J2000", rates, "s", 250, ticks, spice_quaternions(spice, q), turn)
    else:
        starts = ticks[::2].copy()  # more than a hundred, so that they have a directory
        arguments = (250, ticks, spice_quaternions(spice, q), turn, len(starts), starts)
        spice.ckw03(handle, ticks[0], ticks[-1], INSTRUMENT, "J2000", rates, "s", *arguments)
    spice.ckcls(handle)
    found = ck.read_pointing(path)
    assert (found.instrument, found.frame) == (INSTRUMENT, 1)
    np.testing.assert_array_equal(found.ticks, ticks)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q), attitude.matrix_from_quaternion(q), rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 100, 101, 202])
def test_turns_of_constant_rate_that_spice_writes_are_read(spice, tmp_path, count):
    q = RECORDING.attitudes.quaternions[:count]
    starts, stops = 1e6 + 100.0 * np.arange(count), 1e6 + 100.0 * np.arange(count) + 60.0
    stops[count // 2] += 40.0  # reaches the next start
    turn, per_tick = np.tile([0.01, -0.02, 0.03], (count, 1)), np.full(count, 0.25)
    path = str(tmp_path / "theirs.bc")
    handle = spice.ckopn(path, "theirs", 0)
    arguments = (INSTRUMENT, "J2000", "s", count, starts, stops, spice_quaternions(spice, q), turn, per_tick)
    spice.ckw02(handle, starts[0], stops[-1], *arguments)
    spice.ckcls(handle)
    found = ck.read_pointing(path)
    assert found.ticks.size == 2 * count - (count > 1)
    spice.furnsh(path)
    # A clock of four ticks a second, which SPICE asks for the rates' sake only.
    for k in range(0, found.ticks.size, 13):
        C, _ = spice.ckgp(INSTRUMENT, found.ticks[k], 0.0, "J2000")
        np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q[k]), C, rtol=0, atol=1e-12)


@pytest.mark.parametrize("system", [sclk.TDB, sclk.TT])
def test_a_clock_with_several_rates_is_that_of_spice(spice, tmp_path, system):
    path = tmp_path / "clock.tsc"
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
SCLK01_COEFFICIENTS_95 = ( 0.0 6.0E8 1.0000001D0
  1024000000 601000000.125
  0.9999998 )
SCLK01_COEFFICIENTS_95 += ( 2.048e9 6.02e8 1 )
\\begintext
""")
    spice.furnsh(str(path))
    clock = sclk.read_sclk(path, SPACECRAFT)
    ticks = np.array([0.0, 1024.0, 5e8, 1.024e9, 1.5e9, 3e9])
    # GPS time is TT less 51.184 s, and TT comes from SPICE.
    tt = [spice.unitim(spice.sct2e(SPACECRAFT, tick), "ET", "TDT") for tick in ticks]
    since = clock.gps(ticks).since(0) + 51.184 - (7300 * 86400 + 43200)
    np.testing.assert_allclose(since, tt, rtol=0, atol=3e-7)
    with pytest.raises(InputError, match="1 times lie before"):
        clock.gps(np.array([-1.0]))


def quarter_turn(q, instrument=-1000, kind=1, rates=0, frame=1):
    data = np.array([*q, 5.0, 1.0])  # one attitude at tick 5
    return daf.Segment("hand", (5.0, 5.0), (instrument, frame, kind, rates), data)


def test_a_quarter_turn_by_hand(tmp_path):
    # The instrument's frame is the reference frame turned by +90 deg about z: C takes the reference's x to (0, −1, 0). SPICE's
    # matrix of (cos, sin z) turns vectors by +90 deg, so its quaternion is that of −90 deg: (√½, 0, 0, −√½).
    path = tmp_path / "hand.bc"
    daf.write(path, "CK", [quarter_turn([HALF, 0.0, 0.0, -HALF])], "by hand")
    found = ck.read_pointing(path)
    np.testing.assert_allclose(found.q, [[0.0, 0.0, HALF, HALF]], atol=1e-15)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q[0]) @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(ck._rotation(np.array([[HALF, 0, 0, -HALF]])).apply([1, 0, 0]), [[0, -1, 0]], atol=1e-15)


def test_files_of_the_other_byte_order_are_read(kernels):
    little = kernels[0].read_bytes()
    doubles = np.frombuffer(little, "<f8").astype(">f8")
    big = bytearray(doubles.tobytes())
    big[:1024] = little[:1024]
    for at in (8, 12, 76, 80, 84):
        big[at : at + 4] = little[at : at + 4][::-1]
    big[88:96] = b"BIG-IEEE"
    for at in range(1024 + 40, 1024 + 64, 4):  # the six integers of the one summary
        big[at : at + 4] = little[at : at + 4][::-1]
    big[2048:3072] = little[2048:3072]
    kernels[0].write_bytes(bytes(big))
    np.testing.assert_allclose(ck.read_pointing(kernels[0]).q, RECORDING.attitudes.quaternions, rtol=0, atol=1e-15)


def test_what_a_ck_lacks_is_said(tmp_path, kernels):
    path, half = tmp_path / "x.bc", [HALF, 0.0, 0.0, HALF]
    for segments, words in (
        ([quarter_turn([0.5, 0, 0, 0])], "quaternion 1 has norm 0.5"),
        ([quarter_turn(half, kind=5)], "segment 'hand' is of type 5; read are 1, 2 and 3"),
        ([quarter_turn(half, frame=-95)], "the reference frame is -95"),
        ([quarter_turn(half), quarter_turn(half, -2000)], "several instruments; there are -2000, -1000"),
        ([quarter_turn(half, rates=1)], "has 6 numbers, not the 9 of 1 attitudes"),
        ([quarter_turn(half, kind=2)], "type 2 has 6 numbers"),
    ):
        daf.write(path, "CK", segments, "x")
        with pytest.raises(InputError, match=words):
            ck.read_pointing(path)
    whole = kernels[0].read_bytes()
    for content, words in (
        (b"", "not a binary CK kernel"),
        (b"DAF/SPK ".ljust(4096), "not a binary CK kernel"),
        (whole[:1024], "is the file whole"),
        (whole[: len(whole) // 2], "lies outside the file; is it whole"),
        (whole[:88] + b"VAX-GFLT" + whole[96:], "its numbers are b'VAX-GFLT'"),
        (whole[:1024] + np.array([2.0, 0, 1]).tobytes() + whole[1048:], "list of arrays is damaged"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=words):
            ck.read_pointing(path)
    for read, words in (
        (lambda: ck.read_pointing(kernels[0], -7), "no instrument -7; there are -95001"),
        (lambda: ck.read_ck(*kernels, spacecraft=-7), "no clock of spacecraft -7; there are those of 95"),
        (lambda: ck.read_ck(*kernels[:1], tmp_path / "none.tsc"), "cannot be read"),
        (lambda: ck.write_ck(replace(RECORDING, time_scale="s"), path, path), "a CK needs dates"),
        (lambda: ck.write_ck(RECORDING, path, path, instrument=5), "instrument 5 must be -1000 or less"),
    ):
        with pytest.raises(InputError, match=words):
            read()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("SCLK_DATA_TYPE_95        = ( 1 )", "SCLK_DATA_TYPE_95 = ( 2 )", "not of type 1"),
        ("SCLK01_MODULI_95", "SCLK01_MODULO_95", "no SCLK01_MODULI_95"),
        ("( 0 650851397.434 1 )", "( 0 @2020-AUG-16 1 )", "does not hold numbers only"),
        ("( 0 650851397.434 1 )", "( 0 650851397.434 )", "coefficients of the clock cannot be"),
        ("( 0 650851397.434 1 )", "( 0 650851397.434 1 0 7 1 )", "not in the order"),
    ],
)
def test_what_a_clock_lacks_is_said(kernels, old, new, words):
    text = kernels[1].read_text()
    assert old in text
    kernels[1].write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words):
        ck.read_ck(*kernels)


def test_a_clock_is_as_fine_as_a_double_can_count(tmp_path):
    for days, per_second in ((1.0, 10**9), (200.0, 10**6)):
        t = np.array([0.0, days * 86400.0])
        made = Recording.from_arrays(
            t, np.zeros((2, 3)), t, np.tile([0, 0, 0, 1.0], (2, 1)), sigma=1e-3, arw=1e-6, sample_s=days * 86400.0,
            epoch="2020-01-01T00:00:00", time_scale="GPS", intervals=[Interval("a", "", 0.0, t[1])],
        )  # fmt: skip
        ck.write_ck(made, tmp_path / "a.bc", tmp_path / "a.tsc", instrument=INSTRUMENT)
        assert ck.read_pointing(tmp_path / "a.bc").ticks[1] == days * 86400 * per_second
        clock = ck.read_ck(tmp_path / "a.bc", tmp_path / "a.tsc").clock
        start = round((pd.Timestamp("2020-01-01") - pd.Timestamp("1980-01-06")).total_seconds())
        np.testing.assert_allclose(clock.since(start), t, rtol=0, atol=1e-6)


def test_a_gyro_and_a_ck_are_calibrated_and_the_way_back(run_cli, tmp_path):
    log = mems_log.log(np.random.default_rng(13), seconds=60.0)
    g = log.gyro.assign(time=pd.to_datetime(log.gyro["timestamp_ms"], unit="ms").dt.strftime("%Y-%m-%dT%H:%M:%S.%f"))
    g.to_csv(tmp_path / "gyro.csv", index=False)
    q = np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1)
    t = (log.attitude["timestamp_ms"] - mems_log.UNIX_MS).to_numpy() / 1000
    epoch = "2023-11-14T22:13:20.123Z"
    made = Recording.from_arrays(t, np.zeros((t.size, 3)), t, q, sigma=1e-3, arw=1e-6, epoch=epoch, time_scale="UTC")
    ck.write_ck(made, tmp_path / "a.bc", tmp_path / "a.tsc")
    arguments = [str(tmp_path / name) for name in ("gyro.csv", "a.bc", "a.tsc", "rec")]
    refused = run_cli("import", "ck", *arguments, "--time", "time:iso")
    assert (refused.exit_code, "gyro is missing" in refused.stderr) == (2, True)
    (tmp_path / "mine.toml").write_text('time = "time:iso"\ngyro = "gx,gy,gz:deg/s"\ntitle = "mine"\n')
    done = run_cli("import", "ck", *arguments, "--mapping", str(tmp_path / "mine.toml"))
    assert done.exit_code == 0, done.stderr
    assert gyrocal.load(tmp_path / "rec").title == "mine"
    result = gyrocal.calibrate(gyrocal.load(tmp_path / "rec"))
    error = result.parameters.vector - np.concatenate([log.G.ravel(), log.bias])
    assert np.abs(error / result.sigma).max() < 4
    back = run_cli("export", "ck", str(tmp_path / "rec"), str(tmp_path / "b.bc"), str(tmp_path / "b.tsc"))
    assert back.exit_code == 0, back.stderr
    again = ck.read_ck(tmp_path / "b.bc", tmp_path / "b.tsc")
    np.testing.assert_allclose(again.q, gyrocal.load(tmp_path / "rec").attitudes.quaternions, rtol=0, atol=1e-15)
