#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.blur of 8-bit images brightens where the window has 2, 4, 8 or 16 pixels a side.
# Believed: a box blur of a flat image is that image, and means are rounded to the nearest level. Seen: a window of two pixels
# turns 100 into 101 and white, 255, into 0; at 2x2, 38% of the pixels of noise are one level above the rounded mean, at 4x4 9%.
# 3x3, 5x5 are exact. The same call on float32 gives the means.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

noise = np.random.default_rng(0).integers(0, 256, (256, 256), dtype=np.uint8)
print("OpenCV", cv2.__version__)
above = {}
for side in (2, 3, 4, 5, 8, 16):
    of_bytes, mean = cv2.blur(noise, (side, side)).astype(int), cv2.blur(noise.astype(np.float64), (side, side))
    above[side] = (of_bytes - np.floor(mean + 0.5) > 0).mean(), (of_bytes - np.rint(mean.round(9)) > 0).mean()
    print(f"{side}x{side}: {above[side][0]:.1%} above the mean rounded half up, {above[side][1]:.1%} above it rounded half to even")
flat = {level: int(cv2.blur(np.full((8, 8), level, np.uint8), (2, 1))[4, 4]) for level in (100, 254, 255)}
print("flat images at 2x1:", flat)
assert flat == {100: 101, 254: 255, 255: 0}
assert above[2][0] > 0.24 and above[2][1] > 0.36 and above[4][0] > 0.05 and above[3][1] == above[5][1] == 0
PROGRAM
