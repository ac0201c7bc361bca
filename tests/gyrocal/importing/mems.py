"""A simulated MEMS log beside motion capture, as the files that imports read, and mappings of its tables."""

import numpy as np
import pandas as pd

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import validate_mapping
from gyrocal.importing.build import import_streams
from gyrocal.importing.streams import read_streams
from tests.gyrocal.importing import mems_log

EPOCH = "2023-11-14T22:13:20.123Z"
OPTIONS = ("--time", "time:iso", "--gyro", "gx,gy,gz:deg/s")
CORRECT_MAPPING = {"time": "timestamp_ms:ms", "gyro": "gx,gy,gz:deg/s", "quat": "qw,qx,qy,qz:body-to-inertial"}
INSTRUMENT = -95001
AEM = """CCSDS_AEM_VERS = 2.0
CREATION_DATE = 2020-01-01T00:00:00
ORIGINATOR = HAND
META_START
COMMENT by hand
OBJECT_NAME = ONE
OBJECT_ID = 2020-001A
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
TIME_SYSTEM = UTC
START_TIME = 2020-08-16T12:02:09.25
STOP_TIME = 2020-229T12:02:10
ATTITUDE_TYPE = QUATERNION
META_STOP
DATA_START
{rows}
DATA_STOP
"""


def write_gyro(log, path):
    """The gyro's table with dates; `OPTIONS` read it."""
    time = pd.to_datetime(log.gyro["timestamp_ms"], unit="ms").dt.strftime("%Y-%m-%dT%H:%M:%S.%f")
    log.gyro.assign(time=time).to_csv(path, index=False)
    return str(path)


def references(log):
    """Times (n,) of the attitudes, s since `EPOCH`, and quaternions (n, 4), inertial to body, scalar last."""
    t_s = (log.attitude["timestamp_ms"] - mems_log.UNIX_MS).to_numpy() / 1000
    return t_s, np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1)


def write_aem(log, path):
    """The attitudes as a message."""
    t_s, q = references(log)
    times = np.datetime64(EPOCH.rstrip("Z"), "ns") + np.round(1e9 * t_s).astype("timedelta64[ns]")
    rows = [f"{t} {' '.join(f'{x:.17g}' for x in one)}" for t, one in zip(times, q, strict=True)]
    path.write_text(AEM.format(rows="\n".join(rows)))
    return q


def write_clock(path, system=2, coefficients="0 650851397.434 1"):
    """A spacecraft's clock of 1024 ticks a second."""
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


def write_ck(log, kernel, clock):
    """The attitudes as a kernel of type 1, by NAIF's toolkit."""
    import spiceypy

    t_s, q = references(log)
    tt_s = (np.datetime64(EPOCH.rstrip("Z")) - np.datetime64("2000-01-01T12:00:00")) / np.timedelta64(1, "s") + 37 + 32.184
    write_clock(clock, coefficients=f"0 {tt_s:.6f} 1")
    spins = np.array([spiceypy.m2q(one.copy()) for one in attitude.matrix_from_quaternion(q)])
    ticks, handle = 1024 * t_s, spiceypy.ckopn(str(kernel), "theirs", 0)
    numbers = (len(ticks), ticks, spins, np.zeros((len(ticks), 3)))
    spiceypy.ckw01(handle, ticks[0], ticks[-1], INSTRUMENT, "J2000", False, "s", *numbers)
    spiceypy.ckcls(handle)


def largest_error(recording, log):
    """Of G and bias of a calibration, in its own sigmas."""
    result = gyrocal.calibrate(recording)
    error = result.parameters.vector - np.concatenate([log.G.ravel(), log.bias])
    return np.abs(error / result.sigma).max()


def find_refusal(data, changes):
    """The error that a mapping with changes ends in; empty if it is taken."""
    mapping = validate_mapping(CORRECT_MAPPING | changes, "mapping")
    try:
        import_streams(read_streams(data.gyro, data.attitude, mapping), mapping)
    except InputError as error:
        return str(error)
    return ""
