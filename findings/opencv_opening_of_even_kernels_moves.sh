#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: opening and closing by a kernel of even size move the image by a pixel, to the right and down.
# Believed: cv2.morphologyEx(MORPH_OPEN) removes what the kernel does not fit into and leaves the rest where it is, so that it never brightens,
# closing never darkens, and top hats show small things alone. Seen: a rectangle that holds the kernel many times comes back a pixel to the right and
# below after opening or closing by 2 x 2 or 4 x 4; opening brightens 14 pixels of it, and the top hat, which should be empty, is its left and upper edge.
# A kernel of 3 x 3 whose ones are off its center moves by as much. Dilation does not mirror the kernel that erosion used, as the definition
# does. scipy.ndimage and scikit-image leave the rectangle as it is.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import scipy.ndimage
import skimage.morphology

print("OpenCV", cv2.__version__)
image = np.zeros((20, 20), np.uint8)
image[5:12, 6:14] = 255
corner = np.array([[0, 0, 0], [0, 1, 1], [0, 1, 1]], np.uint8)
kernels = {"2 x 2": np.ones((2, 2), np.uint8), "4 x 4": np.ones((4, 4), np.uint8), "3 x 3": np.ones((3, 3), np.uint8), "corner": corner}
for name, kernel in kernels.items():
    moved = {"2 x 2": 1, "4 x 4": 1, "3 x 3": 0, "corner": -1}[name]
    expected = np.roll(image, (moved, moved), (0, 1))
    opened, closed, hat = (cv2.morphologyEx(image, how, kernel) for how in (cv2.MORPH_OPEN, cv2.MORPH_CLOSE, cv2.MORPH_TOPHAT))
    brighter = int((opened > image).sum())
    print(f"{name}: box {cv2.boundingRect(image)}, opened {cv2.boundingRect(opened)}, closed {cv2.boundingRect(closed)},", end=" ")
    print(f"{brighter} pixels brighter after opening, top hat of {np.count_nonzero(hat)} pixels")
    assert np.array_equal(opened, expected) and np.array_equal(closed, expected)
    assert brighter == np.count_nonzero(hat) == (14 if moved else 0)
    peers = {
        "scipy.ndimage": (scipy.ndimage.grey_opening(image, footprint=kernel), scipy.ndimage.grey_closing(image, footprint=kernel)),
        "scikit-image": (skimage.morphology.opening(image, kernel), skimage.morphology.closing(image, kernel)),
    }
    for peer, (by_peer, closed_by_peer) in peers.items():
        print(f"    {peer}: opened {cv2.boundingRect(by_peer)}, closed {cv2.boundingRect(closed_by_peer)}")
        assert np.array_equal(by_peer, image) and np.array_equal(closed_by_peer, image)
PROGRAM
