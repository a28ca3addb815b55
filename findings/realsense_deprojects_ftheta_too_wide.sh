#!/usr/bin/env bash
# pyrealsense2 2.59.1.11053: rs2_deproject_pixel_to_point is not the inverse of rs2_project_point_to_pixel for the fisheye model FTHETA.
# Believed: a pixel that is deprojected and projected again is the pixel, as it is for the models Brown-Conrady, its inverse and Kannala-Brandt. Seen:
# FTHETA projects by atan(2 r tan(w / 2)) / w, whose inverse is tan(w d) / (2 tan(w / 2)), and deprojects with atan(2 tan(w / 2)) in place of the
# divisor: every point comes out too far from the axis by the same factor, 1.03 at w = .3, 1.26 at .9 and 1.46 at 1.2, in the very center of the
# image, too: at .9 a point cloud is too wide by a quarter, and a pixel near the corner returns 50 pixels off. Divide x and y by the factor.
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
    result.fx = result.fy = 400
    result.ppx, result.ppy = 320, 240
    return result


def returns(intrinsics, pixel):
    return rs.rs2_project_point_to_pixel(intrinsics, rs.rs2_deproject_pixel_to_point(intrinsics, pixel, 1.0))


for w, factor in ((0.3, 1.0297), (0.9, 1.2577), (1.2, 1.4561)):
    fisheye = camera(rs.distortion.ftheta, [w, 0, 0, 0, 0])
    for x in (0.01, 0.2, 0.6):
        pixel = rs.rs2_project_point_to_pixel(fisheye, [x, 0, 1])
        exact = 320 + 400 * math.atan(2 * x * math.tan(w / 2)) / w
        back = rs.rs2_deproject_pixel_to_point(fisheye, pixel, 1.0)[0]
        print(
            f"w = {w}: x = {x} is seen at {pixel[0]:.2f} (by the formula {exact:.2f}) and comes back as {back:.4f}, {back / x:.4f} times it"
        )
        assert abs(pixel[0] - exact) < 0.01 and abs(back / x - factor) < 2e-3
        assert abs(2 * math.tan(w / 2) / math.atan(2 * math.tan(w / 2)) - factor) < 1e-4
models = {
    "FTHETA": camera(rs.distortion.ftheta, [0.9, 0, 0, 0, 0]),
    "BROWN_CONRADY": camera(rs.distortion.brown_conrady, [0.1, -0.2, 0.01, -0.005, 0.05]),
    "INVERSE_BROWN_CONRADY": camera(rs.distortion.inverse_brown_conrady, [0.1, -0.2, 0.01, -0.005, 0.05]),
    "KANNALA_BRANDT4": camera(rs.distortion.kannala_brandt4, [0.1, -0.02, 0.01, 0.001, 0]),
}
for name, intrinsics in models.items():
    off = max(math.dist(returns(intrinsics, [x, y]), (x, y)) for x in (0.0, 160.0, 500.0) for y in (0.0, 100.0, 400.0))
    print(f"{name}: pixels return within {off:.4f} pixels")
    assert 50 < off < 51 if name == "FTHETA" else off < 0.01
PROGRAM
