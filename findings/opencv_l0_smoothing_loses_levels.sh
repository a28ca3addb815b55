#!/usr/bin/env bash
# opencv-contrib-python-headless 5.0.0.93: ximgproc.l0Smooth darkens and brightens whole regions, so that white becomes 105.
# Believed: L0 smoothing flattens and keeps strong edges: an image that is half black and half white has one edge, costs least as it is, and stays, and
# the mean of any image stays. Seen at the defaults: the white half falls to 105 of 255 at the edge and to 77 at the border, in float32 the black half
# falls to -.59 and the mean from .5 to -.1; at lambda .0001, two hundred times weaker, white is still 231 at the edge and 90 at the border. Opposite
# borders pull at one another: l0Smooth of the image with its mirror images beside it returns it, as that jumps nowhere where it repeats. The paper's
# algorithm, written out below, returns either image, and keeps the mean by construction.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)


def written_out(image, weight, factor):
    """The alternating minimization of Xu et al. 2011 for an image that repeats."""
    spectrum, result = np.fft.fft2(image), image
    along = [2 - 2 * np.cos(2 * np.pi * np.fft.fftfreq(n)) for n in image.shape]
    beta = 2 * weight
    while beta < 1e5:
        down, right = (np.roll(result, -1, axis) - result for axis in (0, 1))
        strong = down**2 + right**2 >= weight / beta
        down, right = down * strong, right * strong
        back = np.roll(down, 1, 0) - down + np.roll(right, 1, 1) - right
        result = np.fft.ifft2((spectrum + beta * np.fft.fft2(back)) / (1 + beta * np.add.outer(*along))).real
        beta *= factor
    return result


def mirrored(image):
    return np.block([[image, image[:, ::-1]], [image[::-1], image[::-1, ::-1]]])


half = np.zeros((128, 128), np.uint8)
half[64:] = 255
for image, name in ((half, "rows"), (half.T.copy(), "columns")):
    result = cv2.ximgproc.l0Smooth(image)
    profile = result[:, 64] if name == "rows" else result[64]
    weak = cv2.ximgproc.l0Smooth(image, None, 0.0001, 2.0)
    weak = weak[:, 64] if name == "rows" else weak[64]
    print(f"white {name}: at the edge, the middle, the border", profile[[64, 96, 126]], "with lambda .0001", weak[[64, 96, 126]])
    assert 95 < profile[64] < 115 and 67 < profile[126] < 87 and 220 < weak[64] < 240 and 80 < weak[126] < 100
    real = image.astype(np.float32) / 255
    floats = cv2.ximgproc.l0Smooth(real.copy())
    repeated = cv2.ximgproc.l0Smooth(mirrored(image))[:128, :128]
    own = written_out(real.astype(np.float64), 0.02, 2.0), written_out(mirrored(real.astype(np.float64)), 0.02, 2.0)[:128, :128]
    off = [np.abs(other - real).max() for other in own]
    print(f"float32: black becomes {floats.min():.2f}, the mean {floats.mean():.2f}; written out off by {off[0]:.0e} and {off[1]:.0e};",
          f"with mirror images off by {np.abs(repeated.astype(int) - image).max()}")
    assert -0.62 < floats.min() < -0.55 and -0.15 < floats.mean() < -0.05 and max(off) < 1e-6 and np.array_equal(repeated, image)
PROGRAM
