#!/usr/bin/env bash
# elasticdeform 0.5.1: deform_grid of bytes at its defaults is up to 200 levels off, also where nothing is deformed, and of uint16 40000.
# Believed: what is deformed keeps its type, and has the values of the same image in floats, rounded and cut at the limits of the type, as in
# scipy.ndimage, whose names and defaults it has, order=3 and prefilter=True. Seen of a white disk on black, moved by half a pixel: a fifth of the
# pixels are more than a level from those of scipy.ndimage.shift, by up to 207, and with a displacement of 0 it is as bad; a disk of 255 in uint16
# has pixels of 40000. Of noise in bytes 98% are wrong, by up to 220. Spline coefficients, which go beyond the image's range to both sides, are kept
# in its type, where they wrap. order=1 is exact, and so are floats. Deform a float copy, then clip and round.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet elasticdeform==0.5.1 scipy==1.17.1 numpy==1.26.4
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import elasticdeform
import numpy as np
from scipy import ndimage

print("elasticdeform", version("elasticdeform"))
y, x = np.mgrid[:96, :120]
disk = np.hypot(x - 60, y - 48) < 25
noise = np.random.default_rng(0).integers(0, 256, (96, 120)).astype(float)
move = np.full((2, 3, 3), 0.5)
inside = (slice(8, -8), slice(8, -8))
for name, image in (("disk", disk * 255.0), ("noise", noise)):
    for kind in (np.uint8, np.uint16):
        for order in (1, 2, 3):
            given = image.astype(kind)
            seen = elasticdeform.deform_grid(given, move, **({} if order == 3 else {"order": order})).astype(float)
            floats = elasticdeform.deform_grid(given.astype(float), move, order=order)
            scipy = ndimage.shift(given, (-0.5, -0.5), order=order, mode="constant")
            off = np.abs(seen - scipy)[inside]
            print(
                f"{name}, {kind.__name__}, order {order}: up to {off.max():.0f} off SciPy, {np.mean(off > 1):.1%} of the pixels;", end=" "
            )
            limits = np.clip(floats, 0, np.iinfo(kind).max)[inside]
            print(f"as floats {np.abs(limits - scipy[inside]).max():.2f}")
            assert seen.dtype == float and np.abs(limits - scipy[inside]).max() < 0.51
            if order == 1:
                assert off.max() <= 1
            elif name == "disk":
                assert off.max() > (200 if kind == np.uint8 else 30000) and np.mean(off > 1) > 0.1
            else:
                assert off.max() > 150 and np.mean(off > 1) > 0.05
still = elasticdeform.deform_grid((disk * 255).astype(np.uint8), np.zeros((2, 3, 3))).astype(int)
print("disk, deformed by nothing: up to", np.abs(still - disk * 255).max(), "off")
assert np.abs(still - disk * 255).max() > 200
PROGRAM
