#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93 (x86-64): cv2.bilateralFilter of gray bytes darkens by half a level where the window is 3 or 5 pixels a side.
# Believed: results are rounded to the nearest level, as they are at d = 7 and 9, of color images and without optimizations. Seen: Intel's IPP,
# which serves one channel of bytes up to d = 5, cuts the fraction off: noise loses .48 levels in a pass, and 9.8 in twenty passes, where
# the same filter of float32 loses none. cv2.ipp.setUseIPP(False) gives the rounded result, and so would d = 7.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__, cv2.ipp.getIppVersion())
noise = np.random.default_rng(0).integers(0, 256, (128, 128), dtype=np.uint8)
for d in (3, 5, 7, 9):
    exact = cv2.bilateralFilter(noise.astype(np.float32), d, 50, 50)
    errors = []
    for ipp in (True, False):
        cv2.ipp.setUseIPP(ipp)
        errors.append((cv2.bilateralFilter(noise, d, 50, 50) - exact).mean())
    print(f"d = {d}: bytes are {errors[0]:.3f} levels from floats on average, without IPP {errors[1]:.3f}")
    assert abs(errors[1]) < 0.02 and (-0.52 < errors[0] < -0.44 if d <= 5 else abs(errors[0]) < 0.02)
cv2.ipp.setUseIPP(True)
gray, real = noise, noise.astype(np.float32)
for _ in range(20):
    gray, real = cv2.bilateralFilter(gray, 5, 50, 50), cv2.bilateralFilter(real, 5, 50, 50)
print(f"mean of the image {noise.mean():.1f}, after twenty passes of bytes {gray.mean():.1f}, of floats {real.mean():.1f}")
assert 9 < real.mean() - gray.mean() < 10.5
PROGRAM
