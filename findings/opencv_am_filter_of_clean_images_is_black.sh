#!/usr/bin/env bash
# opencv-contrib-python-headless 5.0.0.93: ximgproc.amFilter of an image without noise is black, and NaN in float32.
# Believed: the adaptive manifold filter smooths and keeps edges, so that an image of flat regions, a drawing, a label map or a masked object, is
# what it was, as by ximgproc.guidedFilter and cv2.bilateralFilter. Seen with sigma_s=16 and sigma_r=.2: a flat gray, two flat halves, a disk on a
# flat ground and a checkerboard are 0 in all their pixels, at 120 x 160 and at 480 x 640, and NaN in float32. With noise of one level all four keep
# their mean within 2 levels.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
random = np.random.default_rng(0)
for height, width in ((120, 160), (480, 640)):
    y, x = np.mgrid[:height, :width]
    flat = np.full((height, width), 120)
    images = {
        "flat": flat,
        "halves": np.where(x < width // 2, 120, 200),
        "disk": np.where(np.hypot(x - width / 2, y - height / 2) < height / 5, 200, 120),
        "checkerboard": 60 + 120 * ((x // 20 + y // 20) % 2),
    }
    for name, image in images.items():
        image = np.dstack([image] * 3).astype(np.uint8)
        noisy = np.uint8(np.rint(image + random.normal(0, 1, image.shape)))
        given = (image, np.float32(image) / 255, noisy)
        by_bytes, by_floats, of_noisy = (cv2.ximgproc.amFilter(each, each, 16, 0.2) for each in given)
        guided = cv2.ximgproc.guidedFilter(image, image, 8, 100)
        print(f"{width} x {height}, {name} of mean {image.mean():.1f}: {by_bytes.min()} to {by_bytes.max()},", end=" ")
        print(f"{np.isnan(by_floats).mean():.0%} NaN in float32,", end=" ")
        print(f"mean with noise {of_noisy.mean():.1f}, of guidedFilter {guided.mean():.1f}")
        assert not by_bytes.any() and np.isnan(by_floats).all()
        assert abs(of_noisy.mean() - image.mean()) < 2 and abs(guided.mean() - image.mean()) < 0.5
PROGRAM
