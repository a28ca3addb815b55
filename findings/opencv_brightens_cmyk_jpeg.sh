#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.imdecode of a CMYK JPEG file makes every gray one level brighter, and black 1.
# Believed: C = M = Y = 255 - v without black ink is the gray v, as Pillow and torchvision have it; decoders differ in the rounding of a few
# pixels. Seen: OpenCV gives v + 1 for every v below 255, as x * 255 >> 8 in place of x would, so that no pixel of such a file
# is black, and a photograph differs by one level in 99% of its values from what other decoders give.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import io

import cv2
import numpy as np
from PIL import Image

print("OpenCV", cv2.__version__)
for gray in (0, 1, 64, 128, 254, 255):
    ink = Image.new("L", (16, 16), 255 - gray)
    file = io.BytesIO()
    Image.merge("CMYK", [ink, ink, ink, Image.new("L", (16, 16), 0)]).save(file, "JPEG", quality=100)
    opencv = cv2.imdecode(np.frombuffer(file.getvalue(), np.uint8), cv2.IMREAD_COLOR)
    pillow = np.asarray(Image.open(file).convert("RGB"))
    print(f"gray {gray}: OpenCV {np.unique(opencv)}, Pillow {np.unique(pillow)}")
    assert (pillow == gray).all() and (opencv == min(gray + 1, 255)).all()
PROGRAM
