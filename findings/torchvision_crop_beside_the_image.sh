#!/usr/bin/env bash
# torchvision 0.29.1 (torch 2.14.1, CPU): crop of a tensor gives another size where the window lies above or left of the image.
# Believed: crop(x, top, left, height, width) is (height, width) whatever the window covers, with zeros beyond the image, as for PIL
# images and for windows to the right or below. Seen: a window of 3 x 8 that ends two columns left of an image of 18 columns is
# 3 x 24, with pixels of the image in it; masks likewise, while the boxes of the same call have a canvas of 3 x 8 and PIL gives 3 x 8.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchvision==0.29.1 torch==2.14.1 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import torch
import torchvision
import torchvision.transforms.v2.functional as F
from PIL import Image
from torchvision import tv_tensors

print("torchvision", torchvision.__version__)
image = torch.full((1, 7, 18), 9.0)
picture = Image.fromarray(image[0].numpy().astype(np.uint8))
seen = {}
for window in ((0, 18, 3, 8), (9, 0, 3, 8), (0, -8, 3, 8), (0, -10, 3, 8), (-5, 0, 4, 8)):
    cut = F.crop(image, *window)
    seen[window] = tuple(cut.shape[1:]), int((cut != 0).sum())
    print(f"top, left, height, width {window}: tensor {seen[window]} (shape, pixels that are not 0), PIL {F.crop(picture, *window).size[::-1]}")
    assert F.crop(picture, *window).size[::-1] == window[2:]
assert [seen[w] for w in ((0, 18, 3, 8), (9, 0, 3, 8), (0, -8, 3, 8))] == [((3, 8), 0)] * 3
assert seen[0, -10, 3, 8] == ((3, 24), 48) and seen[-5, 0, 4, 8] == ((10, 8), 48)

boxes = tv_tensors.BoundingBoxes([[1, 1, 5, 5]], format="XYXY", canvas_size=(7, 18))
mask = F.crop(tv_tensors.Mask(torch.ones(7, 18)), 0, -10, 3, 8)
canvas = F.crop(boxes, 0, -10, 3, 8).canvas_size
print("mask", tuple(mask.shape), "canvas of the boxes", canvas)
assert tuple(mask.shape) == (3, 24) and canvas == (3, 8)
PROGRAM
