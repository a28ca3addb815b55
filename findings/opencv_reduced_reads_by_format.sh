#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: IMREAD_REDUCED_* is a clean average of JPEG files alone; others are another size, and alias.
# Believed: the flag reads a smaller image of the same picture, faster where the format helps. Seen of 241 x 321 pixels, by 2, 4 and 8: JPEG gives
# averages of blocks, with the size rounded up, 121 x 161, and everything where the factor says; PNG, WebP, TIFF and BMP give 120 x 160, squeezed, so
# that a spot in the middle is .5 pixels off, and interpolate between a few pixels of each block, so that noise of a standard deviation of 74
# keeps 49 of it at an eighth, where JPEG has 11. Boxes do not fit by the factor, and a data set of both formats is two data sets.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
y, x = np.mgrid[:241, :321]
spot = np.round(200 * np.exp(-((x - 160) ** 2 + (y - 120) ** 2) / 800)).astype(np.uint8)
noise = np.random.default_rng(0).integers(0, 256, (241, 321), dtype=np.uint8)


def reduced(image, ending, factor):
    options = {".jpg": [cv2.IMWRITE_JPEG_QUALITY, 100], ".webp": [cv2.IMWRITE_WEBP_QUALITY, 101]}.get(ending, [])
    data = cv2.imencode(ending, image, options)[1]
    return cv2.imdecode(data, getattr(cv2, f"IMREAD_REDUCED_GRAYSCALE_{factor}")).astype(float)


def place(image, factor):
    center = np.array([(image * axis).sum() / image.sum() for axis in np.indices(image.shape)[::-1]])
    return (center + 0.5) * factor - 0.5


for ending in (".jpg", ".png", ".webp", ".tiff", ".bmp"):
    for factor in (2, 4, 8):
        small, rough = reduced(spot, ending, factor), reduced(noise, ending, factor)
        moved = place(small, factor) - (160, 120)
        print(
            f"{ending} by {factor}: {small.shape}, moved by {moved.round(2).tolist()}, noise of {noise.std():.0f} keeps {rough.std():.0f}"
        )
        if ending == ".jpg":
            assert small.shape == (-(-241 // factor), -(-321 // factor)) and abs(moved).max() < 0.05
            assert rough.std() < 1.3 * noise.std() / factor
        else:
            assert small.shape == (241 // factor, 321 // factor) and np.allclose(moved, -0.5, atol=0.05)
            assert 0.6 * noise.std() < rough.std()
PROGRAM
