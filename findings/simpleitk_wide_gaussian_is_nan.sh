#!/usr/bin/env bash
# SimpleITK 2.5.7: DiscreteGaussian of a sigma of 27 pixels or more is NaN everywhere, and black of bytes, and from 16 on it blurs by too little.
# Believed: variance is that of the blur, and a wide one just takes longer. Seen of a peak amid 301 x 301 pixels: by the default maximumKernelWidth of 32, to
# either side, sigmas of 16, 20 and 26 blur by 14.2, 15.8 and 17.1; with 1000 they are right, but from 27 on every pixel is NaN with both, and of
# a flat image of bytes every pixel 0. Nothing is raised or printed. The variance is in units of the spacing: with pixels of .5 mm it
# happens from 13.5 mm on. SmoothingRecursiveGaussian is within 4% of sigma for all of them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet simpleitk==2.5.7 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import SimpleITK as sitk

print("SimpleITK", sitk.Version.VersionString())
peak = np.zeros((301, 301), np.float32)
peak[150, 150] = 1
axis = np.arange(301) - 150
narrow = {16: 14.2, 20: 15.8, 26: 17.1}


def blurred(image, sigma, **options):
    return sitk.GetArrayFromImage(sitk.DiscreteGaussian(image, float(sigma) ** 2, **options))


def deviation(array):
    row = array.astype(float).sum(0)
    return float(np.sqrt((row * axis**2).sum() / row.sum()))


peak, fine, flat = (sitk.GetImageFromArray(array) for array in (peak, peak, np.full((301, 301), 100, np.uint8)))
fine.SetSpacing((0.5, 0.5))
for sigma in (2, 8, 12, 16, 20, 26, 27, 28, 40):
    array, wide, gray = blurred(peak, sigma), blurred(peak, sigma, maximumKernelWidth=1000), blurred(flat, sigma)
    recursive = deviation(sitk.GetArrayFromImage(sitk.SmoothingRecursiveGaussian(peak, float(sigma))))
    print(f"sigma {sigma}: {deviation(array):.2f}, up to 1000 wide {deviation(wide):.2f}, recursive {recursive:.2f};", end=" ")
    print(f"{np.isnan(array).mean():.0%} NaN, flat 100 becomes {gray.min()} to {gray.max()}")
    assert abs(recursive / sigma - 1) < 0.04
    if sigma < 27:
        assert abs(deviation(array) - narrow.get(sigma, sigma * 0.967)) < 0.1 and abs(deviation(wide) / sigma - 1) < 0.04
        assert np.isfinite(blurred(fine, sigma / 2)).all() and gray.min() > 97
    else:
        assert np.isnan(array).all() and np.isnan(wide).all() and np.isnan(blurred(fine, sigma / 2)).all() and gray.max() == 0
PROGRAM
