#!/usr/bin/env bash
# opencv-contrib-python-headless 5.0.0.93: xphoto.dctDenoising makes the last row and the last column black, and NaN in float32.
# Believed: what is denoised has all of its pixels, whatever the size of the patches. Seen of a flat image and of a noisy one, gray and in color, with patches of 8
# and 16 pixels and sizes that these divide or not: the last row and column are 0, where the image is 90 to 110, and all others right; as float32
# they are NaN, so that means of the result are NaN, too. Pad the image by a pixel first, and cut it off again.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("opencv", cv2.__version__)
random = np.random.default_rng(0)


def denoised(image, size):
    result = np.empty_like(image)
    cv2.xphoto.dctDenoising(image, result, 15.0, size)
    return result


for shape in ((96, 120), (97, 113), (128, 128, 3)):
    for size in (8, 16):
        for image in (np.full(shape, 100, np.uint8), random.integers(90, 111, shape, dtype=np.uint8)):
            result, floats = denoised(image, size), denoised(image.astype(np.float32), size) if len(shape) == 2 else None
            inside = result[:-1, :-1]
            print(
                f"{shape}, patches of {size}: {inside.min()} to {inside.max()}, last row up to {result[-1].max()}, column {result[:, -1].max()}"
            )
            assert inside.min() > 95 and inside.max() < 105 and not result[-1].any() and not result[:, -1].any()
            if floats is not None:
                assert np.isnan(floats[-1]).all() and np.isnan(floats[:, -1]).all() and np.isfinite(floats[:-1, :-1]).all()
            padded = cv2.copyMakeBorder(image, 0, 1, 0, 1, cv2.BORDER_REPLICATE)
            assert denoised(padded, size)[:-1, :-1].min() > 95
PROGRAM
