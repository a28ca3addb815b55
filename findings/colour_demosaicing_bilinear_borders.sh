#!/usr/bin/env bash
# colour-demosaicing 0.2.7: bilinear demosaicing of a flat gray image has a colored frame, red 1.125 of .5 in the first pixel.
# Believed: a mean of the neighbors of one color, so that flat stays flat up to the border, as it does by the other two methods of the package and by
# cv2.cvtColor. Seen: at the border the raw image is repeated before it is filtered, which puts each sample beside a copy of its own color: of flat
# .5 by RGGB the first row and column have .75 of red and .25 of blue, the last ones the opposite, green alternates between .375 and .625, and two
# corners are (1.125, .25, .125) and (.125, .25, 1.125). Inside it is exact. Padded by two pixels with mode="reflect" first and cropped it is flat.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet colour-demosaicing==0.2.7 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
from importlib.metadata import version

import colour_demosaicing as demosaicing
import cv2
import numpy as np

print("colour-demosaicing", version("colour-demosaicing"), "OpenCV", cv2.__version__)
flat = np.full((8, 10), 0.5)
for pattern in ("RGGB", "BGGR", "GRBG", "GBRG"):
    seen = demosaicing.demosaicing_CFA_Bayer_bilinear(flat, pattern)
    others = {
        "Malvar2004": demosaicing.demosaicing_CFA_Bayer_Malvar2004(flat, pattern),
        "Menon2007": demosaicing.demosaicing_CFA_Bayer_Menon2007(flat, pattern),
        "OpenCV": cv2.cvtColor(np.round(flat * 65535).astype(np.uint16), getattr(cv2, f"COLOR_Bayer{pattern}2RGB")) / 65535,
        "padded first": demosaicing.demosaicing_CFA_Bayer_bilinear(np.pad(flat, 2, mode="reflect"), pattern)[2:-2, 2:-2],
    }
    print(
        f"{pattern}: corners {seen[0, 0].tolist()} and {seen[-1, -1].tolist()}, first row {seen[0, 4].tolist()}, last row {seen[-1, 4].tolist()}"
    )
    print(
        "   off .5 by",
        {name: float(abs(image - 0.5).max().round(5)) for name, image in others.items()},
        "inside",
        abs(seen[1:-1, 1:-1] - 0.5).max(),
    )
    assert all(abs(image - 0.5).max() < 1e-4 for image in others.values()) and np.allclose(seen[1:-1, 1:-1], 0.5)
    assert seen.max() > 0.7 and seen.min() < 0.3
assert np.allclose(demosaicing.demosaicing_CFA_Bayer_bilinear(flat, "RGGB")[[0, -1], [0, -1]], [[1.125, 0.25, 0.125], [0.125, 0.25, 1.125]])
PROGRAM
