#!/usr/bin/env bash
# Pillow 13.0.0: rotate and transform of 16-bit images (I;16) with BILINEAR or BICUBIC return garbage.
# Believed: depth maps and medical images, which open as "I;16", turn like others; resize, crop, transpose and rotate with NEAREST do. Seen:
# these two filters read the image as bytes, so that a flat 1000 becomes 232 and 3, its two bytes, in turn, under the identity, and a ramp up to
# 61000 never exceeds 255. There is neither error nor warning; reduce, GaussianBlur and blend raise for the mode. Convert to "F" first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import PIL
from PIL import Image

print("Pillow", PIL.__version__)
flat = Image.fromarray(np.full((8, 8), 1000, np.uint16))
assert flat.mode == "I;16"
for name in ("NEAREST", "BILINEAR", "BICUBIC"):
    identity = np.asarray(flat.transform((8, 8), Image.Transform.AFFINE, (1, 0, 0, 0, 1, 0), Image.Resampling[name]))
    print(f"{name:8} a flat 1000 under the identity: {identity[4].tolist()}")
    assert (identity == (1000 if name == "NEAREST" else [232, 3] * 4)).all()
depth = np.arange(64 * 64, dtype=np.uint16).reshape(64, 64) * 15
for name in ("BILINEAR", "BICUBIC"):
    method = Image.Resampling[name]
    turned = np.asarray(Image.fromarray(depth).rotate(5, method))[16:48, 16:48].astype(float)
    right = np.asarray(Image.fromarray(depth.astype(np.float32)).rotate(5, method))[16:48, 16:48]
    shrunk = np.asarray(Image.fromarray(depth).resize((32, 32), method)).astype(float)
    shrunk_right = np.asarray(Image.fromarray(depth.astype(np.float32)).resize((32, 32), method))
    print(f"{name:8} a ramp turned by 5 degrees: {turned.min():.0f} to {turned.max():.0f}", end=", ")
    print(f"as floats {right.min():.0f} to {right.max():.0f}", end="; ")
    print(f"resized it differs from floats by {abs(shrunk - shrunk_right).max():.1f}")
    assert turned.max() < 256 and right.max() > 40000 and abs(shrunk - shrunk_right).max() <= 1
PROGRAM
