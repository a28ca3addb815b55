#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.decolor turns pictures of a single tint black: sepia ones, gray ones, and gray ones with a red patch.
# Believed: a conversion from color to gray gives of a picture of few colors about its luminance, which is all that is there. Its documentation says that it is
# for color images. Seen of a ramp and of a smooth texture: sepia, gray times (.8, .9, 1) in BGR, is 0 in every pixel, and so are gray alone and gray
# with a patch of 10 x 10 pixels that is 50 redder. Nothing is raised. With noise of up to 2 levels in its colors the same gray picture has 0 to
# 255 and correlates by .98 and more with cv2.cvtColor's.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("opencv", cv2.__version__)
random = np.random.default_rng(0)
texture = cv2.GaussianBlur(random.integers(0, 256, (96, 120), dtype=np.uint8), (0, 0), 3)
grays = {"ramp": np.tile(np.arange(120, dtype=np.uint8) * 2, (96, 1)), "texture": cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)}
for name, gray in grays.items():
    plain = cv2.merge([gray] * 3)
    patch = plain.copy()
    patch[40:50, 40:50, 2] = cv2.add(plain[40:50, 40:50, 2], 50)
    pictures = {
        "gray": plain,
        "sepia": (plain * (0.8, 0.9, 1)).astype(np.uint8),
        "red patch": patch,
        "noisy colors": np.clip(plain.astype(int) + random.integers(-2, 3, plain.shape), 0, 255).astype(np.uint8),
    }
    for kind, picture in pictures.items():
        result, _ = cv2.decolor(picture)
        luminance = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        print(f"{name}, {kind}: luminance up to {luminance.max()}, decolor up to {result.max()}")
        if kind == "noisy colors":
            assert result.min() == 0 and result.max() == 255 and np.corrcoef(result.ravel(), luminance.ravel())[0, 1] > 0.98
        else:
            assert luminance.max() > 200 and result.max() == 0
PROGRAM
