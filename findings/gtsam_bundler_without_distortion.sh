#!/usr/bin/env bash
# gtsam 4.3.0 (Python): Cal3Bundler.uncalibrate and calibrate take no notice of the distortion that the camera with it projects by.
# Believed: uncalibrate gives the pixel of a point as the camera sees it, and calibrate undoes it, as for the other models, Cal3DS2, Cal3Fisheye and
# Cal3Unified. Seen: both are those of the base class Cal3f, a focal length and a center, so that k1 and k2 change nothing: at k1 = -.1 and k2 = .02
# a point at (.5, .2) is at (570, 340) by uncalibrate and at (563.2, 337.3) by PinholeCameraCal3Bundler.project, which is OpenCV's place. calibrate
# undoes uncalibrate, which hides it. project and backproject of the camera are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet gtsam==4.3.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import cv2
import gtsam
import numpy as np

print("gtsam", version("gtsam"))
point = np.array([0.5, 0.2])
models = {
    "Bundler": gtsam.Cal3Bundler(500, -0.1, 0.02, 320, 240),
    "DS2": gtsam.Cal3DS2(500, 500, 0, 320, 240, -0.1, 0.02, 0, 0),
    "Fisheye": gtsam.Cal3Fisheye(500, 500, 0, 320, 240, -0.1, 0.02, 0, 0),
    "Unified": gtsam.Cal3Unified(500, 500, 0, 320, 240, -0.1, 0.02, 0, 0, 0.5),
}
matrix = np.array([[500, 0, 320], [0, 500, 240], [0, 0, 1.0]])
by_opencv = cv2.projectPoints(np.append(point, 1)[None], np.zeros(3), np.zeros(3), matrix, np.array([-0.1, 0.02, 0, 0]))[0].ravel()
print("by OpenCV with k1 = -.1, k2 = .02:", by_opencv.round(2).tolist())
for name, model in models.items():
    camera = getattr(gtsam, "PinholeCameraCal3" + name)(gtsam.Pose3(), model)
    seen, pixel = camera.project(np.append(point, 1)), model.uncalibrate(point)
    back = model.calibrate(seen)
    print(
        f"Cal3{name}: projected to {seen.round(2).tolist()}, uncalibrated to {pixel.round(2).tolist()}, calibrated back to {back.round(4).tolist()}"
    )
    assert np.allclose(camera.backproject(seen, 1.0)[:2], point, atol=1e-5) and np.allclose(model.calibrate(pixel), point, atol=1e-5)
    if name in ("Bundler", "DS2"):
        assert np.allclose(seen, by_opencv)
    assert np.allclose(pixel, (500 * point + (320, 240)) if name == "Bundler" else seen)
    assert (abs(back - point).max() > 0.01) == (name == "Bundler")
straight = gtsam.Cal3Bundler(500, 0, 0, 320, 240)
assert np.array_equal(straight.uncalibrate(point), models["Bundler"].uncalibrate(point))
PROGRAM
