#!/usr/bin/env bash
# torchvision 0.29.1 (torch 2.14.1): v2 flips key points as centers of pixels, and turns and resizes them as corners.
# Believed: a tv_tensors.KeyPoints stays where it is in the image, so that turning by 180 degrees is flipping twice, for both. Seen: of the pixel
# (3, 4) of 10 x 10 both flips give (6, 5), as they give of the pixel; rotate(180) gives (7, 6), outside of its pixel, and sends (0, 0)
# to (10, 10), outside of the image. rotate(90, expand=True) is off by (0, 1), and resizing by 3 by (-1, -1): resize then flip
# differs from flip then resize by 2 pixels. Boxes are right everywhere. Add .5 before turning and resizing, and take it off afterwards.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchvision==0.29.1 torch==2.14.1 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import torch
import torchvision
from torchvision import tv_tensors
from torchvision.transforms.v2 import functional as F

print("torchvision", torchvision.__version__)
image = torch.zeros(1, 10, 10)
image[0, 4, 3] = 1
canvas = {"canvas_size": (10, 10)}
targets = {
    "pixel": tv_tensors.Image(image),
    "key point": tv_tensors.KeyPoints(torch.tensor([[3.0, 4.0]]), **canvas),
    "box": tv_tensors.BoundingBoxes(torch.tensor([[3.0, 4.0, 4.0, 5.0]]), format="XYXY", **canvas),
}


def place(target):
    if isinstance(target, tv_tensors.Image):
        return target[0].double().argwhere().double().mean(0).flip(0).tolist()  # (x, y) of what is not black
    if isinstance(target, tv_tensors.BoundingBoxes):
        return ((target[0, :2] + target[0, 2:]) / 2 - 0.5).tolist()  # the center of a pixel is half a pixel from its edge
    return target[0].tolist()


steps = {
    "both flips": lambda target: F.vertical_flip(F.horizontal_flip(target)),
    "rotate(180)": lambda target: F.rotate(target, 180),
    "rotate(90, expand)": lambda target: F.rotate(target, 90, expand=True),
    "resize by 3": lambda target: F.resize(target, [30, 30], interpolation=F.InterpolationMode.NEAREST),
    "flip, resize": lambda target: F.resize(F.horizontal_flip(target), [30, 30], interpolation=F.InterpolationMode.NEAREST),
    "resize, flip": lambda target: F.horizontal_flip(F.resize(target, [30, 30], interpolation=F.InterpolationMode.NEAREST)),
}
off = {
    "both flips": (0, 0),
    "rotate(180)": (1, 1),
    "rotate(90, expand)": (0, 1),
    "resize by 3": (-1, -1),
    "flip, resize": (-1, -1),
    "resize, flip": (1, -1),
}
for name, step in steps.items():
    seen = {kind: place(step(target)) for kind, target in targets.items()}
    print(f"{name:18}", {kind: [round(value, 3) for value in at] for kind, at in seen.items()})
    pixel, point, box = (torch.tensor(seen[kind], dtype=torch.float64) for kind in targets)
    assert torch.allclose(box, pixel, atol=1e-3) and torch.allclose(point - pixel, torch.tensor(off[name], dtype=torch.float64), atol=1e-3)
corner = F.rotate(tv_tensors.KeyPoints(torch.zeros(1, 2), **canvas), 180)[0].tolist()
print("the upper left pixel, turned by 180 degrees:", corner, "of an image of 10 x 10")
assert corner == [10, 10]
PROGRAM
