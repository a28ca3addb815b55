#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.cvtColor(COLOR_HSV2RGB) of bytes gives one color different results in different columns.
# Believed: a conversion of pixels depends on the pixel alone, so that an image and a crop of it convert alike. Seen: a row of one
# color, 33 pixels long, has two colors; 73% of random codes differ by a level between the columns that vectors of 32 serve and the
# rest of the row. Rows of at most 32 pixels and of multiples of 32 are uniform, each with a value of its own way.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import cv2
import numpy as np

codes = np.random.default_rng(0).integers(0, 256, (2000, 3), dtype=np.uint8)
codes[:, 0] %= 180
print("OpenCV", cv2.__version__)
for width, rest in ((31, 0), (32, 0), (33, 1), (64, 0), (100, 4)):
    colors = cv2.cvtColor(np.repeat(codes[:, None], width, axis=1), cv2.COLOR_HSV2RGB)
    other = (colors != colors[:, :1]).any(-1)
    levels = abs(colors.astype(int) - colors[:, :1]).max()
    columns = np.flatnonzero(other.any(0)).tolist()
    print(f"{width} pixels: {other.any(1).mean():.0%} of the codes change, by {levels} levels, in columns {columns}")
    assert columns == list(range(width - rest, width)) and levels == bool(rest)
PROGRAM
