#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: CLAHE of a mirrored image is not the mirrored CLAHE of the image.
# Believed: tiles and their interpolation know no left and right, so mirroring for augmentation or at test time may come before or after
# CLAHE. Seen: tiles are interpolated half a pixel off their centers, so 65% of the bytes of a smooth picture of 128x192 with 8x8 tiles
# change, by up to 6 levels, though the tiles fit; where they do not fit, as in 101x143, padding on the right and at the bottom alone
# moves the tiles, too, and 90% change, by up to 21 levels (upside down 39). equalizeHist, cv2's blurs and 5x5 morphology are exact.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np


def smooth_picture(random, height, width):
    picture = cv2.GaussianBlur(random.integers(0, 256, (height, width)).astype(np.float32), (0, 0), 3)
    return ((picture - picture.min()) / np.ptp(picture) * 255).astype(np.uint8)


def middle_of_ramp(columns):
    """Where a row between two tiles has half of its rise."""
    columns = columns.astype(float)
    return np.interp((columns[0] + columns[-1]) / 2, columns[64:192], np.arange(64, 192))


print("OpenCV", cv2.__version__)
clahe = cv2.createCLAHE(clipLimit=4, tileGridSize=(8, 8))
functions = {"CLAHE": clahe.apply, "equalizeHist": cv2.equalizeHist, "blur": lambda x: cv2.GaussianBlur(x, (5, 5), 1.1)}
functions["dilate"] = lambda x: cv2.dilate(x, np.ones((5, 5), np.uint8))
random, seen = np.random.default_rng(0), {}
for height, width in ((128, 192), (101, 143)):
    picture = smooth_picture(random, height, width)
    for name, function in functions.items():
        for axis, way in ((1, "left and right"), (0, "upside down")):
            mirrored = np.flip(function(np.flip(picture, axis).copy()), axis)
            change = np.abs(mirrored.astype(int) - function(picture).astype(int))
            seen[name, width, axis] = int(change.max())
            print(f"{name} of {height}x{width}, {way}: {(change > 0).mean():.0%} of bytes change, by at most {change.max()} levels")
assert all(most == 0 for (name, *_), most in seen.items() if name != "CLAHE")
assert seen["CLAHE", 192, 1] >= 3 and seen["CLAHE", 143, 1] >= 20 and seen["CLAHE", 143, 0] >= 20

# Two tiles side by side, white under gray and black under gray: the gray row rises from one to the other.
tiles = np.zeros((128, 256), np.uint8)
tiles[:, :128] = 255
tiles[:16] = 128
clahe = cv2.createCLAHE(clipLimit=0, tileGridSize=(2, 1))
ahead, back = clahe.apply(tiles)[0], clahe.apply(tiles[:, ::-1].copy())[0, ::-1]
print("middle of the rise between two tiles of 128 columns:", middle_of_ramp(ahead), "and, mirrored twice,", middle_of_ramp(back))
assert middle_of_ramp(ahead) - middle_of_ramp(back) == 1
PROGRAM
