#!/usr/bin/env bash
# scikit-image 0.26.0: the gradient of a ramp of slope 1 is 1.41 by sobel, scharr and prewitt, .70 by farid and 1 by roberts.
# Believed: filters.sobel, scharr, prewitt, farid and roberts, side by side in one example, estimate the same gradient with more or less isotropy,
# so that a threshold found with one fits the others, as their weights are normalized. Seen of a ramp of one level a pixel:
# sobel_v, scharr_v and prewitt_v are 2, a difference over two pixels, and farid_v .99, a derivative; their magnitudes are divided by the
# square root of 2, that of roberts is not. Swapping farid for sobel halves every edge, and in a volume sobel is 1.15.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import skimage
from skimage import filters

print("scikit-image", skimage.__version__)
ramp = np.tile(np.arange(40.0), (40, 1))
diagonal = np.add.outer(np.arange(40.0), np.arange(40.0)) / np.sqrt(2)
for name, one_way, magnitude in (("sobel", 2, 2**0.5), ("scharr", 2, 2**0.5), ("prewitt", 2, 2**0.5), ("farid", 0.992, 0.701), ("roberts", None, 1)):
    found, turned = (getattr(filters, name)(image)[20, 20] for image in (ramp, diagonal))
    print(f"{name}: {found:.3f}, of a diagonal ramp {turned:.3f}", end="")
    assert abs(found - magnitude) < 1e-3 and abs(turned - magnitude) < 1e-3
    if one_way:
        derivative = getattr(filters, name + "_v")(ramp)[20, 20]
        print(f", {name}_v {derivative:.3f}", end="")
        assert abs(derivative - one_way) < 1e-3
    print()
volume = np.tile(np.arange(20.0), (20, 20, 1))
print(f"sobel of a volume: {filters.sobel(volume)[10, 10, 10]:.3f}")
assert abs(filters.sobel(volume)[10, 10, 10] - 2 / 3**0.5) < 1e-6
PROGRAM
