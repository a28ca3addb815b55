#!/usr/bin/env bash
# laspy 2.7.0: intensities, colors and scan angles that do not fit into a LAS file wrap around, where its other fields raise.
# Believed: what does not fit raises OverflowError, as coordinates that the scale has no room for do, classifications above 31 and returns above 7.
# Seen: an intensity of 70000 is stored as 4464, a color of 66000 as 464, user data of 300 as 44 and a scan angle of 200 as -56, without a word.
# Colors of 0 to 1, as most libraries of point clouds have them, are cut to 0, so that a cloud is black but for what is saturated, and 200.6 is 200.
# Scale, round and clip before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet laspy==2.7.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import sys

import laspy
import numpy as np

print("laspy", laspy.__version__)


def stored(field, values):
    """What a file holds of the values, or the error that assigning them raises."""
    cloud = laspy.LasData(laspy.LasHeader(point_format=2, version="1.2"))
    cloud.x = cloud.y = cloud.z = np.zeros(len(values))
    try:
        cloud[field] = np.array(values)
    except OverflowError:
        return "OverflowError"
    cloud.write(f"{sys.argv[1]}/cloud.las")
    return np.asarray(laspy.read(f"{sys.argv[1]}/cloud.las")[field]).tolist()


cases = {
    "classification": ([2, 40], "OverflowError"),
    "return_number": ([1, 9], "OverflowError"),
    "x": ([0, 1e9], "OverflowError"),
    "intensity": ([65535, 65536, 70000], [65535, 0, 4464]),
    "user_data": ([255, 300], [255, 44]),
    "scan_angle_rank": ([90, 200], [90, -56]),
    "point_source_id": ([65535, 65541], [65535, 5]),
    "red": ([255, 65536, 66000], [255, 0, 464]),
    "green": ([0.2, 0.5, 1.0], [0, 0, 1]),
    "blue": ([199.9, 200.6, 65535.9], [199, 200, 65535]),
}
for field, (values, expected) in cases.items():
    seen = stored(field, values)
    print(f"{field}: {values} becomes {seen}")
    assert seen == expected
PROGRAM
