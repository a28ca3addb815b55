#!/usr/bin/env bash
# av 18.1.0 (FFmpeg's swscale 9.5.102): frames of BT.709 video in format "gray" are not their luma, up to 34 levels off.
# Believed: gray is the plane Y, with its range stretched to 0..255, so that one may take either, and it is the cheapest thing to decode. Seen: true
# for BT.601. Of frames that say BT.709 or BT.2020, as HD and HDR files do, gray is that of their RGB by the weights of BT.601: green of luma 183 becomes
# 149, red of 55 becomes 76, also where dst_colorspace names the frame's own. Features and thresholds learned on planes, as hardware decoders
# hand them out, do not fit such frames. The plane itself is frame.planes[0]; src_colorspace=5, a lie, keeps it as well.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import av
import numpy as np

print("av", av.__version__, "swscale", av.library_versions["libswscale"])
standards = {"BT.601": (5, 0.299, 0.114), "BT.709": (1, 0.2126, 0.0722), "BT.2020": (9, 0.2627, 0.0593)}
for name, (space, kr, kb) in standards.items():
    off = {}
    for color, rgb in {"green": (0, 1, 0), "red": (1, 0, 0), "blue": (0, 0, 1), "gray": (0.5, 0.5, 0.5)}.items():
        luma = float(np.dot(rgb, (kr, 1 - kr - kb, kb)))
        codes = [round(16 + 219 * luma), round(128 + 112 * (rgb[2] - luma) / (1 - kb)), round(128 + 112 * (rgb[0] - luma) / (1 - kr))]
        frame = av.VideoFrame(16, 16, "yuv420p")
        for plane, code in zip(frame.planes, codes):
            plane.update(bytes([code]) * plane.buffer_size)
        frame.colorspace, frame.color_range = space, 1
        stretched = (codes[0] - 16) * 255 / 219
        seen = int(frame.to_ndarray(format="gray")[8, 8])
        to_own = int(frame.reformat(format="gray", dst_colorspace=space).to_ndarray()[8, 8])
        kept = int(frame.reformat(format="gray", src_colorspace=5).to_ndarray()[8, 8])
        of_rgb = float(np.dot(rgb, (0.299, 0.587, 0.114)) * 255)
        off[color] = seen - stretched
        print(
            f"{name} {color}: luma {stretched:.1f}, gray {seen}, by BT.601 of its RGB {of_rgb:.1f}, to its own {to_own}, as if of BT.601 {kept}"
        )
        assert abs(seen - of_rgb) < 1.5 and to_own == seen and abs(kept - stretched) < 1
    assert (max(map(abs, off.values())) > 10) == (name != "BT.601")
PROGRAM
