"""Attitudes in every convention are the same A(q)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrocal import InputError, attitude
from gyrocal.importing import column_mapping

BODY = Rotation.random(20, rng=np.random.default_rng(3))  # active: body to inertial
A = BODY.as_matrix().transpose(0, 2, 1)  # inertial to body


def first(rotation):
    return np.roll(rotation.as_quat(), 1, axis=1)


WAYS = {
    "quat qw,qx,qy,qz:body-to-inertial": first(BODY),
    "quat qx,qy,qz,qw:body-to-world": BODY.as_quat(),
    "quat q0,q1,q2,q3:body-to-world": first(BODY),
    "quat q1,q2,q3,q4:scalar-last:body-to-inertial": BODY.as_quat(),
    "quat a,b,c,d:inertial-to-body:scalar-first": first(BODY.inv()),
    "euler yaw,pitch,roll:deg:ZYX:body-to-world": BODY.as_euler("ZYX", degrees=True),
    "euler a,b,c:rad:xyz:body-to-inertial": BODY.as_euler("xyz"),
    "euler a,b,c:rad:XZX:world-to-body": BODY.inv().as_euler("XZX"),
    "matrix a,b,c,d,e,f,g,h,i:body-to-inertial": BODY.as_matrix().reshape(-1, 9),
    "matrix a,b,c,d,e,f,g,h,i:inertial-to-body": A.reshape(-1, 9),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_write_an_attitude(way):
    kind, text = way.split(" ", 1)
    found = attitude.matrix_from_quaternion(column_mapping.convert_attitude(kind, text, WAYS[way]))
    np.testing.assert_allclose(found, A, atol=1e-12)


def test_euler_angles_by_hand():
    # Yaw by 90 deg, then pitch by 90 deg about the turned y: the body's x points down, its y to −x of the world.
    q = column_mapping.convert_attitude("euler", "y,p,r:deg:ZYX:body-to-world", np.array([[90.0, 90.0, 0.0]]))
    body_in_world = attitude.matrix_from_quaternion(q)[0].T
    np.testing.assert_allclose(body_in_world, [[0, -1, 0], [0, 0, 1], [-1, 0, 0]], atol=1e-15)


@pytest.mark.parametrize(
    ("kind", "text", "values", "words"),
    [
        ("quat", "q1,q2,q3,q4:body-to-inertial", np.eye(4), "scalar part first or last"),
        ("quat", "qw,qx,qy,qz:body-to-inertial", np.ones((2, 4)), "row 0: the four do not have norm 1"),
        ("matrix", "a,b,c,d,e,f,g,h,i:body-to-world", -np.eye(3).reshape(1, 9), "are not a rotation matrix"),
    ],
)
def test_what_an_attitude_lacks_is_said(kind, text, values, words):
    with pytest.raises(InputError, match=words):
        column_mapping.convert_attitude(kind, text, values)


BASE = {"time": "t:s", "gyro": "x,y,z:deg/s", "quat": "w,x,y,z:body-to-world"}


def test_mountings_are_stated_of_sensors_that_are_told_apart():
    half = np.sqrt(0.5)  # the sensor is turned by +90 deg about z
    entries = {"mountings": {"b": [0, 0, half, half]}, "mounting_sigma_deg": {"b": [0.1] * 3}}
    (A, sigma), *_ = column_mapping.validate_mapping(BASE | entries | {"attitude_by": "s"}, "x").build_mountings().values()
    np.testing.assert_allclose(A @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(sigma, np.deg2rad(0.1))
    for wrong, words in ((entries, "goes with attitude_by"), ({"mounting_sigma_deg": {"b": [0.1] * 3}}, "no mounting of b")):
        with pytest.raises(InputError, match=words):
            column_mapping.validate_mapping(BASE | wrong, "x").build_mountings()


def test_directions_of_gyros():
    tetrahedron = column_mapping.validate_mapping(BASE | {"axes": "tetrahedron"}, "x").build_G(4)
    axes = np.array(column_mapping.TETRAHEDRON)
    np.testing.assert_allclose(tetrahedron @ axes, np.eye(3), atol=1e-15)
    for entries, gyros, words in (
        ({}, 4, "4 columns; with other than three give the gyros' axes"),
        ({"axes": [[1, 0, 0], [0, 1, 0], [1, 1, 0]]}, 3, "do not measure all three"),
    ):
        with pytest.raises(InputError, match=words):
            column_mapping.validate_mapping(BASE | entries, "x").build_G(gyros)
