#!/usr/bin/env bash
# imutils 0.5.4 (OpenCV 5.0.0): rotate_bound by 90, 180 or 270 degrees moves the image by a pixel and puts black in place of a lost row or column.
# Believed: rotate_bound keeps all of the image, which is what it is for, so that by right angles every pixel is kept, as with np.rot90, and twice
# by 180 degrees is the image. Seen: by 90 degrees the turned image lies one pixel to the right, by 180 one to the right and down, by 270 one down,
# a black column or row comes first, and the last one is gone; rotate by 180 does the same, and a second turn brings nothing back. So boxes and
# masks that were turned otherwise are a pixel off. Nor does four_point_transform of an upright rectangle return its part of the image: 80 x 60
# pixels, given by the centers of the corner pixels, become 79 x 59, all of them resampled. For right angles take cv2.rotate.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet imutils==0.5.4 opencv-python-headless==5.0.0.93 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import cv2
import imutils
import numpy as np
from imutils.perspective import four_point_transform

print("imutils", version("imutils"), "OpenCV", cv2.__version__)
height, width = 96, 120
image = np.random.default_rng(0).integers(1, 256, (height, width), dtype=np.uint8)
lost = {90: (1, 0), 180: (1, 1), 270: (0, 1)}
for angle in (0, 90, 180, 270):
    seen, right = imutils.rotate_bound(image, angle), np.rot90(image, -angle // 90)
    columns, rows = lost.get(angle, (0, 0))
    black = int((seen == 0).sum())
    print(f"rotate_bound by {angle}: {seen.shape}, {black} black pixels, the turned image moved by {columns, rows}")
    assert seen.shape == right.shape
    assert np.array_equal(seen[rows:, columns:], right[: right.shape[0] - rows, : right.shape[1] - columns])
    assert not seen[:rows].any() and not seen[:, :columns].any()
for kind, turned in (("rotate", imutils.rotate(image, 180)), ("rotate_bound", imutils.rotate_bound(image, 180))):
    again = imutils.rotate(turned, 180) if kind == "rotate" else imutils.rotate_bound(turned, 180)
    print(f"{kind} by 180 degrees twice: {np.mean(again != image):.1%} of the pixels differ")
    assert np.array_equal(again[1:, 1:], image[1:, 1:]) and not again[0].any()

corners = np.array([[20, 10], [99, 10], [99, 69], [20, 69]], np.float32)  # of 80 x 60 pixels
part = image[10:70, 20:100]
seen = four_point_transform(image, corners)
print(
    f"four_point_transform of the corners of {part.shape}: {seen.shape}, {np.mean(seen == part[:59, :79]):.0%} of the pixels as they were"
)
assert seen.shape == (59, 79) and np.mean(seen == part[:59, :79]) < 0.1
PROGRAM
