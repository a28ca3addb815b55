#!/usr/bin/env bash
# scikit-image 0.26.0: key points of feature.SIFT lie a quarter of a pixel too far to the lower right.
# Believed: keypoints and positions, which has fractions, are coordinates of pixels with their centers at whole numbers, as everywhere in the package. Seen:
# the blob around (40, 40) is at (40.24, 40.24) in positions by default, upsampling=2, at each size of blob that was tried, and at (40, 40) with 1. The
# first octave is an image enlarged from edge to edge, and its coordinates are only divided by 2, which leaves a quarter. Two libraries of SIFT
# agree with one another, OpenCV's is as far off by default, and not with the image. Subtract .25 from positions.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import skimage
from skimage.feature import SIFT

print("scikit-image", skimage.__version__)
y, x = np.mgrid[:81, :81]
for upsampling in (1, 2):
    for sigma in (3, 4, 6):
        blob = 0.1 + 0.8 * np.exp(-((x - 40) ** 2 + (y - 40) ** 2) / (2 * sigma**2))
        sift = SIFT(upsampling=upsampling)
        sift.detect(blob)
        nearest = np.hypot(*(sift.positions - 40).T).argmin()
        print(f"upsampling {upsampling}, sigma {sigma}: position {sift.positions[nearest].round(3)}, keypoint {sift.keypoints[nearest]}")
        assert np.allclose(sift.positions[nearest], 40 + (1 - 1 / upsampling) / 2, atol=0.03)
PROGRAM
