#!/usr/bin/env bash
# libvips 8.18.7 (pyvips 3.2.0): gaussblur(sigma) blurs by less than sigma, and by nothing at all for a sigma of .5.
# Believed: sigma is the standard deviation of the blur, as in Pillow, OpenCV, SciPy and torchvision, so that models see the same images. Seen: the
# kernel is cut where it falls below min_ampl, .2 by default, which is at 1.8 sigma, and .5 becomes one pixel of weight 1. The standard
# deviations of results are 0, .74, 1.62 and 3.37 for .5, 1, 2 and 4, of floats as well as of bytes, and precision="float" changes little.
# min_ampl=0.01 gives .48, .98, 1.96 and 3.90.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import pyvips
from scipy import ndimage

print("libvips", ".".join(str(pyvips.version(part)) for part in range(3)))
dot = np.zeros((81, 81), np.float32)
dot[40, 40] = 1000
offsets = np.arange(81) - 40


def deviation(blurred):
    weights = np.asarray(blurred, np.float64).reshape(81, 81).sum(0)
    return float(np.sqrt((weights * offsets**2).sum() / weights.sum()))


image = pyvips.Image.new_from_array(dot).cast("float")
for sigma, narrow, better in ((0.5, 0, 0.48), (1, 0.74, 0.98), (2, 1.62, 1.96), (4, 3.37, 3.90)):
    seen = [deviation(image.gaussblur(sigma, **options).numpy()) for options in ({}, {"precision": "float"}, {"min_ampl": 0.01})]
    by_scipy = deviation(ndimage.gaussian_filter(dot, sigma))
    print(f"sigma {sigma}: default {seen[0]:.2f}, precision float {seen[1]:.2f}, min_ampl .01 {seen[2]:.2f}, SciPy {by_scipy:.2f}")
    assert np.allclose(seen, (narrow, narrow, better), atol=0.06) and abs(by_scipy - sigma) < 0.05
noise = pyvips.Image.new_from_array(np.random.default_rng(0).integers(0, 256, (64, 64), dtype=np.uint8))
assert (noise.gaussblur(0.5).numpy() == noise.numpy()).all()
print("noise of bytes, sigma 0.5: unchanged")
PROGRAM
