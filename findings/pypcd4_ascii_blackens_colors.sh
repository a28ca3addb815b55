#!/usr/bin/env bash
# pypcd4 1.5.1: every point of a colored cloud that is saved as PCD in ASCII is black.
# Believed: the three encodings of PCD hold the same numbers, ASCII with enough digits, and colors that encode_rgb packs come back from decode_rgb.
# Seen: of 1000 points in random colors all are black after a save with Encoding.ASCII, and exact in BINARY and BINARY_COMPRESSED; positions are
# exact in all. A color of PCD is three bytes that are taken for the bits of a float, which is then of the order of 1e-38, and floats are written
# with ten digits behind the point: 0.0000000000. Nothing warns, and other readers of the file see black, too. A field of the type uint32, as PCL
# has it for rgba, survives.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pypcd4==1.5.1 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import sys
from importlib.metadata import version

import numpy as np
from pypcd4 import Encoding, PointCloud

print("pypcd4", version("pypcd4"))
random = np.random.default_rng(0)
points = random.uniform(-5, 5, (1000, 3)).astype(np.float32)
colors = random.integers(0, 256, (1000, 3)).astype(np.uint8)
cloud = PointCloud.from_xyzrgb_points(np.c_[points, PointCloud.encode_rgb(colors)])
for encoding in (Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED):
    cloud.save(f"{sys.argv[1]}/cloud.pcd", encoding=encoding)
    back = PointCloud.from_path(f"{sys.argv[1]}/cloud.pcd")
    seen = PointCloud.decode_rgb(back.pc_data["rgb"])
    black = int((seen == 0).all(1).sum())
    print(f"{encoding.name}: colors as saved: {np.array_equal(seen, colors)}, {black} of 1000 points black", end=", ")
    print(f"positions off by {np.abs(back.numpy(('x', 'y', 'z')) - points).max():.1g}")
    assert np.allclose(back.numpy(("x", "y", "z")), points, atol=1e-6)
    assert np.array_equal(seen, colors) == (encoding != Encoding.ASCII) and black == (1000 if encoding == Encoding.ASCII else 0)
    if encoding == Encoding.ASCII:
        line = open(f"{sys.argv[1]}/cloud.pcd").read().split("DATA ascii\n")[1].splitlines()[0]
        print("    first line:", line, "color as a float:", cloud.pc_data["rgb"][0], "color", colors[0])
        assert line.split()[3] == "0.0000000000"
packed = (colors.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(1).astype(np.uint32)
whole = PointCloud.from_points((*points.T, packed), ("x", "y", "z", "rgba"), (*3 * [np.float32], np.uint32))
whole.save(f"{sys.argv[1]}/whole.pcd", encoding=Encoding.ASCII)
survives = np.array_equal(PointCloud.from_path(f"{sys.argv[1]}/whole.pcd").pc_data["rgba"], packed)
print("the same colors in ASCII as uint32: as saved:", survives)
assert survives
small = np.array([[1e-7, 2.5e-8, 1e-11]], np.float32)
PointCloud.from_xyz_points(small).save(f"{sys.argv[1]}/small.pcd", encoding=Encoding.ASCII)
seen = PointCloud.from_path(f"{sys.argv[1]}/small.pcd").numpy()
print("coordinates", small[0], "come back as", seen[0])
assert seen[0, 2] == 0 and np.isclose(seen[0, 1], 2.5e-8, rtol=0.01)
PROGRAM
