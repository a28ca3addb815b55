#!/usr/bin/env bash
# pypylon 26.9 (Basler pylon): the conversion of Bayer images moves them half a pixel to the left and up, and leaves the last row and column black.
# Believed: RGB from ImageFormatConverter lies where the raw image does, as from cv2.cvtColor, so that a calibration made on one holds for
# the other. Seen for all four patterns: each pixel is made of the raw ones to its right and below, so that a smooth spot is .5 pixels further left
# and up in each channel, and up to 16 levels off where it is. Mono8 from Bayer moves likewise. The border is documented (InconvertibleEdgeHandling),
# the shift is not. cv2.cvtColor of the same raw image is within .02 pixels. A calibration on converted images needs .5 added to cx and cy for raw ones.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pypylon==26.9 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import cv2
import numpy as np
from pypylon import pylon

print("pypylon", version("pypylon"), "OpenCV", cv2.__version__)
height, width = 96, 120
y, x = np.mgrid[:height, :width]
spot = np.exp(-((x - 59.5) ** 2 + (y - 47.5) ** 2) / 200)
dark = np.array([20, 30, 40])
scene = np.round(spot[..., None] * [180, 120, 60] + dark).astype(np.uint8)


def raw(pattern):
    result = np.empty((height, width), np.uint8)
    for i, color in enumerate(pattern):
        result[i // 2 :: 2, i % 2 :: 2] = scene[i // 2 :: 2, i % 2 :: 2, "RGB".index(color)]
    return result


def by_pylon(bayer, pattern, output):
    image, converter = pylon.PylonImage(), pylon.ImageFormatConverter()
    data = bayer.tobytes()
    image.AttachMemoryView(memoryview(data), getattr(pylon, f"PixelType_Bayer{pattern}8"), width, height, 0)
    converter.OutputPixelFormat = getattr(pylon, "PixelType_" + output)
    return converter.Convert(image).GetArray().copy()


def moved(channel, floor):
    weight = channel[3:-3, 3:-3].astype(float) - floor
    return np.array([(weight * axis[3:-3, 3:-3]).sum() / weight.sum() for axis in (x - 59.5, y - 47.5)])


for pattern in ("RGGB", "BGGR", "GRBG", "GBRG"):
    bayer = raw(pattern)
    rgb, gray = by_pylon(bayer, pattern[:2], "RGB8packed"), by_pylon(bayer, pattern[:2], "Mono8")
    opencv = cv2.cvtColor(bayer, getattr(cv2, f"COLOR_Bayer{pattern}2RGB"))
    shifts = {name: [moved(image[..., i], dark[i]) for i in range(3)] for name, image in (("pylon", rgb), ("OpenCV", opencv))}
    off = abs(rgb[:-1, :-1].astype(int) - scene[:-1, :-1]).max()
    shifts["pylon's Mono8"] = [moved(gray, gray[3:10, 3:10].mean())]
    black = not (rgb[-1].any() or rgb[:, -1].any() or gray[-1].any() or gray[:, -1].any())
    print(
        f"{pattern}: moved by",
        {name: np.round(shift, 2).tolist() for name, shift in shifts.items()},
        f"{off} levels off, border black: {black}",
    )
    assert np.allclose(shifts["pylon"], -0.5, atol=0.03) and abs(np.array(shifts["OpenCV"])).max() < 0.03 and black and off >= 14
    assert np.allclose(shifts["pylon's Mono8"], -0.5, atol=0.15)
PROGRAM
