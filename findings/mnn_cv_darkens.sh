#!/usr/bin/env bash
# MNN 3.6.1 (MNN.cv): gray, blur, GaussianBlur, pyrDown and pyrUp of bytes are half a level darker than OpenCV's, and blur by 2 x 2 is smaller.
# Believed: names and results of OpenCV, as its documentation lists them side by side, up to a level of rounding to either side. Seen: BGR2GRAY of colors,
# blur by 3 x 3 and 5 x 5, GaussianBlur, pyrDown and pyrUp are .45 to .55 levels below OpenCV's on average; a flat 100 is 99 after
# one GaussianBlur and 98 after two. Fractions are cut off. blur by 2 x 2 of 48 x 60 pixels is 47 x 59, where OpenCV's has the size of the image.
# A network that was trained on OpenCV's images gets darker ones on the phone. Of bilateralFilter color images are exact.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mnn==3.6.1 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import sys
from importlib.metadata import version

import cv2
import MNN.cv
import MNN.numpy
import numpy as np

print("MNN", version("mnn"))
random = np.random.default_rng(0)
smooth = cv2.GaussianBlur(random.normal(0, 1, (48, 60, 3)), (0, 0), 2)
image = np.uint8(cv2.normalize(smooth, None, 10, 245, cv2.NORM_MINMAX))
cv2.imwrite(f"{sys.argv[1]}/image.png", image)
read = MNN.cv.imread(f"{sys.argv[1]}/image.png")


def numbers(variable):
    return np.array(variable.read()).reshape(variable.shape)


assert np.array_equal(numbers(read), image)
calls = {
    "BGR2GRAY": lambda cv, given: cv.cvtColor(given, cv.COLOR_BGR2GRAY),
    "blur 3 x 3": lambda cv, given: cv.blur(given, (3, 3)),
    "blur 5 x 5": lambda cv, given: cv.blur(given, (5, 5)),
    "GaussianBlur": lambda cv, given: cv.GaussianBlur(given, (5, 5), 1.5),
    "pyrDown": lambda cv, given: cv.pyrDown(given),
    "pyrUp": lambda cv, given: cv.pyrUp(given),
    "bilateralFilter": lambda cv, given: cv.bilateralFilter(given, 5, 50.0, 3.0),
}
for name, call in calls.items():
    expected = call(cv2, image).astype(int)
    difference = numbers(call(MNN.cv, read)).reshape(expected.shape) - expected
    print(f"{name}: {difference.mean():+.3f} levels from OpenCV on average, {difference.min()} to {difference.max()}")
    assert not difference.any() if name == "bilateralFilter" else -0.56 < difference.mean() < -0.44
small = MNN.cv.blur(read, (2, 2)).shape
print("blur 2 x 2:", small, "OpenCV", cv2.blur(image, (2, 2)).shape)
assert list(small[:2]) == [47, 59]
flat = MNN.numpy.array(np.full((20, 20), 100).tolist(), dtype=MNN.numpy.uint8)
levels = []
for _ in range(10):
    flat = MNN.cv.GaussianBlur(flat, (5, 5), 1.5)
    levels += np.unique(numbers(flat)).tolist()
print("a flat 100 after one to ten times GaussianBlur:", levels)
assert levels[:2] == [99, 98]
PROGRAM
