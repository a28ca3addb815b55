#!/usr/bin/env bash
# libvips 8.18.7 (pyvips 3.2.0): resize to a larger size moves the image half a pixel of the result to the right and down.
# Believed: resize keeps the image in its frame, as it does when it shrinks and by "nearest", so that enlarging a mirrored image gives the mirrored
# enlargement, as in Pillow, OpenCV and torch. Seen: at every scale above 1, by "linear" and "lanczos3", pixel x of the result shows what lies at
# x / scale - .5 in place of (x + .5) / scale - .5. Enlarged by 1.5 the content is a third of a source pixel off, and masks enlarged
# by "nearest" do not fit images enlarged by others. affine(..., odx=(scale - 1) / 2, ody=(scale - 1) / 2) is centered.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6 pillow==13.0.0
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import pyvips
from PIL import Image

print("libvips", ".".join(str(pyvips.version(part)) for part in range(3)))
ramp = np.tile(np.arange(64, dtype=np.float32), (8, 1))
image = pyvips.Image.new_from_array(ramp).cast("float")


def offset(row, scale):
    """How far the content is to the right, in pixels of the result."""
    x = np.arange(len(row))
    middle = slice(len(row) // 3, 2 * len(row) // 3)
    return (((x + 0.5) / scale - 0.5 - row)[middle] * scale).mean()


for scale in (1.5, 2, 3, 4, 0.75, 0.5, 0.25):
    moved = {}
    for kernel in ("linear", "lanczos3"):
        result = image.resize(scale, kernel=kernel)
        moved[kernel] = offset(result.numpy().reshape(result.height, result.width)[0], scale)
    by_pillow = Image.fromarray(ramp).resize((round(64 * scale), 8), Image.Resampling.BILINEAR)
    moved["Pillow"] = offset(np.asarray(by_pillow)[0], scale)
    print(f"scale {scale}: moved by", {name: round(float(by), 3) for name, by in moved.items()}, "pixels of the result")
    assert np.allclose([moved["linear"], moved["lanczos3"]], 0.5 if scale > 1 else 0, atol=0.02) and abs(moved["Pillow"]) < 0.02
for scale in (2, 3):
    half = (scale - 1) / 2
    result = image.affine([scale, 0, 0, scale], odx=half, ody=half, extend="copy")
    print(f"affine at scale {scale}: moved by {offset(result.numpy()[0].ravel(), scale):.3f}")
    assert abs(offset(result.numpy()[0].ravel(), scale)) < 0.01
nearest = image.resize(3, kernel="nearest").numpy().reshape(-1, 192)[0]
assert (nearest == np.repeat(np.arange(64), 3)).all()
step = pyvips.Image.new_from_array([[0, 0, 0, 0, 200, 200, 200, 200]]).cast("float")
result = step.resize(2, kernel="linear").numpy().ravel()
mirrored = step.flip("horizontal").resize(2, kernel="linear").flip("horizontal").numpy().ravel()
print("a step, doubled:", result[5:11].tolist(), "mirrored before and after:", mirrored[5:11].tolist())
assert not np.allclose(result, mirrored)
PROGRAM
