#!/usr/bin/env bash
# opencv-contrib-python-headless 5.0.0.93: ximgproc's RidgeDetectionFilter finds valleys; a bright line is black in it, between two lines that are not there.
# Believed: a ridge is a crest, a vessel or a road that is brighter than what is around it. Seen of a vertical, a horizontal and a slanting line, Gaussian across
# with a sigma of 2 pixels: of a bright one the result is about 0 along its crest and 255 from 4 to 6 pixels to either side of it; of a dark one it is
# 255 along the line and about 0 at these places. Neither its name nor its documentation tells the two apart. Invert images of bright lines first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("opencv", cv2.__version__)
y, x = np.mgrid[-32:33, -32:33]
for name, across in {"vertical": x, "horizontal": y, "slanting": (3 * x + 4 * y) / 5}.items():
    bright = np.round(20 + 200 * np.exp(-(across**2) / 8)).astype(np.uint8)
    inside = np.maximum(abs(x), abs(y)) < 20
    for kind, image in (("bright", bright), ("dark", 255 - bright)):
        ridges = cv2.ximgproc.RidgeDetectionFilter.create().getRidgeFilteredImage(image)
        near, beside, far = (ridges[inside & (abs(across) >= low) & (abs(across) <= high)] for low, high in ((0, 1), (3.8, 6), (9, 20)))
        print(f"{kind} {name} line: {near.min()} to {near.max()} on it, {beside.min()} to {beside.max()} 4 to 6 pixels beside it, {far.max()} far off")
        assert far.max() < 40
        assert near.max() < 40 and beside.min() > 200 if kind == "bright" else near.min() > 200 and beside.max() < 40
PROGRAM
