#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.findHomography of points on one line returns a matrix and calls all points inliers.
# Believed: a homography that the points do not determine is None, or the mask says so. Seen: of 4 collinear points the matrix has one row that
# is not 0, so that every point is mapped to infinity or nowhere, with a mask of ones, by the default method, RANSAC and LMEDS; of 6 the default
# method returns one of the many matrices that fit the line, with entries of thousands, while RANSAC returns None.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import cv2
import numpy as np

source = np.repeat(np.float32([[0], [1], [2], [3], [4], [7]]) * 10, 2, axis=1)
target = 2 * source + 5
print("OpenCV", cv2.__version__)
for name, method in (("default", 0), ("RANSAC", cv2.RANSAC), ("LMEDS", cv2.LMEDS)):
    matrix, mask = cv2.findHomography(source[:4], target[:4], method)
    print("4 points,", name, matrix.round(3).tolist(), "inliers", mask.ravel().tolist())
    assert np.linalg.matrix_rank(matrix) == 1 and mask.all()
matrix, mask = cv2.findHomography(source, target)
print("6 points, default", matrix.round(1).tolist(), "inliers", mask.ravel().tolist())
assert np.isfinite(matrix).all() and abs(matrix).max() > 100 and mask.all()
matrix, _ = cv2.findHomography(source, target, cv2.RANSAC)
print("6 points, RANSAC", matrix)
assert matrix is None
PROGRAM
