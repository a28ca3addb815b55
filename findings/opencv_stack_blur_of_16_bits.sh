#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93 (x86-64): cv2.stackBlur of bright images of 16 bits is dark: a flat 60000 becomes 27232 by 31 pixels and 2783 by 101.
# Believed: a blur of a flat image is that image, in each of the types that the documentation lists. Seen of flat images of 200 x 200: all but 8 columns are
# wrong where values and window are large: 60000 by 5, 7 and 9 pixels is about 40000, and by 31 and wider a half or less, 30000 is 13643 by 45 pixels, and
# 16000 is 3745 by 101. Other values are right within .5%, and float32 always. Bytes are rounded down along rows and columns: noise gets .94 levels
# darker than floats by 7 pixels, and 16 after twenty times.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("opencv", cv2.__version__)
wrong = {
    31: {60000: 27232},
    45: {30000: 13643, 60000: 10902},
    61: {30000: 13639, 60000: 10895},
    101: {16000: 3745, 30000: 1391, 60000: 2783},
}
for size in (3, 5, 7, 9, 15, 31, 45, 61, 101):
    for value in (1000, 4000, 16000, 30000, 60000):
        flat = np.full((200, 200), value, np.uint16)
        blurred = cv2.stackBlur(flat, (size, size))
        assert abs(cv2.stackBlur(flat.astype(np.float32), (size, size)) / value - 1).max() < 1e-3
        off = (abs(blurred / value - 1) > 0.005).mean()
        if off:
            print(
                f"{size} pixels wide, flat {value} becomes {blurred.min()} to {blurred.max()}, middle {blurred[100, 100]}, {off:.0%} of it wrong"
            )
        if size < 10:
            assert (off > 0) == (size > 3 and value == 60000) and (not off or 38000 < blurred.min() < 43000)
        else:
            assert (
                blurred.min() > value * 0.999
                if value not in wrong.get(size, {})
                else blurred[100, 100] == blurred.min() == wrong[size][value]
            )
noise = np.random.default_rng(0).integers(0, 256, (400, 400), dtype=np.uint8)
darker = {}
for size, expected in ((3, 0.75), (5, 0.5), (7, 0.94), (9, 0.75), (11, 0.26), (15, 0.49), (31, 0.5)):
    bytes_, floats = (cv2.stackBlur(image, (size, size)) for image in (noise, noise.astype(np.float32)))
    darker[size] = round(float((floats - bytes_)[60:-60, 60:-60].mean()), 2)
    assert abs(darker[size] - expected) < 0.03
often = noise
for _ in range(20):
    often = cv2.stackBlur(often, (7, 7))
print("bytes darker than floats by width", darker, "twenty times by 7", round(float(noise.mean() - often.mean()), 1))
assert 15 < noise.mean() - often.mean() < 17
PROGRAM
