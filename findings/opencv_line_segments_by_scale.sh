#!/usr/bin/env bash
# opencv-contrib-python-headless 5.0.0.93: cv2.createLineSegmentDetector finds lines an eighth of a pixel to the left and up, and half a one at scale .5.
# Believed: its segments are known to fractions of a pixel and have no bias, and scale, .8 by default, is how much it looks at, not where. Seen of
# edges at fractions of pixels, rising and falling, vertical and horizontal: the mean error is -.13 pixels at the default, with a standard deviation of .04,
# -.5 at scale=.5, -.75 at .4 and 0 at 1: (1 - 1 / scale) / 2, what is lost when coordinates of a shrunk image are only multiplied. The
# contrib module's FastLineDetector and EdgeDrawing have whole pixels, and no bias. Add (1 / scale - 1) / 2.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
x = np.tile(np.arange(121.0), (121, 1))
places = np.linspace(50.01, 69.7, 60)


def errors(detect):
    """How far the found lines are from the edges, in x of vertical ones, in y of horizontal ones."""
    found = []
    for place in places:
        for sign in (1, -1):
            # a pixel that the edge crosses has the mean of both sides
            edge = np.uint8(np.rint(20 + 200 * np.clip(sign * (x - place) + 0.5, 0, 1)))
            for across, image in enumerate((edge, np.ascontiguousarray(edge.T))):
                lines = detect(image).reshape(-1, 2, 2)
                found += [line[:, across].mean() - place for line in lines if abs(np.subtract(*line)[1 - across]) > 50]
    return np.array(found)


def drawing(image):
    detector = cv2.ximgproc.createEdgeDrawing()
    detector.detectEdges(image)
    return detector.detectLines()


detectors = {f"LSD at scale {s}": (cv2.createLineSegmentDetector(scale=s).detect, (1 - 1 / s) / 2) for s in (0.4, 0.5, 0.8, 1)}
for name, (detect, expected) in detectors.items():
    seen = errors(lambda image, detect=detect: detect(image)[0])
    print(f"{name}: {len(seen)} lines, mean error {seen.mean():+.3f}, deviation {seen.std():.3f}, expected {expected:+.3f}")
    assert len(seen) >= 240 and abs(seen.mean() - expected) < 0.02 and seen.std() < 0.1
for name, detect in (("FastLineDetector", cv2.ximgproc.createFastLineDetector().detect), ("EdgeDrawing", drawing)):
    seen = errors(detect)
    print(f"{name}: {len(seen)} lines, mean error {seen.mean():+.3f}, deviation {seen.std():.3f}")
    assert abs(seen.mean()) < 0.05
PROGRAM
