#!/usr/bin/env bash
# torchvision 0.29.1: sanitize_bounding_boxes (SanitizeBoundingBoxes) measures the height of rotated boxes from wrong coordinates.
# Believed: boxes whose width or height is below min_size are removed, whatever their format, and others stay.
# Seen: of the corners (x1, y1, ..., x4, y4) the second side is taken from y2 - y3 and x3 - x4, which is not its length: a box of
# 40 x 0.5 pixels passes min_size=5, and one of 40 x 20 pixels, turned by 90 degrees, fails min_size=19.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchvision==0.29.1 torch==2.14.1 numpy pillow
"$folder/venv/bin/python" - <<'PROGRAM'
import torch
from torchvision import tv_tensors
from torchvision.transforms.v2 import functional as F


def stays(box: list[float], format: str, min_size: float) -> bool:
    boxes = tv_tensors.BoundingBoxes(torch.tensor([box]), format=format, canvas_size=(100, 100))
    return bool(F.sanitize_bounding_boxes(boxes, min_size=min_size)[1])


flat = stays([30.0, 49.75, 70, 50.25], "XYXY", 5)
turned = {r: stays([50.0, 50, 40, 0.5, r], "CXCYWHR", 5) for r in (0, 30, 45)}
print(f"40 x 0.5 with min_size=5: upright stays {flat}, rotated by degrees {turned}")
assert not flat and all(turned.values())
thick = {r: stays([50.0, 50, 40, 20, r], "CXCYWHR", 19) for r in (0, 90)}
print(f"40 x 20 with min_size=19: rotated by degrees {thick}")
assert thick == {0: True, 90: False}
PROGRAM
