#!/usr/bin/env bash
# OpenImageIO 3.2.2.0: a PFM file comes back upside down, also one that it has written itself, unless it is opened with a configuration, be it empty.
# Believed: rows of PFM run from the bottom to the top, and readers turn them round, as pnm:pfmflip, on by default, says. Seen: the files
# that it writes are right for OpenCV and Pillow, but ImageBuf(path) and ImageInput.open(path) have the last row of any PFM file first, whoever wrote
# it, where ImageBuf(path, 0, 0, ImageSpec()) and ImageInput.open(path, ImageSpec()), which say nothing more, and oiiotool have it last. OpenEXR and
# TIFF are right. A map of depth or flow with its horizon in the middle does not look wrong at first sight.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet openimageio==3.2.2.0 opencv-python-headless==5.0.0.93 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import subprocess
import sys

import cv2
import numpy as np
import OpenImageIO as oiio
from PIL import Image

print("OpenImageIO", oiio.VERSION_STRING)
image = np.exp2(np.arange(5, dtype=np.float32))[:, None, None] * np.ones((1, 7, 1), np.float32)  # 1, 2, 4, 8, 16 from the top
region = oiio.ROI(0, 7, 0, 5, 0, 1, 0, 1)
by_oiio, by_opencv = sys.argv[1] + "/by_oiio.", sys.argv[1] + "/by_opencv.pfm"
for kind in ("pfm", "exr", "tif"):
    buffer = oiio.ImageBuf(oiio.ImageSpec(7, 5, 1, oiio.FLOAT))
    buffer.set_pixels(region, image)
    assert buffer.write(by_oiio + kind)
cv2.imwrite(by_opencv, image)
converted = sys.argv[1] + "/converted.tif"
subprocess.run([sys.argv[1] + "/venv/bin/oiiotool", by_opencv, "-o", converted], check=True)
rows = {
    "its PFM by OpenCV": cv2.imread(by_oiio + "pfm", cv2.IMREAD_UNCHANGED)[:, 0],
    "its PFM by Pillow": np.array(Image.open(by_oiio + "pfm"))[:, 0],
    "its PFM by ImageBuf(path)": oiio.ImageBuf(by_oiio + "pfm").get_pixels(oiio.FLOAT)[:, 0, 0],
    "its PFM by ImageBuf(path, 0, 0, ImageSpec())": oiio.ImageBuf(by_oiio + "pfm", 0, 0, oiio.ImageSpec()).get_pixels(oiio.FLOAT)[:, 0, 0],
    "its PFM by ImageInput.open(path)": oiio.ImageInput.open(by_oiio + "pfm").read_image(oiio.FLOAT)[:, 0, 0],
    "its PFM by ImageInput.open(path, ImageSpec())": oiio.ImageInput.open(by_oiio + "pfm", oiio.ImageSpec()).read_image(oiio.FLOAT)[
        :, 0, 0
    ],
    "OpenCV's PFM by ImageBuf(path)": oiio.ImageBuf(by_opencv).get_pixels(oiio.FLOAT)[:, 0, 0],
    "OpenCV's PFM by oiiotool": cv2.imread(converted, cv2.IMREAD_UNCHANGED)[:, 0],
    "its OpenEXR by ImageBuf(path)": oiio.ImageBuf(by_oiio + "exr").get_pixels(oiio.FLOAT)[:, 0, 0],
    "its TIFF by ImageBuf(path)": oiio.ImageBuf(by_oiio + "tif").get_pixels(oiio.FLOAT)[:, 0, 0],
}
for name, seen in rows.items():
    print(f"{name:46}", seen.tolist())
    turned = "PFM by ImageBuf(path)" in name or "open(path)" in name
    assert seen.tolist() == ([16, 8, 4, 2, 1] if turned else [1, 2, 4, 8, 16])
PROGRAM
