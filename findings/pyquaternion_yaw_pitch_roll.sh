#!/usr/bin/env bash
# pyquaternion 0.9.9: yaw_pitch_roll gives the angles of x-y'-z'', and not of z-y'-x'', as it says: what is tilted gets another heading.
# Believed: the first line of its documentation, "intrinsic Tait-Bryan angles following the z-y'-x'' convention", which yaw, pitch and roll of
# vehicles and cameras follow: R = Rz(yaw) Ry(pitch) Rx(roll). Seen of 30, 20 and 15 degrees: 26.5, 24.6 and 3.7, the ones that make R = Rx Ry Rz,
# which its last line says. Where two of the three are 0 both are the same, and near 0 almost. Of a car that has turned by 90 degrees and climbs by
# 10 the pitch is 0, and the roll -10. nuScenes' boxes and poses are such quaternions. SciPy's Rotation.from_quat(q[[1, 2, 3, 0]]).as_euler("ZYX")
# gives the three.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyquaternion==0.9.9 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import numpy as np
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation

print("pyquaternion", version("pyquaternion"))


def about(axis, degrees):
    return Quaternion(axis=axis, degrees=degrees)


x, y, z = np.eye(3)
first_line = Quaternion.yaw_pitch_roll.__doc__.splitlines()[0]
print(first_line)
assert "z-y'-x''" in first_line
for yaw, pitch, roll in ((30, 20, 15), (90, 10, 0), (90, 0, 10), (170, 5, 5), (30, 0, 0), (0, 20, 0), (0, 0, 15)):
    turn = about(z, yaw) * about(y, pitch) * about(x, roll)
    seen = np.degrees(turn.yaw_pitch_roll)
    rotation = Rotation.from_quat(turn.q[[1, 2, 3, 0]])
    intrinsic, reverse = rotation.as_euler("ZYX", degrees=True), rotation.as_euler("XYZ", degrees=True)[::-1]
    print(
        f"yaw, pitch and roll {yaw, pitch, roll}: {seen.round(2) + 0.0}, SciPy's ZYX {intrinsic.round(2) + 0.0}, its XYZ, reversed,",
        reverse.round(2) + 0.0,
    )
    assert np.allclose(intrinsic, [yaw, pitch, roll]) and np.allclose(seen, reverse)
    again = about(x, seen[2]) * about(y, seen[1]) * about(z, seen[0])
    assert np.allclose(again.rotation_matrix, turn.rotation_matrix)
    assert np.allclose(seen, intrinsic) == (np.count_nonzero([yaw, pitch, roll]) == 1)
PROGRAM
