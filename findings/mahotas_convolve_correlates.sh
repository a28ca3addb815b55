#!/usr/bin/env bash
# mahotas 1.4.19: convolve and convolve1d correlate.
# Believed: "convolution of f and weights", as their documentation says, so that one bright pixel becomes the kernel.
# Seen: it becomes the kernel turned by 180 degrees, the bits of scipy.ndimage.correlate. Symmetric kernels hide it. With a
# derivative, a motion blur or a measured point spread function the sign or the direction is the opposite of what
# numpy.convolve, scipy.signal and scipy.ndimage.convolve give for the same call.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mahotas==1.4.19 numpy==2.2.6 scipy==1.17.1
"$folder/venv/bin/python" - <<'PROGRAM'
import mahotas
import numpy as np
from scipy import ndimage

print("mahotas", mahotas.__version__)
point, kernel = np.zeros(7), np.array([1.0, 2.0, 3.0])
point[3] = 1
seen = mahotas.convolve1d(point[None], kernel, 1)[0]
print("a point convolved with 1, 2, 3:", seen, "NumPy", np.convolve(point, kernel, "same"))
assert np.array_equal(seen, np.convolve(point, kernel[::-1], "same"))

image, kernel = np.random.default_rng(0).random((9, 12)), np.random.default_rng(1).random((3, 3))
seen = mahotas.convolve(image, kernel)
print("off scipy.ndimage.convolve", abs(seen - ndimage.convolve(image, kernel)).max())
print("off scipy.ndimage.correlate", abs(seen - ndimage.correlate(image, kernel)).max())
assert np.array_equal(seen, ndimage.correlate(image, kernel)) and abs(seen - ndimage.convolve(image, kernel)).max() > 0.1

ramp = np.tile(np.arange(12.0), (9, 1))  # rises to the right
slope = mahotas.convolve(ramp, np.array([[0.5, 0, -0.5]]))[4, 6]
print("slope of a rising ramp:", slope, "scipy.ndimage.convolve", ndimage.convolve(ramp, np.array([[0.5, 0, -0.5]]))[4, 6])
assert slope == -1
PROGRAM
