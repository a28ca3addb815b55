#!/usr/bin/env bash
# av 18.1.0 (FFmpeg's libavfilter 11.14.102): the filter lenscorrection with i=bilinear moves the picture half a pixel to the left and up.
# Believed: with k1=0 and k2=0 there is nothing to correct and the picture stays, and bilinear reads at the same places as nearest, the default, only
# smoother. Seen: bilinear without distortion makes each pixel the mean of itself and the ones to its right and below, in gray, in 16 bits and in
# color: a spot moves by (-.5, -.5), and stays with nearest. With k1=-.1 it moves by as much, and the correction of a turned picture, by
# 180 degrees, is not the turned correction, 18 levels off. Boxes
# found in such videos need .5 added.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from fractions import Fraction

import av
import numpy as np
from av.filter import Graph

print("av", av.__version__, "libavfilter", av.library_versions["libavfilter"])
height, width = 96, 120
y, x = np.mgrid[:height, :width]
spot = 200 * np.exp(-((x - 59.5) ** 2 + (y - 47.5) ** 2) / 200)
assert np.allclose(spot, spot[::-1, ::-1])
images = {
    "gray": np.round(spot).astype(np.uint8),
    "gray16le": np.round(spot * 256).astype(np.uint16),
    "gbrp": np.repeat(np.round(spot).astype(np.uint8)[..., None], 3, 2),
}


def corrected(image, kind, arguments):
    graph = Graph()
    source = graph.add_buffer(width=width, height=height, format=kind, time_base=Fraction(1, 10))
    step, sink = graph.add("lenscorrection", arguments), graph.add("buffersink")
    source.link_to(step)
    step.link_to(sink)
    graph.configure()
    frame = av.VideoFrame.from_ndarray(image, format=kind)
    frame.pts, frame.time_base = 0, Fraction(1, 10)
    graph.push(frame)
    result = graph.pull()
    assert result.format.name == kind
    return result.to_ndarray()


def moved(image):
    weight = image.reshape(height, width, -1)[..., 0].astype(float)
    return np.array([(weight * axis).sum() / weight.sum() for axis in (x - 59.5, y - 47.5)])


for kind, image in images.items():
    for way in ("nearest", "bilinear"):
        shift = moved(corrected(image, kind, f"k1=0:k2=0:i={way}"))
        print(f"{kind}, no distortion, {way}: moved by {shift.round(3).tolist()}")
        assert np.allclose(shift, -0.5 if way == "bilinear" else 0, atol=0.01)

noise = np.random.default_rng(0).integers(0, 256, (height, width), dtype=np.uint8)
seen, exact = corrected(noise, "gray", "k1=0:k2=0:i=bilinear"), noise.astype(float)
mean = (exact[:-1, :-1] + exact[1:, :-1] + exact[:-1, 1:] + exact[1:, 1:]) / 4
print("noise, no distortion: off the means of 2 x 2 by at most", abs(seen[:-1, :-1] - mean).max())
assert abs(seen[:-1, :-1] - mean).max() <= 0.5

image, arguments = images["gray"], "k1=-0.1:k2=0:i="
for way in ("nearest", "bilinear"):
    result, turned = (corrected(picture, "gray", arguments + way).astype(int) for picture in (image, image[::-1, ::-1].copy()))
    off = abs(result - turned[::-1, ::-1]).max()
    print(f"k1=-0.1, {way}: moved by {moved(result).round(2).tolist()}, turned picture {off} levels off")
    assert abs(moved(result) + (0.5 if way == "bilinear" else 0)).max() < 0.05 and (off > 15) == (way == "bilinear")
PROGRAM
