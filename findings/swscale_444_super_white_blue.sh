#!/usr/bin/env bash
# av 18.1.0 (FFmpeg's swscale) with numpy 2.4.6: a blue brighter than white loses all its blue where chroma has full resolution.
# Believed: codes above the nominal peak, which BT.709 allows up to 254, are clamped, so that what is too bright becomes 255, and a
# picture of one color is the same in yuv444p as in yuv420p. Seen at luma 254 and chroma (240, 128), limited range: blue is 255 from
# yuv420p and yuv422p, and 0 from yuv444p, by BT.709. At the nominal peak of luma, 235, all three give 255.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import av


def rgb(layout, codes):
    frame = av.VideoFrame(16, 16, layout)
    for plane, code in zip(frame.planes, codes):
        plane.update(bytes([code]) * plane.buffer_size)
    frame = frame.reformat(format="rgb24", src_colorspace="ITU709", src_color_range="MPEG", dst_color_range="JPEG")
    return frame.to_ndarray()[8, 8].tolist()


blue = {}
for luma in (235, 254):
    for layout in ("yuv420p", "yuv422p", "yuv444p"):
        result = rgb(layout, (luma, 240, 128))
        blue[luma, layout] = result[2]
        print(f"luma {luma}, {layout}: {result}")
assert blue.pop((254, "yuv444p")) == 0 and set(blue.values()) == {255}
PROGRAM
