#!/usr/bin/env bash
# scikit-image 0.26.0: random_noise(mode="poisson") takes the number of different values in the image for that of photons.
# Believed: Poisson noise depends on how bright a pixel is, its standard deviation being the square root of the count, so that 100 of 255 has a deviation of
# 10. Seen: the count at white is the number of different values in the whole image, rounded up to a power of two, as the notes of the documentation say.
# The same gray of .4 has a deviation of .16 in an image of 16 values, .04 of 256, and .0012 beside a ramp of 160000 floats, that is of none, and amid
# two values most of it is lost. So an image that is resized in floats gets less noise than before, and a crop of 8 x 8 pixels four times that of the frame.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import skimage
from skimage.util import random_noise

print("scikit-image", skimage.__version__)
for levels in (2, 16, 256, 160000):
    image = np.full((400, 800), 0.4)
    image[:, 400:] = np.resize(np.linspace(0.4, 1, levels), (400, 400))
    noisy = random_noise(image, mode="poisson", rng=0)[:, :400]
    photons = 2 ** np.ceil(np.log2(len(np.unique(image))))
    print(f"gray of .4 amid {levels} values: mean {noisy.mean():.3f}, deviation {noisy.std():.4f}, of counts up to 255 it is {np.sqrt(0.4 / 255):.4f}")
    if levels > 2:
        assert abs(noisy.std() / np.sqrt(0.4 / photons) - 1) < 0.05
    else:
        assert 0.3 < noisy.std() < 0.5  # cut off at 1
ramps = np.add.outer(np.arange(256), np.arange(256)).astype(np.uint8)
deviations = []
for size in (256, 8):
    part = np.tile(ramps[100 : 100 + size, :size], (256 // size, 256 // size))
    noise = random_noise(part, mode="poisson", rng=0, clip=False) - part / 255
    deviations.append(noise[abs(part.astype(int) - 107) < 8].std())
    print(f"pixels of about 107 in a window of {size} pixels a side: deviation {deviations[-1] * 255:.1f} levels")
assert 3.5 < deviations[1] / deviations[0] < 4.5
PROGRAM
