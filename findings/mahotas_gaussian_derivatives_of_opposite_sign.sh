#!/usr/bin/env bash
# mahotas 1.4.19: gaussian_filter with an odd order gives the derivative with the opposite sign, that of an image that gets darker.
# Believed: order=(0, 1) is the derivative along x of the blurred image, as with scipy.ndimage.gaussian_filter, of which name and
# arguments are the same. Seen of a ramp that gets brighter to the right: -1.00 where SciPy has +1.00, in gaussian_filter1d, too, and of the third order
# -6 for the +6 of x^3; orders 0 and 2 agree. Directions of gradients are turned by 180 degrees, and edges are left on the wrong side.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mahotas==1.4.19 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import mahotas
import numpy as np
from scipy import ndimage

print("mahotas", mahotas.__version__)
x = np.arange(-30.0, 31)
for order, factorial in ((0, 1), (1, 1), (2, 2), (3, 6)):
    image = np.tile(x**order, (61, 1))
    ours = mahotas.gaussian_filter(image, 2, order=(0, order))[30, 30]
    one = mahotas.gaussian_filter1d(image, 2, axis=1, order=order)[30, 30]
    theirs = ndimage.gaussian_filter(image, 2, order=(0, order))[30, 30]
    print(f"order {order} of x^{order}: mahotas {ours:.3f}, in one dimension {one:.3f}, SciPy {theirs:.3f}, truth {factorial}")
    sign = -1 if order % 2 else 1
    assert abs(theirs - factorial) < 0.05 * factorial
    assert abs(ours - sign * theirs) < 0.02 * factorial and abs(one - sign * theirs) < 0.02 * factorial
rows = np.tile(x[:, None], (1, 61))
print(f"order (1, 0) of y: {mahotas.gaussian_filter(rows, 2, order=(1, 0))[30, 30]:.3f}")
assert mahotas.gaussian_filter(rows, 2, order=(1, 0))[30, 30] < -0.99
PROGRAM
