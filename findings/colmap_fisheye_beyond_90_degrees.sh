#!/usr/bin/env bash
# pycolmap 4.2.1: the fisheye models project nothing at 90 degrees from the axis and beyond.
# Believed: OPENCV_FISHEYE is the model of lenses of 180 degrees and more, whose radius f theta goes on beyond 90 degrees. Seen: img_from_cam of a
# ray at 89 degrees is at f theta, and of one at 90 degrees or more NaN, for all three fisheye models that were tried; a lens of 200 degrees loses
# the outer tenth of its radius.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pycolmap==4.2.1 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import numpy as np
import pycolmap

print("pycolmap", pycolmap.__version__)
for model, params in (
    ("SIMPLE_FISHEYE", [200, 500, 500]),
    ("SIMPLE_RADIAL_FISHEYE", [200, 500, 500, 0]),
    ("OPENCV_FISHEYE", [200, 200, 500, 500, 0, 0, 0, 0]),
):
    camera = pycolmap.Camera(model=model, width=1000, height=1000, params=params)
    for degrees in (10, 80, 89, 91, 100):
        angle = np.radians(degrees)
        x, _ = camera.img_from_cam(np.array([[np.sin(angle), 0, np.cos(angle)]]))[0]
        print(f"{model}, {degrees} degrees: x = {x:.2f}, f theta + cx = {500 + 200 * angle:.2f}")
        assert np.isnan(x) if degrees > 90 else abs(x - 500 - 200 * angle) < 1e-6
PROGRAM
