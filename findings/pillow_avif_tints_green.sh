#!/usr/bin/env bash
# Pillow 13.0.0 (libavif 1.4.2): each saving as AVIF makes an image greener, ten of them by -6, +5 and -8 levels, at quality 100.
# Believed: at quality 100 what is lost is noise around the image, as with JPEG, and chroma is rounded to the nearest level. Seen of a smooth image: chroma is
# cut off, half a level too low in both planes, so that red, green and blue are -.6, +.5 and -.8 levels off on average, with chroma in full and in
# half resolution and at the default quality. Each generation adds as much where chroma has half the resolution, a third of it on average where it is
# full. JPEG stays within .02 over ten generations, gray images are exact, and imagecodecs 2026.3.6 and OpenCV 5.0.0 at quality 100 lose nothing.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pillow==13.0.0 imagecodecs==2026.3.6 opencv-python-headless==5.0.0.93 av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import io

import av
import cv2
import imagecodecs
import numpy as np
import PIL
from PIL import Image, features

print("Pillow", PIL.__version__, "libavif", features.version("avif"))
smooth = cv2.GaussianBlur(np.random.default_rng(0).random((128, 160, 3)), (0, 0), 3)
image = np.round(cv2.normalize(smooth, None, 20, 235, cv2.NORM_MINMAX)).astype(np.uint8)


def by_pillow(kind, **options):
    def step(pixels):
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, kind, **options)
        return np.array(Image.open(file))

    return step


def after(step, times, start=image):
    pixels = start
    for _ in range(times):
        pixels = step(pixels)
    return (pixels.astype(float) - start).mean((0, 1))


best = [cv2.IMWRITE_AVIF_QUALITY, 100]
ways = {
    "Pillow, quality 100": by_pillow("AVIF", quality=100),
    "Pillow, quality 100, full chroma": by_pillow("AVIF", quality=100, subsampling="4:4:4"),
    "Pillow's default": by_pillow("AVIF"),
    "Pillow, JPEG of quality 100": by_pillow("JPEG", quality=100, subsampling=0),
    "imagecodecs": lambda pixels: imagecodecs.avif_decode(imagecodecs.avif_encode(pixels, level=100)),
    "OpenCV": lambda pixels: cv2.imdecode(cv2.imencode(".avif", pixels, best)[1], cv2.IMREAD_COLOR),
}
seen = {name: (after(step, 1), after(step, 10)) for name, step in ways.items()}
for name, (once, ten) in seen.items():
    print(f"{name}: red, green, blue are {once.round(2).tolist()} off, after ten generations {ten.round(2).tolist()}")
    if name.startswith("Pillow") and "JPEG" not in name:
        assert -0.8 < once[0] < -0.4 < 0.4 < once[1] < 0.6 and -0.95 < once[2] < -0.5
    else:
        assert abs(ten).max() < 0.02
        assert "JPEG" in name or np.array_equal(ways[name](image), image)
assert abs(seen["Pillow, quality 100"][1] - [-6.4, 4.75, -7.6]).max() < 0.5
assert abs(after(ways["Pillow, quality 100"], 10, np.repeat(image[..., :1], 3, 2))).max() == 0  # gray

file = io.BytesIO()
Image.fromarray(image).save(file, "AVIF", quality=100, subsampling="4:4:4")
with av.open(io.BytesIO(file.getvalue())) as container:
    planes = next(container.decode(video=0)).to_ndarray().astype(float)  # yuv444p, full range, BT.601
red, green, blue = np.moveaxis(image.astype(float), 2, 0)
luma = 0.299 * red + 0.587 * green + 0.114 * blue
off = [(planes[0] - luma).mean(), (planes[1] - (blue - luma) / 1.772 - 128).mean(), (planes[2] - (red - luma) / 1.402 - 128).mean()]
print("planes of the file are off by", np.round(off, 2).tolist())
assert abs(off[0]) < 0.05 and -0.55 < off[1] < -0.45 and -0.55 < off[2] < -0.45
PROGRAM
