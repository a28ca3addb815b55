#!/usr/bin/env bash
# pyrr 0.10.3: a quaternion and the matrix made of it turn a vector in opposite directions, and pitch is around y for one and z for the other.
# Believed: Matrix33(q) turns as the quaternion q does, so that q * v and Matrix33(q) * v are one point, and create_from_eulers of both is one rotation.
# Seen: of a quarter turn around x the quaternion sends (0, 1, 0) to (0, 0, 1), as SciPy and the right-hand rule do, and its matrix to (0, 0, -1),
# for each of 100 random rotations the inverse, by apply_to_vector and by *. The numbers of the matrix are SciPy's, but the vector is multiplied from the
# left. Of the same roll, pitch and yaw a quaternion pitches around y and yaws around z, a matrix pitches around z and yaws around y, so that
# a camera that looks up in one rolls or turns in the other. Stay with one of the two.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyrr==0.10.3 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import numpy as np
from pyrr import Matrix33, Quaternion, Vector3, euler, matrix33, quaternion
from scipy.spatial.transform import Rotation

print("pyrr", version("pyrr"))
vector = np.array([0.0, 1.0, 0.0])
quarter = quaternion.create_from_x_rotation(np.pi / 2)
by_quaternion = quaternion.apply_to_vector(quarter, vector)
by_matrix = matrix33.apply_to_vector(matrix33.create_from_quaternion(quarter), vector)
print("a quarter around x of (0, 1, 0):", by_quaternion.round(6), "by the quaternion,", by_matrix.round(6), "by its matrix")
assert np.allclose(by_quaternion, [0, 0, 1]) and np.allclose(by_matrix, [0, 0, -1])
for k in range(100):
    rotation = Rotation.random(random_state=k)
    numbers = rotation.as_quat()  # x, y, z, w in both libraries
    vector = np.random.default_rng(k).normal(size=3)
    forth, back = rotation.apply(vector), rotation.inv().apply(vector)
    matrix = matrix33.create_from_quaternion(numbers)
    assert np.allclose(matrix, rotation.as_matrix())
    assert np.allclose(quaternion.apply_to_vector(numbers, vector), forth) and np.allclose(matrix33.apply_to_vector(matrix, vector), back)
    q = Quaternion(numbers)
    assert np.allclose(np.array(q * Vector3(vector)), forth) and np.allclose(np.array(Matrix33(q) * Vector3(vector)), back)
for name, axes in {"roll": "xx", "pitch": "yz", "yaw": "zy"}.items():
    angles = euler.create(**{name: 0.3})
    of_quaternion = Rotation.from_quat(quaternion.create_from_eulers(angles)).as_rotvec()
    of_matrix = Rotation.from_matrix(matrix33.create_from_eulers(angles)).as_rotvec()
    print(f"{name} of .3: around {of_quaternion.round(3)} by the quaternion, around {of_matrix.round(3)} by the matrix")
    x_y_z = dict(zip("xyz", 0.3 * np.eye(3)))
    assert np.allclose(of_quaternion, x_y_z[axes[0]]) and np.allclose(of_matrix, x_y_z[axes[1]])
PROGRAM
