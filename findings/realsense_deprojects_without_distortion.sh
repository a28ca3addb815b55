#!/usr/bin/env bash
# pyrealsense2 2.59.1.11053: rs2_deproject_pixel_to_point takes no notice of the distortion where the model is MODIFIED_BROWN_CONRADY.
# Believed: deprojecting undoes the coefficients of any model, as it does for BROWN_CONRADY and for INVERSE_BROWN_CONRADY, or refuses. Seen: for the modified
# model the point is that of a lens without distortion, bit for bit, with no error, while rs2_project_point_to_pixel bends it: with coefficients of
# a usual lens pixels come back up to 12 pixels away, and a point cloud is bent as the image is. Depth and color of a camera that reports this
# model do not fit where rs2_project and rs2_deproject are mixed, as in an alignment by hand. Undistort the pixel by an iteration of one's own.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyrealsense2==2.59.1.11053 libusb-package==1.0.30.0
usb=$("$folder/venv/bin/python" -c "import libusb_package; print(libusb_package.get_library_path())")
ln -s "$usb" "$folder/libusb-1.0.so.0"  # no camera is needed, but the library is loaded
LD_LIBRARY_PATH="$folder" "$folder/venv/bin/python" - <<'PROGRAM'
import math

import pyrealsense2 as rs

print("pyrealsense2", rs.__version__)


def camera(model, coefficients):
    result = rs.intrinsics()
    result.width, result.height, result.model, result.coeffs = 640, 480, model, coefficients
    result.fx = result.fy = 600
    result.ppx, result.ppy = 320, 240
    return result


lens = [0.1, -0.2, 0.01, -0.005, 0.05]
plain = camera(rs.distortion.none, [0, 0, 0, 0, 0])
pixels = [(float(x), float(y)) for x in range(0, 641, 80) for y in range(0, 481, 80)]
for name in ("modified_brown_conrady", "brown_conrady", "inverse_brown_conrady"):
    bent = camera(getattr(rs.distortion, name), lens)
    points = [rs.rs2_deproject_pixel_to_point(bent, pixel, 1.0) for pixel in pixels]
    back = [rs.rs2_project_point_to_pixel(bent, point) for point in points]
    off = max(math.dist(*pair) for pair in zip(pixels, back))
    as_without = points == [rs.rs2_deproject_pixel_to_point(plain, pixel, 1.0) for pixel in pixels]
    moved = max(math.dist(rs.rs2_project_point_to_pixel(plain, point), seen) for point, seen in zip(points, back))
    print(f"{name}: the lens moves pixels by up to {moved:.1f}, they return within {off:.4f}; deprojected as without a lens: {as_without}")
    assert as_without == (name == "modified_brown_conrady") and moved > 5
    assert 11 < off < 13 if as_without else off < 0.01
PROGRAM
