#!/usr/bin/env bash
# torchvision 0.29.1: bilinear warps of tensors with a fill weight the pixels at the border of the image twice.
# Believed: where a pixel of the result is half inside of the image, it is the mean of the image and the fill, as in Pillow and OpenCV.
# Seen: the image is sampled with zeros outside, which weights it once, and is then multiplied by the sampled mask, which weights it again:
# value * m^2 + fill * (1 - m) in place of value * m + fill * (1 - m). A white image on white has a gray outline, down to .75.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchvision==0.29.1 torch==2.14.1 numpy pillow
"$folder/venv/bin/python" - <<'PROGRAM'
import torch
from torchvision.transforms.v2 import InterpolationMode
from torchvision.transforms.v2 import functional as F

white = torch.ones(3, 41, 41)
half = [1, 0, 0.5, 0, 1, 0, 0, 0]  # reads half a pixel to the right
warps = {
    "moved by half a pixel": F.perspective(white, None, None, InterpolationMode.BILINEAR, 1.0, half),
    "rotated by 30 degrees": F.rotate(white, 30, InterpolationMode.BILINEAR, fill=1.0),
    "affine, 30 degrees": F.affine(white, 30, [0, 0], 1.0, [0, 0], InterpolationMode.BILINEAR, fill=1.0),
}
for name, y in warps.items():
    print(f"white on white, {name}: {int((y[0] < 0.999).sum())} of 1681 pixels are gray, the darkest is {y.min():.3f}")
    assert abs(float(y.min()) - 0.75) < 0.01
PROGRAM
