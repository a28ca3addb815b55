#!/usr/bin/env bash
# ngff-zarr 0.50.0: by dask_image_gaussian and dask_image_nearest the levels of a pyramid lie almost half a pixel of theirs off the image.
# Believed: the methods of to_multiscales differ in sharpness, and what is found in a level is where its scale and translation say, so that labels made
# by one method lie on images made by another. Seen: all methods write translations of .5, 1.5 and 3.5 for the levels 2, 4 and 8, as means of
# blocks need them, and a spot is at its place in those of itkwasm_gaussian and of bin shrinking, and of the two that take the most frequent label; the
# Gaussian and the nearest pixel of dask-image are taken at the pixels 0, 2, 4 and so on, so that a spot lies .5, 1.5 and 3.5 pixels too far right and down.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ngff-zarr==0.50.0 dask-image==2026.5.0 dask==2026.8.0 zarr==3.1.6 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
from importlib.metadata import version

import ngff_zarr
import numpy as np

print("ngff-zarr", version("ngff-zarr"))
y, x = np.mgrid[:128, :160]
off_center = ("DASK_IMAGE_GAUSSIAN", "DASK_IMAGE_NEAREST")
for name in ("ITKWASM_GAUSSIAN", "ITKWASM_BIN_SHRINK", "DASK_BIN_SHRINK", "DASK_IMAGE_MODE", "ITKWASM_LABEL_IMAGE", *off_center):
    moved = []
    for phase in (0, 2, 4, 6):  # spread over a pixel of the coarsest level
        at = np.array([58 + phase, 75 + phase])
        spot = np.exp(-((y - at[0]) ** 2 + (x - at[1]) ** 2) / 200).astype(np.float32)
        image = ngff_zarr.to_ngff_image(spot, dims=["y", "x"])
        levels = ngff_zarr.to_multiscales(image, scale_factors=[2, 4, 8], method=ngff_zarr.Methods[name]).images
        assert [level.translation["x"] for level in levels] == [0, 0.5, 1.5, 3.5]
        places = []
        for level in levels[1:]:
            weight = np.asarray(level.data).astype(float)
            centers = [(weight * axis).sum() / weight.sum() for axis in np.indices(weight.shape)]
            places.append([level.translation[k] + level.scale[k] * center for k, center in zip("yx", centers)])
        moved.append(np.array(places) - at)
    mean = np.mean(moved, 0)
    print(f"{name}: in the levels 2, 4 and 8 a spot is moved by", mean.round(2).tolist())
    expected = np.array([0.5, 1.5, 3.5])[:, None] if name in off_center else 0
    assert np.allclose(mean, expected, atol=0.05)
PROGRAM
