#!/usr/bin/env bash
# scikit-image 0.26.0: denoise_nl_means in its default, fast mode compares patches that are one pixel too small and lie off the pixel.
# Believed: fast_mode=True weights the pixels of a patch alike and is otherwise the classic algorithm; the patch of size 3 is the pixel and its
# eight neighbors. Seen: it is the pixel, the ones to the right and below, and the one between them, 2 by 2; sizes 5 and 7 are 4 and 6 wide, as well
# to the right and below. A computation by hand with such patches is within .01 of the result, with whole ones up to .14 off. The result of
# a mirrored image is not the mirrored result, .12 off for a bump of 1 that has no noise, which moves up and to the left; .002 with fast_mode=False.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import skimage
from scipy.ndimage import gaussian_filter
from skimage.restoration import denoise_nl_means

print("scikit-image", skimage.__version__)
grid = np.indices((41, 41))
bump = np.exp(-((grid - 20) ** 2).sum(0) / 18)
texture = gaussian_filter(np.random.default_rng(0).random((32, 32)), 1)
texture = (texture - texture.min()) / np.ptp(texture)


def by_hand(image, size, distance, h, first, last):
    """Patches of rows and columns first to last around a pixel."""
    rim = size + distance
    padded = np.pad(image, rim, mode="reflect")
    inside = (slice(rim, -rim),) * 2
    total, weights = np.zeros_like(image), np.zeros_like(image)
    for dy in range(-distance, distance + 1):
        for dx in range(-distance, distance + 1):
            other = np.roll(padded, (-dy, -dx), (0, 1))
            square = (padded - other) ** 2
            patch = sum(np.roll(square, (-y, -x), (0, 1)) for y in range(first, last + 1) for x in range(first, last + 1))
            weight = np.exp(-patch[inside] / (size * h) ** 2)
            total += weight * other[inside]
            weights += weight
    return total / weights


for name, image in (("texture", texture), ("bump", bump)):
    for size in (3, 5, 7):
        half = size // 2
        result = denoise_nl_means(image, size, 4, 0.1)
        off = {}
        for first, last in ((-half, half), (1 - half, half), (-half, half - 1)):
            off[first, last] = abs(result - by_hand(image, size, 4, 0.1, first, last))[9:-9, 9:-9].max()
        print(f"{name}, patch_size={size}: off from patches (first, last)", {key: round(float(by), 4) for key, by in off.items()})
        assert off[1 - half, half] < 0.01 and min(off[-half, half], off[-half, half - 1]) > 0.025
for fast in (True, False):
    result = denoise_nl_means(bump, 3, 6, 0.1, fast_mode=fast)
    center = [(result * axis).sum() / result.sum() for axis in grid]
    mirrored = abs(denoise_nl_means(bump[:, ::-1].copy(), 3, 6, 0.1, fast_mode=fast)[:, ::-1] - result).max()
    print(f"fast_mode={fast}: center {np.round(center, 3)} of (20, 20), the mirrored one is {mirrored:.4f} off")
    assert np.allclose(center, 19.88 if fast else 20, atol=0.01) and (mirrored > 0.1) == fast and (fast or mirrored < 0.005)
PROGRAM
