#!/usr/bin/env bash
# torch 2.13.0 (CPU): F.interpolate(antialias=True) gives results of one column the same value in every row. Seen with 2.14.1, too.
# Believed: a column of fifteen pixels shrunk to seven is seven averages, as one row of fifteen shrunk to seven is (the transpose).
# Seen: results (h, 1) of float32 and float64 repeat the first row's value, whatever the width of the image, when it is shrunk and
# when it is enlarged, unless the height stays; a profile of an image is a constant. bytes, three channels in channels_last and
# antialias=False are right. So is the gradient, which then is not that of the values.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from functools import partial

import torch
import torch.nn.functional as F

print("torch", torch.__version__)
shrink = partial(F.interpolate, mode="bilinear", antialias=True)
column = torch.arange(0.0, 150.0, 10.0)[None, None, :, None]  # 0, 10, ... 140 from top to bottom
row = shrink(column.mT, (1, 7)).mT
one = shrink(column, (7, 1))
print("as a row   ", [round(v, 1) for v in row.flatten().tolist()])
print("as a column", [round(v, 1) for v in one.flatten().tolist()])
assert row.diff(dim=2).min() > 10 and (one == one[:, :, :1]).all() and one[0, 0, 0] == row[0, 0, 0]

image = torch.rand(2, 3, 40, 30, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
image += torch.arange(40.0)[:, None]
for size in ((20, 1), (80, 1), (20, 2), (40, 1)):
    result = shrink(image, size)
    spread = (result.amax(2) - result.amin(2)).max().item()
    print(f"40 x 30 to {size}: lowest to highest row {spread:.2f}")
    assert (spread == 0) == (size in ((20, 1), (80, 1)))
last = shrink(image.contiguous(memory_format=torch.channels_last), (20, 1))
levels = shrink((5 * image).to(torch.uint8), (20, 1))
assert last.diff(dim=2).min() > 1 and (levels.int().diff(dim=2) > 0).all()

leaf = column.clone().requires_grad_()
shrink(leaf, (7, 1))[0, 0, 6, 0].backward()
print("gradient of the last row's value by the pixels:", [round(v, 2) for v in leaf.grad.flatten().tolist()])
assert leaf.grad[0, 0, -1, 0] > 0.3 and leaf.grad[0, 0, 0, 0] == 0  # though the value is that of the first pixels
PROGRAM
