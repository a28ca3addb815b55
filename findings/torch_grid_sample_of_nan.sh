#!/usr/bin/env bash
# torch 2.13.0 (CPU): what grid_sample makes of a NaN coordinate depends on mode and padding.
# Believed: its documentation says that NaN in grid is read as -1, the first column or row. Seen: true for "bilinear" and "nearest" with
# padding "border" and "reflection" alone: a point without a position, say one behind a camera, shows pixels of the image's edge as if it
# were valid, and a mask made by sampling ones says 1. With padding "zeros", the default, "bilinear" gives NaN and "nearest" 0; "bicubic" gives
# NaN with every padding. Test the grid for NaN before sampling; the result does not tell.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy==2.2.6
"$folder/venv/bin/python" - <<'PROGRAM'
import math

import torch
from torch.nn.functional import grid_sample

print("torch", torch.__version__)
image = torch.arange(1.0, 17).reshape(1, 1, 4, 4)
grids = {x: torch.tensor([[[[x, 0.0]]]]) for x in (math.nan, -1.0)}
seen = {}
for padding in ("zeros", "border", "reflection"):
    for mode in ("bilinear", "nearest", "bicubic"):
        of_nan, of_edge = (grid_sample(image, grid, mode, padding, align_corners=False).item() for grid in grids.values())
        seen[padding, mode] = of_nan
        print(f"{padding:10} {mode:8} x = NaN: {of_nan:6.3f}, x = -1: {of_edge:6.3f}")
        as_documented = of_nan == of_edge
        assert as_documented == (padding != "zeros" and mode != "bicubic"), (padding, mode)
assert all(math.isnan(seen[padding, "bicubic"]) for padding in ("zeros", "border", "reflection"))
assert math.isnan(seen["zeros", "bilinear"]) and seen["zeros", "nearest"] == 0
PROGRAM
