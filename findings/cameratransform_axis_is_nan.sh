#!/usr/bin/env bash
# cameratransform 1.2.1: with a lens, the ray of the pixel in the middle of the image is NaN, the one ray that no lens bends.
# Believed: a camera has a ray for each of its pixels, and the distortion at the principal point is none. Seen with BrownLensDistortion, also of coefficients 0,
# and with ABCDistortion: at the principal point, a whole pixel by default, the middle of an image of even size, getRay and spaceFromImage are NaN,
# and undistortImage leaves it black in a white image; the pixel beside it and the way back, imageFromSpace, are right, and without a lens all are.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet cameratransform==1.2.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import cameratransform as ct
import numpy as np

print("cameratransform", version("cameratransform"))
place = ct.SpatialOrientation(elevation_m=10, tilt_deg=45)
white = np.full((720, 1280, 3), 255, np.uint8)
for name, lens in {
    "no lens": ct.NoDistortion(),
    "Brown": ct.BrownLensDistortion(-0.1, 0, 0),
    "Brown of 0": ct.BrownLensDistortion(0, 0, 0),
    "ABC": ct.ABCDistortion(0.01, -0.02, 0.01),
}.items():
    projection = ct.RectilinearProjection(focallength_mm=6.2, sensor=(6.17, 4.55), image=(1280, 720))
    camera = ct.Camera(projection, place, lens)
    middle, beside = camera.getRay([[640, 360], [641, 360]])[1]
    ground = camera.spaceFromImage([[640, 360]])[0]
    back = camera.imageFromSpace([[0, 10, 0]])[0]
    pixels = camera.undistortImage(white)[360, 640:642, 0]
    print(f"{name}: ray of (640, 360) {middle.round(3)}, on the ground {ground}, of (641, 360) {beside.round(3)};", end=" ")
    print(f"(0, 10, 0) is seen at {back.round(3)}; undistorted white there {pixels}")
    assert np.isnan(middle).all() == np.isnan(ground).all() == (name != "no lens")
    assert pixels.tolist() == [255 if name == "no lens" else 0, 255]
    assert np.allclose(beside, [0.001, 0.707, -0.707], atol=1e-3) and np.allclose(back, [640, 360], atol=1e-2)
PROGRAM
