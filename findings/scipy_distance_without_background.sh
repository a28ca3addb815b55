#!/usr/bin/env bash
# scipy 1.17.1: ndimage.distance_transform_edt of an array without a zero measures to a point that is not there.
# Believed: without background the distance is infinite, or the call says so, as distance_transform_cdt (-1), distance_transform_bf
# (1e154) and cv2.distanceTransform (3e38) say it. Seen: the distance to the pixel (-1, 0), just above the upper left
# corner, plausible and finite. A signed distance map or a boundary loss, edt(mask) - edt(~mask), calls it so for every class
# that an image lacks: its map is a cone around one corner. Ask mask.any() and (~mask).any() first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scipy==1.17.1 numpy==2.4.6 opencv-python-headless==5.0.0.93
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import scipy
from scipy import ndimage

print("SciPy", scipy.__version__)
everywhere = np.ones((4, 5), np.uint8)
distance, nearest = ndimage.distance_transform_edt(everywhere, return_indices=True)
y, x = np.mgrid[:4, :5]
print(distance.round(2), "nearest zero of all pixels:", np.unique(nearest.reshape(2, -1), axis=1).T.tolist())
assert np.allclose(distance, np.hypot(y + 1, x)) and (nearest[0] == -1).all() and (nearest[1] == 0).all()
print("chamfer", np.unique(ndimage.distance_transform_cdt(everywhere)), "brute force", np.unique(ndimage.distance_transform_bf(everywhere)))
print("OpenCV", np.unique(cv2.distanceTransform(everywhere, cv2.DIST_L2, 5)))
assert (ndimage.distance_transform_cdt(everywhere) == -1).all() and ndimage.distance_transform_bf(everywhere).min() > 1e150
absent = np.zeros((256, 256), bool)
signed = ndimage.distance_transform_edt(absent) - ndimage.distance_transform_edt(~absent)
print(f"signed distance of an absent class: {signed[0, 0]:.1f} at the upper left, {signed[-1, -1]:.1f} at the lower right")
assert signed[0, 0] == -1 and abs(signed[-1, -1] + np.hypot(256, 255)) < 1e-9
PROGRAM
