#!/usr/bin/env bash
# mahotas 1.4.19: interpolate.zoom, interpolate.shift and resize.resize_to interpolate at no order, and lose a row and a column.
# Believed: splines of the order asked for, 3 by default, as scipy.ndimage has them under the same names and arguments.
# Seen: the coordinate is rounded up whatever the order. Shifts of .25 and .75 change nothing, one of 1.75 is one of 1,
# resizing a ramp repeats pixels, and resizing an image of ones ends with a row and a column of zeros: what lies behind
# the last pixel is taken for outside. Shifts by whole pixels, and filters and labels elsewhere in the package, agree with SciPy.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mahotas==1.4.19 numpy==2.2.6 scipy==1.17.1
"$folder/venv/bin/python" - <<'PROGRAM'
import mahotas
import numpy as np
from mahotas.interpolate import shift, zoom
from mahotas.resize import resize_to
from scipy import ndimage

np.set_printoptions(precision=2, suppress=True, linewidth=120)
print("mahotas", mahotas.__version__)
ramp = np.tile(np.arange(8.0), (5, 1))
for order in (1, 3):
    moved = [shift(ramp, (0, by), order=order)[2] for by in (0.25, 0.75, 1.75)]
    print(f"order {order}: moved by .75", moved[1], "SciPy", ndimage.shift(ramp, (0, 0.75), order=order)[2])
    assert np.allclose(moved[:2], ramp[2]) and np.allclose(moved[2][1:], ramp[2, :-1])
    doubled = zoom(ramp, (1.0, 2.0), order=order)[2]
    print(f"order {order}: doubled", doubled, "SciPy", ndimage.zoom(ramp, (1, 2), order=order)[2])
    assert np.allclose(doubled, [1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 0])

for size in ((4, 4), (16, 16)):
    ones = resize_to(np.ones((8, 8)), size)
    print("ones of 8 x 8 resized to", size, "sum", ones.sum(), "SciPy", ndimage.zoom(np.ones((8, 8)), size[0] / 8).sum())
    assert np.allclose(ones[-1], 0) and np.allclose(ones[:, -1], 0) and np.allclose(ones[:-1, :-1], 1)
PROGRAM
