#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: key points of cv2.SIFT_create() lie a quarter of a pixel too far to the lower right.
# Believed: coordinates of key points are those of pixels, centers at whole numbers. Seen: the key point of a blob around (40, 40) is at
# (40.24, 40.24), at every size of blob, because the first octave is an image enlarged by the rule that keeps edges and is read by the one that
# keeps centers; enable_precise_upscale=True, off by default, gives (40, 40). The same offset in both images of a pair cancels
# in homographies between images of one size, and not in poses or where one of them was resized.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import cv2
import numpy as np

y, x = np.mgrid[:81, :81]
print("OpenCV", cv2.__version__)
for sigma in (3, 4, 6):
    blob = np.uint8(np.round(200 * np.exp(-((x - 40) ** 2 + (y - 40) ** 2) / (2 * sigma**2))))
    for precise in (None, True):
        options = {} if precise is None else {"enable_precise_upscale": precise}
        points = np.array([point.pt for point in cv2.SIFT_create(nfeatures=1, **options).detect(blob)])
        print("sigma", sigma, options, points[0].round(3))
        assert (abs(points - (40 if precise else 40.236)) < 0.005).all()
PROGRAM
