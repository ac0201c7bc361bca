"""Faults of conventions: attitudes, recordings, files and units."""

from tests.mutations.fault import of

RECORDING = "tests/gyrocal/recording/"
ON_FILE = f"{RECORDING}test_recording.py {RECORDING}test_conventions.py"

ATTITUDE = of(
    "gyrocal/attitude.py",
    "tests/gyrocal/test_attitude.py",
    [
        (
            "A(q) is transposed",
            "np.asarray(np.swapaxes(Rotation.from_quat(q).as_matrix(), -1, -2))",
            "np.asarray(Rotation.from_quat(q).as_matrix())",
        ),
        (
            "quaternions are scalar first",
            "Rotation.from_quat(q).as_matrix()",
            "Rotation.from_quat(q, scalar_first=True).as_matrix()",
        ),
        ("the scalar part may be negative", "as_quat(canonical=True)", "as_quat(canonical=False)"),
        (
            "the residual has the other sign",
            "Rotation.from_matrix(A_obs @ np.swapaxes(A_prop, -1, -2))",
            "Rotation.from_matrix(A_prop @ np.swapaxes(A_obs, -1, -2))",
        ),
        (
            "one component of the linear residual has the other sign",
            "delta[..., 0, 2] - delta[..., 2, 0]",
            "delta[..., 2, 0] - delta[..., 0, 2]",
        ),
    ],
)

FORMAT = [
    *of(
        "gyrocal/recording/names.py",
        ON_FILE,
        [
            (
                "quaternions are scalar first on file",
                'QUATERNION_COLUMNS = ("q1", "q2", "q3", "q4")',
                'QUATERNION_COLUMNS = ("q4", "q1", "q2", "q3")',
            ),
            (
                "sigmas are written about the wrong axes",
                'SIGMA_COLUMNS = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")',
                'SIGMA_COLUMNS = ("sigma_z_deg", "sigma_y_deg", "sigma_x_deg")',
            ),
        ],
    ),
    *of(
        "gyrocal/recording/format.py",
        ON_FILE,
        [
            (
                "rates are read as rad/s",
                "rates=np.deg2rad(tables.columns(gyro, rates))",
                "rates=tables.columns(gyro, rates)",
            ),
            (
                "sigmas are read as rad",
                "sigma=np.deg2rad(tables.columns(attitude, SIGMA_COLUMNS))",
                "sigma=tables.columns(attitude, SIGMA_COLUMNS)",
            ),
            (
                "the angle random walk is read as rad",
                "arw=float(np.deg2rad(said.gyro.arw_deg_per_sqrt_s))",
                "arw=said.gyro.arw_deg_per_sqrt_s",
            ),
            (
                "the a-priori bias is read as rad/s",
                "apriori_bias=np.deg2rad(said.gyro.apriori_bias_deg_s)",
                "apriori_bias=np.array(said.gyro.apriori_bias_deg_s)",
            ),
        ],
    ),
    *of(
        "gyrocal/recording/header.py",
        ON_FILE,
        [
            (
                "G is written with rows for columns",
                '"apriori_G": gyro.apriori_G.tolist()',
                '"apriori_G": gyro.apriori_G.T.tolist()',
            ),
        ],
    ),
    *of(
        "gyrocal/recording/checks.py",
        ON_FILE,
        [
            (
                "a time that repeats passes",
                "back = np.flatnonzero(np.diff(t_s) <= 0)",
                "back = np.flatnonzero(np.diff(t_s) < 0)",
            ),
            ("quaternions far from the unit pass", "NORM_TOLERANCE = 1e-6", "NORM_TOLERANCE = 1e-1"),
            (
                "intervals that overlap pass",
                "if second.start_s < first.stop_s - TIME_TOLERANCE_S:",
                "if second.stop_s < first.stop_s - TIME_TOLERANCE_S:",
            ),
        ],
    ),
]

FILES = [
    *of(
        "gyrocal/recording/parquet.py",
        f"{RECORDING}test_parquet.py",
        [("a wrong checksum of the content passes", "stated != digest(table)", "not digest(table)")],
    ),
    *of(
        "gyrocal/recording/sensor_tables.py",
        f"{RECORDING}test_sensor_tables.py {RECORDING}test_conventions.py",
        [
            (
                "penetration angles are read as rad",
                "angles = np.deg2rad(_numbers(frame, name, PENETRATIONS, finite=False))",
                "angles = _numbers(frame, name, PENETRATIONS, finite=False)",
            )
        ],
    ),
    *of(
        "gyrocal/files.py",
        "tests/gyrocal/test_files.py",
        [
            ("a link at the temporary name is followed", 'open(temporary, "xb")', 'open(temporary, "wb")'),
            (
                "a link is replaced",
                "    if path.is_symlink():\n        raise OSError(errno.ELOOP",
                "    if path.is_symlink() and not path.exists():\n        raise OSError(errno.ELOOP",
            ),
        ],
    ),
    *of(
        "gyrocal/importing/units.py",
        "tests/gyrocal/importing/test_units.py",
        [
            ("deg/h are deg/min", '"deg/h": DEGREE / 3600', '"deg/h": DEGREE / 60'),
            ("leap seconds are added", "clock.whole + shift - behind", "clock.whole + shift + behind"),
        ],
    ),
]

FAULTS = [*ATTITUDE, *FORMAT, *FILES]
