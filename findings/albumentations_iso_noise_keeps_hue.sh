#!/usr/bin/env bash
# AlbumentationsX 2.5.1: the color noise of ISONoise is a standard deviation in degrees of hue, not in turns.
# Believed: what its documentation says, that color_shift_range is "in the range [0, 1], where 1 represents a full 360° hue rotation".
# Seen: at the largest setting, a shift of 1 with an intensity of 1, the hue of a flat float image varies by 1 degree, and at the
# defaults by some hundredths: then no byte of a flat color image changes, whatever its color.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet albumentationsx==2.5.1 opencv-python-headless==4.12.0.88 numpy==2.2.6 torch==2.13.0
"$folder/venv/bin/python" - <<'PROGRAM'
import albumentations as A
import cv2
import numpy as np

colors = [(200, 80, 40), (40, 200, 80), (80, 40, 200), (128, 128, 64)]
for color in colors:
    flat = np.full((64, 64, 3), color, np.float32) / 255  # without a spread of luminance there is no luminance noise
    noise = A.Compose([A.ISONoise(color_shift_range=(1.0, 1.0), intensity_range=(1.0, 1.0), p=1)], seed=0)
    hue = cv2.cvtColor(noise(image=flat)["image"], cv2.COLOR_RGB2HLS)[..., 0]
    print(f"{color}: hue varies by {hue.std():.3f} degrees at the largest setting", end=", ")
    assert 0.9 < hue.std() < 1.1
    bytes_of = np.full((64, 64, 3), color, np.uint8)
    default = A.Compose([A.ISONoise(p=1)], seed=0)
    changed = sum((default(image=bytes_of)["image"] != bytes_of).sum() for _ in range(20))
    print(f"{changed} of {20 * bytes_of.size} bytes change at the defaults")
    assert changed == 0
PROGRAM
