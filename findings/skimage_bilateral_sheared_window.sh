#!/usr/bin/env bash
# scikit-image 0.26.0: the spatial weights of restoration.denoise_bilateral are not a round Gaussian but one that is sheared and off center.
# Believed: where sigma_color is so large that colors do not matter the filter is a Gaussian blur, centered at the pixel, and mirroring an image
# mirrors the result. Seen: by default a single white pixel becomes two diagonal streaks, of which nothing lies where it was, with their center
# of mass (1.1, -1.7) from it; every inner pixel of a smooth image differs from the mirrored result of the mirrored image, by up to a fifth
# of its range. The table of weights is made for win_size + 1 pixels a side and read in rows of win_size, at every size that was tried.
# cv2.bilateralFilter of the same image as float32 gives the Gaussian.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6 opencv-python-headless==5.0.0.93
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import skimage
from scipy import ndimage
from skimage.restoration import denoise_bilateral

print("scikit-image", skimage.__version__)
dot = np.zeros((31, 31))
dot[15, 15] = 1
y, x = np.mgrid[-15:16, -15:16]
gaussian = np.exp(-(x**2 + y**2) / 2) / np.exp(-(x**2 + y**2) / 2).sum()
print("a white pixel, sigma_spatial 1, any color:")
print(denoise_bilateral(dot, sigma_color=1e3, sigma_spatial=1)[11:20, 11:20].round(2))
for options in ({}, {"win_size": 5}, {"win_size": 9}, {"win_size": 15}):
    seen = denoise_bilateral(dot, sigma_color=1e3, sigma_spatial=1, **options)
    center = [float((seen * axis).sum() / seen.sum()) for axis in (x, y)]
    print(f"{options or 'default'}: {seen[15, 15]:.3f} stay at the pixel, of a Gaussian {gaussian[15, 15]:.3f}; center of mass", np.round(center, 2))
    assert seen[15, 15] < 0.005 and np.hypot(*center) > 1
by_opencv = cv2.bilateralFilter(dot.astype(np.float32), 9, 1e3, 1.0)
assert abs(by_opencv - gaussian).max() < 0.005
image = ndimage.gaussian_filter(np.random.default_rng(0).random((61, 75)), 1.5)
result, mirrored = denoise_bilateral(image), denoise_bilateral(image[:, ::-1].copy())[:, ::-1]
inner = (slice(10, -10), slice(10, -10))
difference = abs(result - mirrored)[inner] / np.ptp(image)
print(f"mirrored: {(difference > 1e-6).mean():.0%} of the inner pixels differ, by up to {difference.max():.2f} of the range")
assert (difference > 1e-6).mean() > 0.99 and 0.1 < difference.max() < 0.3
PROGRAM
