#!/usr/bin/env bash
# opencv-contrib-python-headless 5.0.0.93: ximgproc.GradientDericheX and Y of a flat image are up to half of its brightness at the border.
# Believed: the derivative of a flat image is 0, as by cv2.Sobel and cv2.Scharr, up to the border, and X and Y are one filter, turned. Seen of a flat
# 100 with alpha=1 and omega=1: 26 in the first column and -26 in the last, with 5 and less in the next three; in the last rows -18, -55 and -26,
# where the first have 26, -3 and -5, so that Y of an image is not X of its transpose. A step from 50 to 150 inside is 100: the frame of a
# picture counts among its strong edges. Crop it, or pad by ten pixels before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
flat = np.full((64, 64), 100, np.uint8)
across, along = cv2.ximgproc.GradientDericheX(flat, 1, 1), cv2.ximgproc.GradientDericheY(flat, 1, 1)
print("flat 100, X, first and last columns:", across[32, :4].round(1), across[32, -4:].round(1))
print("flat 100, Y, first and last rows:   ", along[:4, 32].round(1), along[-4:, 32].round(1))
assert np.allclose(across[32, :4], [26.2, -3.1, -4.8, -1.5], atol=0.1) and np.allclose(across, -across[:, ::-1], atol=0.1)
assert np.allclose(along[:4, 32], across[32, :4], atol=0.1) and np.allclose(along[-4:, 32], [0.1, -18.5, -55.5, -26.2], atol=0.1)
assert abs(across[10:-10, 10:-10]).max() < 0.01
step = np.where(np.arange(64) < 32, 50, 150).astype(np.uint8)
peak = abs(cv2.ximgproc.GradientDericheX(np.tile(step, (64, 1)), 1, 1)[32, 20:44]).max()
print("a step from 50 to 150 inside:", peak)
assert abs(peak - 100) < 0.5
for name, peer in (("Sobel", cv2.Sobel(flat, cv2.CV_32F, 1, 0)), ("Scharr", cv2.Scharr(flat, cv2.CV_32F, 0, 1))):
    print(f"flat 100, {name}:", abs(peer).max())
    assert not peer.any()
PROGRAM
