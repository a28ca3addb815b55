#!/usr/bin/env bash
# AlbumentationsX 2.5.1: Downscale at its defaults moves the image 1.5 pixels to the right and down, and leaves targets where they are.
# Believed: an image that is shrunk to a quarter and enlarged again is coarser and lies where it was, so masks, boxes and points may stay, as they do.
# Seen: the default interpolation for both ways is OpenCV's nearest, which takes the first pixel of each block and spreads it over the
# block: a spot in bytes or floats moves by (1.5, 1.5) at the default scale of .25, by .5 at .5 and by (2, 3) at .2, with 96 rows and 120
# columns, and that of the mirrored image as far to the other side. With INTER_AREA and INTER_LINEAR in interpolation_pair it stays.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet albumentationsx==2.5.1 opencv-python-headless==5.0.0.93 numpy==2.4.6 torch==2.13.0
"$folder/venv/bin/python" - <<'PROGRAM'
import albumentations as A
import cv2
import numpy as np

print("AlbumentationsX", A.__version__, "OpenCV", cv2.__version__)
height, width = 96, 120
y, x = np.mgrid[:height, :width]


def moved(transform, at, kind, mirrored=False):
    spot = np.repeat(np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 80)[..., None], 3, 2)
    spot = spot.astype(np.float32) if kind is np.float32 else np.round(spot * 255).astype(np.uint8)
    mask = (spot[..., 0] > spot.max() / 2).astype(np.uint8)
    if mirrored:
        spot = np.ascontiguousarray(spot[:, ::-1])
    result = transform(image=spot, mask=mask)
    assert np.array_equal(result["mask"], mask) and result["image"].dtype == spot.dtype
    weight = result["image"][..., 0].astype(np.float64)
    if mirrored:
        weight = weight[:, ::-1]
    return np.array([(weight * axis).sum() / weight.sum() for axis in (x, y)]) - at


spots = np.array([[50, 40], [51, 42], [63.5, 45.5], [70, 52], [48.2, 50.9]])
smooth = {"downscale": cv2.INTER_AREA, "upscale": cv2.INTER_LINEAR}
for kind in (np.uint8, np.float32):
    for scale, expected in ((None, (1.5, 1.5)), (0.25, (1.5, 1.5)), (0.5, (0.5, 0.5)), (0.2, (2, 3))):
        options = {} if scale is None else {"scale_range": (scale, scale)}
        means = []
        for transform, mirrored in (
            (A.Downscale(**options, p=1), False),
            (A.Downscale(**options, p=1), True),
            (A.Downscale(**options, interpolation_pair=smooth, p=1), False),
        ):
            means.append(np.mean([moved(transform, at, kind, mirrored) for at in spots], axis=0))
        print(f"{np.dtype(kind)}, scale {scale or 'by default'}: moved by", *(mean.round(2) + 0.0 for mean in means), "(nearest, mirrored, smooth)")
        assert np.allclose(means[0], expected, atol=0.05) and np.allclose(means[1], (-expected[0], expected[1]), atol=0.05)
        assert np.allclose(means[2], 0, atol=0.05)
PROGRAM
