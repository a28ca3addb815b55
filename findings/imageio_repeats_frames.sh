#!/usr/bin/env bash
# imageio 2.38.1 with imageio-ffmpeg 0.8.1 (av 18.1.0): reading a video of varying frame rate repeats frames, and leaves others out.
# Believed: iterating over a video gives its frames, one after the other, so that index 20 is the frame that annotations, PyAV and OpenCV call 20. Seen of 40
# frames of which each tenth comes 5 ticks after the one before: the plugin "FFMPEG" gives 54 of an mp4 file and 52 of
# an mkv file, pauses filled with copies, and of the mp4 file, read at the mean rate, four frames never; index 35 is frame 27. Its own
# count_frames_and_secs says 40. The plugin "pyav" and cv2.VideoCapture give all 40. With output_params=["-fps_mode", "passthrough"] it does, too.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet imageio==2.38.1 imageio-ffmpeg==0.8.1 av==18.1.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import sys
from fractions import Fraction
from importlib.metadata import version

import av
import cv2
import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np

print("imageio", version("imageio"), "imageio-ffmpeg", version("imageio-ffmpeg"), "av", av.__version__)
av.logging.set_level(None)
times = np.cumsum(np.where(np.arange(40) % 10 == 0, 5, 1)) - 5


def numbers(images):
    return [round((float(image.mean()) - 20) / 5) for image in images]


def opencv(path):
    capture = cv2.VideoCapture(path)
    while (pair := capture.read())[0]:
        yield pair[1]


for kind, expected in (("mp4", 54), ("mkv", 52)):
    path = f"{sys.argv[1]}/video.{kind}"
    with av.open(path, "w") as file:
        stream = file.add_stream("libx264", rate=30, options={"crf": "1"})
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, 30)
        for number, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(np.full((96, 128, 3), 20 + 5 * number, np.uint8), format="rgb24")
            frame.pts, frame.time_base = int(time), Fraction(1, 30)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    found = numbers(iio.imiter(path, plugin="FFMPEG"))
    missing = sorted(set(range(40)) - set(found))
    passed = numbers(iio.imiter(path, plugin="FFMPEG", output_params=["-fps_mode", "passthrough"]))
    index = numbers([iio.imread(path, plugin="FFMPEG", index=35)])[0]
    count = imageio_ffmpeg.count_frames_and_secs(path)[0]
    print(f"{kind}: {len(found)} frames, missing {missing}, index 35 is frame {index}, counted {count}")
    print("  ", found)
    assert len(found) == expected and (len(missing) > 2) == (kind == "mp4") and count == 40
    assert numbers(iio.imiter(path, plugin="pyav")) == numbers(opencv(path)) == passed == list(range(40))
PROGRAM
