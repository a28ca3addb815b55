#!/usr/bin/env bash
# scikit-image 0.26.0 and opencv-python-headless 5.0.0.93: the seventh Hu moment of an image has opposite signs in the two.
# Believed: Hu's seven invariants are numbers with one definition, so that features of both libraries mix, and the sign of the seventh tells a shape
# from its mirror image, p from q. Seen of a shape and of noise: the first six agree, the seventh is the other one's negative, from moments_hu and
# from regionprops; by the definition with x along the rows, written out below, OpenCV is right, and scikit-image gives what OpenCV gives of the
# mirror image. Its moments are indexed by row and column, and the formula takes them as x and y. A classifier trained on one reads mirror images
# from the other.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import skimage
from skimage import measure

print("scikit-image", skimage.__version__, "OpenCV", cv2.__version__)
shape = np.zeros((100, 120), np.uint8)  # the letter G, or what one takes for it
shape[20:60, 30:50] = shape[50:60, 30:90] = shape[20:30, 30:70] = 1
photo = np.random.default_rng(0).random((40, 50)) ** 4


def by_skimage(image):
    return measure.moments_hu(measure.moments_normalized(measure.moments_central(image.astype(float))))


def by_opencv(image):
    return cv2.HuMoments(cv2.moments(image)).ravel()


def seventh(image):
    """Hu's definition, with x along the rows and y down the columns."""
    image = image.astype(float)
    y, x = np.indices(image.shape)
    mass = image.sum()
    x, y = x - (image * x).sum() / mass, y - (image * y).sum() / mass
    n30, n21, n12, n03 = ((image * x**p * y ** (3 - p)).sum() / mass**2.5 for p in (3, 2, 1, 0))
    first = (3 * n21 - n03) * (n30 + n12) * ((n30 + n12) ** 2 - 3 * (n21 + n03) ** 2)
    return first - (n30 - 3 * n12) * (n21 + n03) * (3 * (n30 + n12) ** 2 - (n21 + n03) ** 2)


for name, image in (("shape", shape), ("noise", photo)):
    ours, theirs, mirrored = by_skimage(image), by_opencv(image), by_skimage(image[:, ::-1])
    print(f"{name}: OpenCV / scikit-image", (theirs / ours).round(6), "mirrored / not, both by scikit-image", (mirrored / ours).round(6))
    assert np.allclose(theirs[:6], ours[:6]) and np.isclose(theirs[6], -ours[6]) and np.isclose(theirs[6], seventh(image))
    assert np.allclose(mirrored[:6], ours[:6]) and np.isclose(mirrored[6], -ours[6])
region = measure.regionprops(shape.astype(int))[0].moments_hu
print(f"seventh of the shape: regionprops {region[6]:.3e}, OpenCV {by_opencv(shape)[6]:.3e}, OpenCV of the mirror image", end=" ")
print(f"{by_opencv(np.ascontiguousarray(shape[:, ::-1]))[6]:.3e}, by the definition {seventh(shape):.3e}")
assert np.isclose(region[6], by_opencv(np.ascontiguousarray(shape[:, ::-1]))[6])
PROGRAM
