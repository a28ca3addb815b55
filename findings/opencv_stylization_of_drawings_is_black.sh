#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.stylization and edgePreservingFilter(flags=NORMCONV_FILTER) make clean images of up to 90 rows black.
# Believed: what is smooth already stays as it is, a drawing, a ramp or a rendered icon, at every size, as with RECURS_FILTER, the default, and with
# cv2.bilateralFilter. Seen at the defaults, sigma_s=60: two flat halves and a ramp of 64 x 80 are 0 in all their pixels, and so they are of 90 rows and
# 300 columns; of 100 rows they stay within a level, and so they do with sigma_s=10. Noise of one level keeps edgePreservingFilter of 64 x 80
# within 2 levels on average: what is lost has no detail across a window that is larger than the image. stylization depends on it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
random = np.random.default_rng(0)
for height, width in ((64, 80), (90, 300), (100, 300), (300, 400)):
    x = np.tile(np.arange(width), (height, 1))
    for name, row in (("halves", np.where(x < width // 2, 120, 200)), ("ramp", 60 + 140 * x / width)):
        image = np.dstack([row] * 3).astype(np.uint8)
        noisy = np.uint8(np.rint(image + random.normal(0, 1, image.shape)))
        results = {
            "NORMCONV_FILTER": cv2.edgePreservingFilter(image, flags=cv2.NORMCONV_FILTER),
            "of sigma_s=10": cv2.edgePreservingFilter(image, flags=cv2.NORMCONV_FILTER, sigma_s=10),
            "with noise": cv2.edgePreservingFilter(noisy, flags=cv2.NORMCONV_FILTER),
            "RECURS_FILTER": cv2.edgePreservingFilter(image),
            "stylization": cv2.stylization(image),
        }
        print(f"{height} x {width}, {name} of mean {image.mean():.1f}:", end=" ")
        print(", ".join(f"{key} {result.mean():.1f}" for key, result in results.items()))
        for key, result in results.items():
            black = height <= 90 and key in ("NORMCONV_FILTER", "stylization")
            assert not result.any() if black else abs(result.mean() - image.mean()) < (20 if key == "stylization" else 2)
PROGRAM
