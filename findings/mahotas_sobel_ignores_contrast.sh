#!/usr/bin/env bash
# mahotas 1.4.19: sobel(just_filter=True) gives squares of gradients, of the image stretched to 0..1, so that contrast does not matter.
# Believed: what its documentation says, "the result of filtering the image with the sobel filters": the length of the gradient, twice as large
# for twice the contrast. Seen: an image and 1/1000 of it give the same up to rounding, noise of .001 on flat gray gives twice the mean of a picture,
# and the values are the square of the length, over 64, with which an edge of half the height has a quarter. A threshold or a mean
# over images means nothing. The square root times 8 times the range of the image is the length that cv2.Sobel has.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mahotas==1.4.19 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import mahotas
import numpy as np

print("mahotas", mahotas.__version__)
random = np.random.default_rng(0)
picture = cv2.GaussianBlur(random.random((60, 80)), (0, 0), 2)
inner = (slice(2, -2), slice(2, -2))


def by_mahotas(image):
    return mahotas.sobel(image, just_filter=True)[inner]


def length(image):
    return np.hypot(cv2.Sobel(image, -1, 1, 0), cv2.Sobel(image, -1, 0, 1))[inner]


for contrast in (1, 0.5, 1e-3):
    seen, exact = by_mahotas(contrast * picture), length(contrast * picture)
    print(f"contrast {contrast}: largest value {seen.max():.5f}, largest gradient {exact.max():.5f}")
    assert abs(seen - by_mahotas(picture)).max() < 1e-9 * seen.max()
    assert np.allclose(np.sqrt(seen) * 8 * np.ptp(contrast * picture), exact, rtol=1e-5, atol=1e-9)
steps = np.zeros((20, 60))
steps[:, 20:40], steps[:, 40:] = 0.5, 0.75  # a step and one of half its height
seen = by_mahotas(steps)[10]
print("a step, and one of half its height:", seen[15:22].max().round(5), seen[35:42].max().round(5))
assert np.isclose(seen[15:22].max(), 4 * seen[35:42].max())
flat = 0.5 + 1e-3 * random.standard_normal((60, 80))
print("means: noise of .001 on flat gray", by_mahotas(flat).mean().round(4), "the picture", by_mahotas(picture).mean().round(4))
assert by_mahotas(flat).mean() > by_mahotas(picture).mean()
PROGRAM
