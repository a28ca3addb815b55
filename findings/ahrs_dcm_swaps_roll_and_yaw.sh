#!/usr/bin/env bash
# AHRS 0.4.0: DCM(rpy=...) takes roll for yaw and yaw for roll, so that its matrix is another rotation than that of Quaternion(rpy=...).
# Believed: "rpy: Array with roll->pitch->yaw angles", as its documentation says, so that a camera's attitude may be held by either class. Seen: with
# (.3, 0, 0) the quaternion turns around x, and the matrix around z; with (.1, .2, .3) they are 18 degrees apart, and the matrix is that of (.3, .2, .1).
# What to_angles() of the quaternion says, (.1, .2, .3), is right, and so are SciPy's "ZYX" angles. With pitch alone both agree.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ahrs==0.4.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import importlib.metadata

import numpy as np
from ahrs import DCM, Quaternion
from scipy.spatial.transform import Rotation

print("AHRS", importlib.metadata.version("ahrs"))


def apart(a, b):
    return np.rad2deg(Rotation.from_matrix(np.asarray(a).T @ np.asarray(b)).magnitude())


for rpy in ((0.3, 0, 0), (0, 0.3, 0), (0, 0, 0.3), (0.1, 0.2, 0.3)):
    truth = Rotation.from_euler("ZYX", rpy[::-1]).as_matrix()
    swapped = Rotation.from_euler("ZYX", rpy).as_matrix()
    matrix, quaternion = np.asarray(DCM(rpy=rpy)), Quaternion(rpy=np.array(rpy))
    print(f"rpy {rpy}: matrix {apart(matrix, truth):.2f} degrees off, {apart(matrix, swapped):.2f} off swapped angles,", end=" ")
    print(f"quaternion {apart(quaternion.to_DCM(), truth):.2f} off, its angles {np.round(quaternion.to_angles(), 3) + 0.0}")
    assert apart(matrix, swapped) < 1e-4 and apart(quaternion.to_DCM(), truth) < 1e-4
    assert np.allclose(quaternion.to_angles(), rpy)
    assert (apart(matrix, truth) > 15) == (rpy[0] != rpy[2])
axis = Rotation.from_matrix(np.asarray(DCM(rpy=(0.3, 0, 0)))).as_rotvec()
print("axis of the matrix of a roll:", np.round(axis, 3) + 0.0)
assert np.allclose(axis, (0, 0, 0.3))
PROGRAM
