#!/usr/bin/env bash
# av 18.1.0 (FFmpeg's libavfilter 11.14.102): the filter v360 enlarges the picture by a pixel, also where it converts a format to itself.
# Believed: input and output of one format, size and field of view, without a turn, are the same picture, and where it is a panorama, 360 degrees wide, a turn
# by 180 degrees moves every column by half of the width. Seen with interp=linear of flat, fisheye, cylindrical and equirectangular pictures:
# a spot at a quarter of the width is .25 pixels too far left, one at four fifths .3 too far right, whatever the size: positions are stretched by
# w / (w - 1) and h / (h - 1) around the center. Input counts pixels from center to center and output from edge to edge. A panorama that is turned
# by 180 degrees twice has its first column at half its brightness, and the rest nowhere.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from fractions import Fraction

import av
import av.filter
import numpy as np

print("av", av.__version__, "libavfilter", av.library_versions["libavfilter"])


def filtered(options, image):
    graph = av.filter.Graph()
    height, width = image.shape
    nodes = [graph.add_buffer(width=width, height=height, format="gray16le", time_base=Fraction(1, 25))]
    nodes += [graph.add("v360", options), graph.add("buffersink")]
    nodes[0].link_to(nodes[1])
    nodes[1].link_to(nodes[2])
    graph.configure()
    frame = av.VideoFrame.from_ndarray(image, format="gray16le")
    frame.pts, frame.time_base = 0, Fraction(1, 25)
    graph.push(frame)
    return graph.pull().to_ndarray()


fields = "ih_fov=90:iv_fov=70:h_fov=90:v_fov=70"
formats = {"flat": fields, "cylindrical": fields, "fisheye": "ih_fov=180:iv_fov=180:h_fov=180:v_fov=180", "e": "yaw=0"}
for height, width in ((96, 120), (480, 640)):
    y, x = np.mgrid[:height, :width]
    for place in ((0.25, 0.3), (0.8, 0.7)):
        at = np.array(place) * (width, height)
        spot = np.uint16(np.rint(60000 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 18)))
        stretch = (at - (np.array([width, height]) - 1) / 2) / (np.array([width, height]) - 1)
        for name, options in formats.items():
            result = filtered(f"{name}:{name}:{options}:interp=linear", spot).astype(float)
            moved = np.array([(result * x).sum(), (result * y).sum()]) / result.sum() - at
            print(f"{width} x {height}, {name}, at {at}: moved by {moved.round(3)}, a stretch of one pixel is {stretch.round(3)}")
            assert np.allclose(moved, stretch, atol=0.03)
panorama = np.full((100, 200), 10000, np.uint16)
panorama[:, 0] = 60000
once = filtered("e:e:yaw=180:interp=linear", panorama)
twice = filtered("e:e:yaw=180:interp=linear", once)
seam = np.roll(twice, 2, 1)[50, :4]
print("column 0 of 60000 on 10000 turned twice, columns 198 to 201:", seam)
assert np.allclose(seam, [10000, 10063, 35064, 10189], atol=300)
PROGRAM
