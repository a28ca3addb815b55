#!/usr/bin/env bash
# pupil-apriltags 1.0.4.post11 and opencv-python-headless 5.0.0.93: AprilTag corners are half a pixel to the right and below those of OpenCV.
# Believed: a detection is in the coordinates of the image, whose pixels have their centers at whole numbers, as a camera matrix from cv2.calibrateCamera has it.
# Seen: center and corners of pupil_apriltags have (.5, .5) in the middle of the first pixel, and so have cv2.aruco's own with
# CORNER_REFINE_APRILTAG, while its three other methods have (0, 0) there: of a tag around (199.5, 179.5) the first two say (200, 180). With an OpenCV
# calibration the pose of every tag is turned by half a pixel, a millimeter in a meter at f = 500. Subtract .5 from corners, or add it to cx and cy.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pupil-apriltags==1.0.4.post11 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import cv2
import numpy as np
from pupil_apriltags import Detector

print("pupil-apriltags", version("pupil-apriltags"), "OpenCV", cv2.__version__)
tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
for left, top in ((100, 80), (101, 83)):
    image = np.full((400, 420), 255, np.uint8)
    image[top : top + 200, left : left + 200] = cv2.aruco.generateImageMarker(tags, 5, 200)
    image = cv2.GaussianBlur(image, (0, 0), 1)  # as a lens would have it
    rows, columns = np.nonzero(image < 128)
    middle = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
    assert middle.tolist() == [left + 99.5, top + 99.5]
    centers = {"pupil_apriltags": Detector("tag36h11", quad_decimate=1.0).detect(image)[0].center}
    for refinement in ("NONE", "SUBPIX", "CONTOUR", "APRILTAG"):
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = getattr(cv2.aruco, "CORNER_REFINE_" + refinement)
        centers["CORNER_REFINE_" + refinement] = cv2.aruco.ArucoDetector(tags, parameters).detectMarkers(image)[0][0][0].mean(0)
    print(f"tag around {middle.tolist()}:", {name: np.round(center, 2).tolist() for name, center in centers.items()})
    for name, center in centers.items():
        assert abs(center - middle - (0.5 if "APRIL" in name.upper() else 0)).max() < 0.02
PROGRAM
