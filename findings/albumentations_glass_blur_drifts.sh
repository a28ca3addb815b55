#!/usr/bin/env bash
# AlbumentationsX 2.5.1: GlassBlur moves the image, by (1.7, 1.7) pixels in the mode "exact" and by (.6, -.2) in its default mode.
# Believed: pixels are swapped with others around them at random, so that an image is frosted and lies where it was, as its masks, boxes and key points
# do. Seen at the defaults, for bytes and for floats: a spot moves to the same side with every seed, 1.7 pixels right and down on average where mode
# is "exact", with a standard deviation of .2, and .57 right and .17 up in the mode "fast", which is the default. With max_delta=1 and one
# iteration it is (.5, .5) and less than .1.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet albumentationsx==2.5.1 opencv-python-headless==5.0.0.93 numpy==2.4.6 torch==2.13.0
"$folder/venv/bin/python" - <<'PROGRAM'
import albumentations as A
import numpy as np

print("AlbumentationsX", A.__version__)
height, width = 96, 120
y, x = np.mgrid[:height, :width]
spot = np.exp(-((x - 59.5) ** 2 + (y - 47.5) ** 2) / 200)
assert np.allclose(spot, spot[::-1, ::-1])
small = {"max_delta": 1, "iterations": 1}
for kind in (np.uint8, np.float32):
    image = spot.astype(np.float32) if kind is np.float32 else np.round(spot * 255).astype(np.uint8)
    image = image[..., None].repeat(3, 2)
    for mode, options, expected in (("exact", {}, (1.72, 1.72)), ("fast", {}, (0.57, -0.17)), ("exact", small, (0.5, 0.5)), ("fast", small, (0, 0))):
        moves = []
        for seed in range(30):
            result = A.Compose([A.GlassBlur(mode=mode, **options, p=1)], seed=seed)(image=image)["image"][..., 0].astype(np.float64)
            moves.append([(result * axis).sum() / result.sum() - middle for axis, middle in ((x, 59.5), (y, 47.5))])
        mean, spread = np.mean(moves, axis=0), np.std(moves, axis=0)
        print(f"{np.dtype(kind)}, {mode}, {options or 'defaults'}: moves by {mean.round(2)}, with standard deviations {spread.round(2)}")
        assert np.allclose(mean, expected, atol=0.15) and (spread < 0.35).all()
PROGRAM
