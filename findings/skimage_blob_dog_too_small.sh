#!/usr/bin/env bash
# scikit-image 0.26.0: the sigma that blob_dog finds is a sixth smaller than that of the blob on average, up to a third, and never larger.
# Believed: sigma is the standard deviation of the Gaussian that fits the blob, so that its radius is about sqrt(2) sigma, with errors to either side, as for
# blob_log. Seen of Gaussian blobs with sigmas from 3 to 12: .67 to 1.00 of it, .83 on average, by default, and .92 to 1.00 with sigma_ratio=1.1: of
# the two Gaussians whose difference fits best, s and ratio * s, the smaller one is returned. Times the square root of the ratio both are right within 5%
# on average. blob_log is right within 1% each time.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import skimage
from skimage.feature import blob_dog, blob_log

print("scikit-image", skimage.__version__)
squares = ((np.mgrid[:160, :160] - 80) ** 2).sum(0)
sigmas = np.arange(3, 12.1, 0.75)
found = {"blob_log": [], "blob_dog": [], "blob_dog, sigma_ratio=1.1": []}
for sigma in sigmas:
    image = np.exp(-squares / (2 * sigma**2))
    by_log = blob_log(image, 1, 16, 61, threshold=0.05)
    by_dog = blob_dog(image, 1, 16, threshold=0.05)
    finer = blob_dog(image, 1, 16, sigma_ratio=1.1, threshold=0.02)
    for name, blobs in zip(found, (by_log, by_dog, finer)):
        assert len(blobs) == 1 and (blobs[0, :2] == 80).all()
        found[name].append(blobs[0, 2])
for name, values in found.items():
    ratios = np.array(values) / sigmas
    print(f"{name}: found / true {ratios.min():.2f} to {ratios.max():.2f}, mean {ratios.mean():.3f}", np.round(values, 2).tolist())
    low, mean, root = {"blob_log": (0.99, 1, 1), "blob_dog": (0.66, 0.83, 1.6**0.5)}.get(name, (0.91, 0.96, 1.1**0.5))
    assert (
        low < ratios.min() < low + 0.02
        and abs(ratios.mean() - mean) < 0.01
        and ratios.max() < 1.01
        and abs(ratios.mean() * root - 1) < 0.05
    )
PROGRAM
