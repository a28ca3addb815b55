#!/usr/bin/env bash
# opencv-contrib-python-headless 5.0.0.93: ximgproc.l0Smooth of a float32 image writes its result over the image.
# Believed: what is passed as src is read, and the result is the array that is returned, as with every other filter of the library. Seen: after the
# call the image has the bits of the result, though the two share no memory: what subtracts them to get the detail gets 0 everywhere, and smoothing one
# image with several lambdas smooths the smoothed one. uint8, uint16 and float64 images stay as they are, and so does float32 under every other filter
# of ximgproc that was tried. Pass a copy.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
random = np.random.default_rng(0)
filters = {
    "l0Smooth": cv2.ximgproc.l0Smooth,
    "bilateralTextureFilter": cv2.ximgproc.bilateralTextureFilter,
    "dtFilter": lambda image: cv2.ximgproc.dtFilter(image, image, 10, 0.3),
    "fastGlobalSmootherFilter": lambda image: cv2.ximgproc.fastGlobalSmootherFilter((image * 255).astype(np.uint8), image, 100, 10),
    "guidedFilter": lambda image: cv2.ximgproc.guidedFilter(image, image, 4, 0.01),
    "jointBilateralFilter": lambda image: cv2.ximgproc.jointBilateralFilter(image, image, 7, 0.1, 3),
    "rollingGuidanceFilter": cv2.ximgproc.rollingGuidanceFilter,
}
for shape in ((60, 80), (60, 80, 3)):
    smooth = cv2.GaussianBlur(random.random(shape), (0, 0), 3)
    smooth = (smooth - smooth.min()) / np.ptp(smooth)
    images = [(smooth * 255).astype(np.uint8), (smooth * 65535).astype(np.uint16), smooth.astype(np.float32), smooth]
    for image in images:
        before = image.copy()
        result = cv2.ximgproc.l0Smooth(image)
        written = bool((image != before).any())
        print(f"l0Smooth of {image.dtype} {shape}: the image changed: {written}; shares memory: {np.shares_memory(image, result)}")
        assert written == (image.dtype == np.float32) and (result != before).any()
        assert not written or np.array_equal(image, result)
    for name, run in filters.items():
        image = smooth.astype(np.float32)
        run(image)
        assert np.array_equal(image, smooth.astype(np.float32)) == (name != "l0Smooth"), name
print("images that other filters left alone:", ", ".join(name for name in filters if name != "l0Smooth"))
PROGRAM
