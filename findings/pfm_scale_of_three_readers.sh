#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93, OpenImageIO 3.2.2.0 and Pillow 13.0.0: one divides a PFM file by its scale, one multiplies, one ignores it.
# Believed: the third line of the header says the byte order by its sign, and any reader gives the floats that follow. Seen: where it is -0.003922, which
# is 1/255, a float of 100 comes as 25497 from OpenCV, as .3922 from OpenImageIO and as 100 from Pillow, a factor of 65000 between the first two. With
# a scale of 1 or -1 all three agree, and these are what each of them writes. Whether a disparity was meant to be scaled the file does not tell:
# compare it with np.fromfile behind the three lines.
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
