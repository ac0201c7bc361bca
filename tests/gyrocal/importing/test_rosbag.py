"""Bags of ROS 1 and 2, made by the writers of the package that reads them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import rosbag
from tests.gyrocal.importing import mems, mems_log

rosbags = pytest.importorskip("rosbags.highlevel")

MS = 1_000_000


@pytest.fixture(scope="module")
def log():
    return mems_log.log(np.random.default_rng(21), seconds=60.0)


def bag(path, gyro, poses, kind="PoseStamped", version=1, extra=()):
    """A bag of rates (t_ns, x, y, z) and attitudes (t_ns, x, y, z, w), of topics /imu and /mocap, and of more topics of Imu."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    sequence = {"seq": 0} if version == 1 else {}

    def header(t):
        time = types["builtin_interfaces/msg/Time"](sec=int(t // 10**9), nanosec=int(t % 10**9))
        return types["std_msgs/msg/Header"](stamp=time, frame_id="world", **sequence)

    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    point, pose = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Pose"]
    nine, many = np.zeros(9), np.zeros(36)

    def imu(t, *w):
        # Its orientation is none, as of a driver that gives none: an all-zero quaternion.
        return types["sensor_msgs/msg/Imu"](
            header(t), quaternion(0.0, 0.0, 0.0, 0.0), nine, vector(*w), nine, vector(0.0, 0.0, 9.8), nine
        )

    def posed(t, *q):
        here = pose(point(0.0, 0.0, 0.0), quaternion(*q))
        if kind == "PoseStamped":
            return types["geometry_msgs/msg/PoseStamped"](header(t), here)
        if kind == "TransformStamped":
            turned = types["geometry_msgs/msg/Transform"](vector(0.0, 0.0, 0.0), quaternion(*q))
            return types["geometry_msgs/msg/TransformStamped"](header(t), "body", turned)
        spread = types["geometry_msgs/msg/PoseWithCovariance"](here, many)
        if kind == "PoseWithCovarianceStamped":
            return types["geometry_msgs/msg/PoseWithCovarianceStamped"](header(t), spread)
        still = types["geometry_msgs/msg/Twist"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
        moved = types["geometry_msgs/msg/TwistWithCovariance"](still, many)
        return types["nav_msgs/msg/Odometry"](header(t), "body", spread, moved)

    out = Writer1(path) if version == 1 else Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    serialized = store.serialize_ros1 if version == 1 else store.serialize_cdr
    messages = [("/imu", t, imu(t, *w)) for t, *w in gyro] + [("/mocap", t, posed(t, *q)) for t, *q in poses]
    messages += [(topic, t, imu(t, *w)) for topic in extra for t, *w in gyro]
    with out as writer:
        connections = {}
        for topic, t, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
            writer.write(connections[topic], t, serialized(message, message.__msgtype__))
    return path


def rows(log):
    w = np.deg2rad(log.gyro[["gx", "gy", "gz"]].to_numpy())
    q = np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1)
    gyro = [(int(t) * MS, *row) for t, row in zip(log.gyro["timestamp_ms"], w, strict=True)]
    return gyro, [(int(t) * MS, *row) for t, row in zip(log.attitude["timestamp_ms"], q, strict=True)]


def test_a_bag_is_imported_and_calibrated(run_cli, log, tmp_path):
    path = bag(tmp_path / "log", *rows(log), "Odometry", version=2)
    done = run_cli("import", "bag", str(path), str(tmp_path / "rec"))
    assert done.exit_code == 0, done.stderr
    assert "not independent" in " ".join(done.stdout.split())
    assert mems.largest_error(gyrocal.load(tmp_path / "rec"), log) < 4


@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry"])
def test_a_quarter_turn_by_hand(tmp_path, kind):
    # The body is turned by +90 deg about the world's z: its x axis is the world's y, and the world's x has there (0, −1, 0).
    half = np.sqrt(0.5)
    path = bag(tmp_path / "hand.bag", [(7, 0.1, 0.2, 0.3)], [(3_000_000_007, 0.0, 0.0, half, half)], kind)
    gyro, attitudes, said = rosbag.read_bag(path)
    assert gyro.to_numpy().tolist() == [[0.1, 0.2, 0.3, 7]]
    assert attitudes["t"].tolist() == [3_000_000_007]
    q = attitudes[["qx", "qy", "qz", "qw"]].to_numpy()
    np.testing.assert_allclose(attitude.matrix_from_quaternion(q)[0] @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(Rotation.from_quat(q[0]).apply([1, 0, 0]), [0, 1, 0], atol=1e-15)
    assert "rates are those of /imu" in said[0]


def test_what_is_wrong_with_a_bag_is_said(tmp_path):
    one, other = [(7, 0.1, 0.2, 0.3)], [(9, 0.0, 0.0, 0.0, 1.0)]
    path = bag(tmp_path / "b.bag", one, other, extra=("/imu2",))
    for call, words in (
        (lambda: rosbag.read_bag(path), "several topics of Imu; give --imu-topic: /imu, /imu2"),
        (lambda: rosbag.read_bag(bag(tmp_path / "c.bag", one, [])), "no topic of PoseStamped, .*; there are /imu"),
    ):
        with pytest.raises(InputError, match=words):
            call()
    whole = path.read_bytes()
    for length in (0, 2000, len(whole) - 3):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match="cannot be read as a bag"):
            rosbag.read_bag(path, "/imu")
