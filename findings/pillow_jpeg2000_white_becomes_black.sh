#!/usr/bin/env bash
# pillow 13.0.0: the brightest levels of JPEG 2000 color images of more than 8 bits become black.
# Believed: an RGB file of 10 to 16 bits opens as 8-bit RGB, rounded or cut off, as OpenCV 5.0.0 does it, with white as 255. Seen: half a level is
# added, the rest is cut off, and what reaches 256 wraps around: at 10 bits the codes 1022 and 1023 are 0, at 12 bits the 8 codes from 4088 on,
# at 16 bits the 128 from 65408 on. Saturated areas are black, opaque ones with alpha transparent, and a channel that saturates alone turns the
# color into its opposite: (4095, 3000, 3000) is (0, 188, 188). The lossless file is right, and gray ones, which open as I;16, shifted up to 16
# bits, do not wrap.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pillow==13.0.0 imagecodecs==2026.3.6 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import io

import cv2
import imagecodecs
import numpy as np
import PIL
from PIL import Image

print("Pillow", PIL.__version__)


def encoded(codes, bits):
    file = imagecodecs.jpeg2k_encode(codes, bitspersample=bits, codecformat="jp2", level=0)
    assert (imagecodecs.jpeg2k_decode(file) == codes).all()
    return file


for bits, count in ((10, 2), (12, 8), (14, 32), (16, 128)):
    white = 2**bits - 1
    codes = np.empty((16, 256, 3), np.uint16)
    codes[:] = np.arange(white - 255, white + 1)[:, None]
    file = encoded(codes, bits)
    by_opencv = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR)
    with Image.open(io.BytesIO(file)) as image:
        mode, by_pillow = image.mode, np.asarray(image)
    black = codes[0, by_pillow[0, :, 0] == 0, 0]
    print(f"{bits} bits, codes {codes.min()} to {white}: OpenCV {by_opencv.min()} to {by_opencv.max()}")
    print(f"    Pillow, {mode}: {by_pillow.min()} to {by_pillow.max()}")
    print(f"    {len(black)} codes, {black.min()} to {black.max()}, are 0; white is {by_pillow[0, -1].tolist()}")
    assert mode == "RGB" and len(black) == count and black.max() == white and (by_pillow[:, -1] == 0).all() and (by_opencv[:, -1] == 255).all()
    with Image.open(io.BytesIO(encoded(np.concatenate([codes, codes[..., :1]], -1), bits))) as image:
        assert image.mode == "RGBA" and image.getpixel((255, 0)) == (0, 0, 0, 0)
    with Image.open(io.BytesIO(encoded(codes[..., 0].copy(), bits))) as image:
        print(f"    gray: {image.mode}, {image.getextrema()}")
        assert image.mode == "I;16" and image.getextrema()[1] == white << (16 - bits)
pink = np.full((16, 16, 3), (4095, 3000, 3000), np.uint16)
with Image.open(io.BytesIO(encoded(pink, 12))) as image:
    print("(4095, 3000, 3000) of 12 bits:", image.getpixel((0, 0)))
    assert image.getpixel((0, 0)) == (0, 188, 188)
PROGRAM
