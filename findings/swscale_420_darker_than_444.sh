#!/usr/bin/env bash
# av 18.1.0 (FFmpeg's swscale 9.5.102, x86-64): frames of yuv420p become 1 to 1.5 levels darker in RGB than those of yuv444p.
# Believed: to_ndarray(format="rgb24") gives each pixel's color, rounded, whatever the resolution of chroma, which is constant in blocks of two by two here. Seen:
# from yuv444p it is within half a level, from yuv420p and yuv422p of limited range red, green and blue are -1.0, -1.45 and -1.0 levels off on average,
# up to 2.9, and of full range -.5, -1 and -.5: the picture gets darker and a little purple. Grays lose half a level. All interpolations are alike, and so
# is cv2.VideoCapture of OpenCV 5.0.0, which uses the same code: a mean color learned from files of images does not fit those of videos.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet av==18.1.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import sys

import av
import cv2
import numpy as np

print("av", av.__version__, "swscale", av.library_versions["libswscale"], "OpenCV", cv2.__version__)
random = np.random.default_rng(0)
KR, KB = 0.2126, 0.0722  # BT.709
blocks = random.uniform(0.15, 0.85, (64, 96, 3))
luma = blocks @ [KR, 1 - KR - KB, KB]
components = luma, (blocks[..., 2] - luma) / (2 - 2 * KB), (blocks[..., 0] - luma) / (2 - 2 * KR)


def codes(limited):
    scales = (219, 224, 224) if limited else (255, 255, 255)
    floors = (16 if limited else 0, 128, 128)
    return [np.round(part * scale + floor).astype(np.uint8) for part, scale, floor in zip(components, scales, floors)]


def whole(part, down=2, right=2):
    return part.repeat(down, 0).repeat(right, 1)


def exact(limited):
    y, u, v = (whole(part).astype(float) for part in codes(limited))
    y, u, v = ((y - 16) / 219, (u - 128) / 224, (v - 128) / 224) if limited else (y / 255, (u - 128) / 255, (v - 128) / 255)
    red, blue = y + (2 - 2 * KR) * v, y + (2 - 2 * KB) * u
    return np.stack([red, (y - KR * red - KB * blue) / (1 - KR - KB), blue], -1) * 255


def frame(kind, limited):
    y, u, v = codes(limited)
    reach = {"yuv444p": (2, 2), "yuv422p": (2, 1), "yuv420p": (1, 1)}[kind]
    result = av.VideoFrame(192, 128, kind)
    for plane, part in zip(result.planes, (whole(y), whole(u, *reach), whole(v, *reach))):
        rows = np.zeros((plane.height, plane.line_size), np.uint8)
        rows[:, : plane.width] = part
        plane.update(rows.tobytes())
    result.colorspace, result.color_range = 1, 1 if limited else 2
    return result


for limited in (True, False):
    truth = exact(limited)
    for kind in ("yuv444p", "yuv422p", "yuv420p"):
        for interpolation in ("BILINEAR", "BICUBIC", "POINT", "LANCZOS"):
            off = frame(kind, limited).reformat(format="rgb24", interpolation=interpolation).to_ndarray() - truth
            mean = off.mean((0, 1))
            if interpolation == "BICUBIC":
                default = frame(kind, limited).to_ndarray(format="rgb24") - truth
                assert np.array_equal(default, off)
                print(
                    f"{kind}, {'limited' if limited else 'full'} range: {mean.round(2).tolist()} levels off, at most {abs(off).max():.1f}"
                )
            if kind == "yuv444p":
                assert abs(off).max() < 0.6 and abs(mean).max() < 0.05
            else:
                assert abs(mean - ([-1, -1.45, -1] if limited else [-0.5, -1, -0.5])).max() < 0.1

path = sys.argv[1] + "/video.mkv"
with av.open(path, "w") as container:
    stream = container.add_stream("ffv1", rate=10)
    stream.width, stream.height, stream.pix_fmt = 192, 128, "yuv420p"
    stream.codec_context.colorspace, stream.codec_context.color_range = 1, 1
    container.mux(stream.encode(frame("yuv420p", True)))
    container.mux(stream.encode())
mean = (cv2.VideoCapture(path).read()[1][..., ::-1] - exact(True)).mean((0, 1))
print("the same frame from a lossless file by cv2.VideoCapture:", mean.round(2).tolist())
assert abs(mean - [-1, -1.45, -1]).max() < 0.1
gray = np.arange(16, 236, dtype=np.uint8)
flat = av.VideoFrame(220 * 2, 16, "yuv420p")
for plane, part in zip(flat.planes, (np.tile(gray.repeat(2), (16, 1)), np.full((8, 220), 128), np.full((8, 220), 128))):
    rows = np.zeros((plane.height, plane.line_size), np.uint8)
    rows[:, : plane.width] = part
    plane.update(rows.tobytes())
off = flat.to_ndarray(format="rgb24")[5, ::2] - (gray[:, None] - 16.0) * 255 / 219
print("all grays of yuv420p, limited range:", off.mean(0).round(2).tolist())
assert abs(off.mean(0) + 0.5).max() < 0.05
PROGRAM
