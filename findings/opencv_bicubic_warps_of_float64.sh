#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.warpAffine and cv2.remap with INTER_CUBIC truncate float64 images to whole numbers at the border.
# Believed: a warp by the identity returns the image, in every type, and images in [0, 1] are as good as others. Seen: the first row and
# column and the last two of each lose their fractions, for every borderMode that was tried: 8.13 becomes 8, and images in [0, 1] have
# a black frame. float32 and uint8, and float64 with INTER_LINEAR or INTER_LANCZOS4, return the image.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

image = np.random.default_rng(0).random((12, 12)) * 10
x, y = np.meshgrid(np.arange(12, dtype=np.float32), np.arange(12, dtype=np.float32))
print("OpenCV", cv2.__version__)
for name in ("INTER_LINEAR", "INTER_CUBIC", "INTER_LANCZOS4"):
    for dtype in (np.float32, np.float64):
        for border in ("BORDER_CONSTANT", "BORDER_REPLICATE", "BORDER_REFLECT_101"):
            given, flags, mode = image.astype(dtype), getattr(cv2, name), getattr(cv2, border)
            for warped in (
                cv2.warpAffine(given, np.eye(2, 3), (12, 12), flags=flags, borderMode=mode),
                cv2.remap(given, x, y, flags, borderMode=mode),
            ):
                changed = abs(warped - given) > 1e-5
                print(name, dtype.__name__, border, changed.sum(), "pixels changed")
                if name == "INTER_CUBIC" and dtype is np.float64:
                    kept = np.zeros((12, 12), bool)
                    kept[1:-2, 1:-2] = True
                    assert (changed == ~kept).all() and (warped[~kept] == np.floor(given[~kept])).all()
                else:
                    assert not changed.any()
PROGRAM
