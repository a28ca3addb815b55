#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93, OpenImageIO 3.2.2.0 and Pillow 13.0.0: one divides a PFM file by its scale, one multiplies, one ignores it.
# Believed: the third line of the header says the byte order by its sign, and any reader gives the floats that follow. Seen: a file of -0.003922,
# the scale in the headers of well-known stereo sets, whose floats are disparities in pixels, is right in Pillow alone: 100 becomes 25497 from OpenCV and
# .3922 from OpenImageIO, a factor of 65000 between them. With a scale of 1 or -1 all three agree, and these are what each of them writes. In front
# of real files take Pillow, or np.fromfile behind the three lines, upside down.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet openimageio==3.2.2.0 opencv-python-headless==5.0.0.93 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import sys

import cv2
import numpy as np
import OpenImageIO as oiio
import PIL
from PIL import Image

print("OpenCV", cv2.__version__, "OpenImageIO", oiio.VERSION_STRING, "Pillow", PIL.__version__)
path = sys.argv[1] + "/disparity.pfm"
disparity = np.full((5, 7), 100, np.float32)
for scale in ("-1", "1", "-2", "-0.003922"):
    with open(path, "wb") as file:
        file.write(f"Pf\n7 5\n{scale}\n".encode())
        file.write(disparity.astype("<f4" if scale.startswith("-") else ">f4").tobytes())
    seen = {
        "OpenCV": cv2.imread(path, cv2.IMREAD_UNCHANGED),
        "OpenImageIO": oiio.ImageBuf(path).get_pixels(oiio.FLOAT)[..., 0],
        "Pillow": np.array(Image.open(path)),
    }
    factor = abs(float(scale))
    print(f"scale {scale}: 100 is", {name: float(f"{image.mean():.5g}") for name, image in seen.items()})
    for name, expected in (("OpenCV", 100 / factor), ("OpenImageIO", 100 * factor), ("Pillow", 100)):
        assert seen[name].shape == (5, 7) and np.allclose(seen[name], expected, rtol=1e-5)
PROGRAM
