#!/usr/bin/env bash
# imagecorruptions 1.1.2: zoom_blur, of ImageNet-C, does not zoom about the center of the image.
# Believed: the corruption is the mean of enlargements about the center, as of a lens that zooms during the exposure.
# Seen: the window that is enlarged has whole pixels, and what is larger than the image afterwards is cut off at the right and at the
# bottom alone, so that enlargements lie up to a pixel to the right and down: a spot in the center moves by .25 to .6 pixels both ways.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet imagecorruptions==1.1.2 setuptools
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import numpy as np
from imagecorruptions import corrupt

for size in (64, 224, 225, 300):
    y, x = np.mgrid[:size, :size]
    center = (size - 1) / 2
    spot = np.exp(-((x - center) ** 2 + (y - center) ** 2) / (2 * (size / 12) ** 2))
    image = np.repeat((255 * spot)[..., None], 3, 2).astype(np.uint8)
    moved = []
    for severity in (1, 3, 5):
        blurred = corrupt(image, corruption_name="zoom_blur", severity=severity)[..., 0].astype(float)
        moved.append(tuple(round(float((blurred * at).sum() / blurred.sum() - center), 2) for at in (x, y)))
    print(f"{size} x {size}: the centroid of a spot moves by {moved} pixels in severities 1, 3 and 5")
    assert all(0.2 < shift < 0.7 for pair in moved for shift in pair)
PROGRAM
