#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.phaseCorrelate of fine textures finds whole pixels only: a shift of .25 is .02, and one of .4 is .09.
# Believed: what its documentation says, that the centroid of 5 x 5 pixels around the peak gives subpixel accuracy. Seen of white noise, and of noise that is
# blurred by one pixel, shifted exactly, by the Fourier transform: .1 is .00, .25 is .02, .4 is .09, .6 is .91 and .75 is .98, along both
# axes, with a window or without: the peak of a shift between pixels has negative neighbors, which pull the centroid back. scikit-image's
# phase_cross_correlation is right within .01 with upsample_factor=100.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 scikit-image==0.26.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
from skimage.registration import phase_cross_correlation

print("opencv", cv2.__version__)
window = cv2.createHanningWindow((256, 256), cv2.CV_64F)
x, y = np.fft.fftfreq(256)[None], np.fft.fftfreq(256)[:, None]


def moved(image, right, down):
    return np.real(np.fft.ifft2(np.fft.fft2(image) * np.exp(-2j * np.pi * (x * right + y * down))))


for blur in (0, 1):
    image = np.random.default_rng(0).random((256, 256))
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    for shift, expected in ((0.1, 0.002), (0.25, 0.023), (0.4, 0.092), (0.6, 0.908), (0.75, 0.977), (1, 1)):
        other = moved(image, shift, -shift)
        plain, windowed = (cv2.phaseCorrelate(image, other, *extra)[0] for extra in ((), (window,)))
        exact = -phase_cross_correlation(image, other, upsample_factor=100)[0][::-1]
        print(f"blur {blur}, shift ({shift}, {-shift}): {np.round(plain, 3)}, with a window {np.round(windowed, 3)}, scikit-image {exact}")
        assert np.allclose([plain, windowed], [expected, -expected], atol=0.004) and np.allclose(exact, [shift, -shift], atol=0.011)
PROGRAM
