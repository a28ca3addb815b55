#!/usr/bin/env bash
# mahotas 1.4.19: polygon.fill_polygon leaves the first row of each polygon out, so that masks are half a pixel too low.
# Believed: the border belongs to the polygon on all sides, as with cv2.fillPoly, or on none. Seen: the columns of both borders are drawn, and so is the
# last row, and the first is not: the square from (5, 5) to (14, 14) has 90 pixels in place of 100, with its center at (10, 9.5), in either direction
# of the points. One of two rows has one, and of one row none. The mask of the polygon turned by 180 degrees is not the turned mask.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mahotas==1.4.19 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import mahotas
import numpy as np
from mahotas import polygon

print("mahotas", mahotas.__version__)


def filled(points):
    canvas = np.zeros((20, 20), bool)
    polygon.fill_polygon(points, canvas)
    return canvas


def by_opencv(points):
    return cv2.fillPoly(np.zeros((20, 20), np.uint8), [np.array(points)[:, ::-1].reshape(-1, 1, 2).astype(np.int32)], 1) > 0


shapes = {
    "square": [(5, 5), (5, 14), (14, 14), (14, 5)],
    "square, the other way": [(5, 5), (14, 5), (14, 14), (5, 14)],
    "two rows": [(5, 5), (5, 14), (6, 14), (6, 5)],
    "one row": [(5, 5), (5, 14), (5, 14), (5, 5)],
}
for name, points in shapes.items():
    mask, whole = filled(points), by_opencv(points)
    turned = filled([(19 - row, 19 - column) for row, column in points])[::-1, ::-1]
    lost = whole & ~mask
    rows, same = np.unique(np.argwhere(lost)[:, 0]).tolist(), np.array_equal(mask, turned)
    print(f"{name}: {mask.sum()} pixels, by OpenCV {whole.sum()}, lost are the rows {rows}, turned the same: {same}")
    assert same == (name == "one row")
    assert np.array_equal(mask[6:], whole[6:]) and whole[5, 5:15].all() and not mask[5].any()
center = np.argwhere(filled(shapes["square"])).mean(0)
print("center of the square", center.tolist())
assert center.tolist() == [10, 9.5]
PROGRAM
