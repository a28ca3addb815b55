#!/usr/bin/env bash
# volumentations-3D 1.0.4 (scipy 1.17.1): Rotate and ElasticTransform move volumes, by sizes, and by even ones the mask otherwise than the image.
# Believed: rotating is about the center, by 0 degrees it changes nothing, and image and mask stay together. Seen: true for sizes 4k + 1. For even
# ones, as most networks need them, Rotate by 0 and by 360 degrees and ElasticTransform without deformation move the image by -.5 voxels along
# all three axes (a peak of 1 becomes .88, the last planes are empty) and the mask by -1; by 90 degrees they come .5 apart as well. For sizes 4k + 3
# both move by -1. Coordinates are taken from (n - 1) / 2 and put back by n / 2, rounded to an even number, and ties of "nearest" fall to one side.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet volumentations-3D==1.0.4 opencv-python==5.0.0.93 scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import warnings
from importlib.metadata import version

import numpy as np

warnings.simplefilter("ignore")
import volumentations

print("volumentations-3D", version("volumentations-3D"))
transforms = {
    "Rotate by 0": volumentations.Rotate((0, 0), (0, 0), (0, 0), p=1),
    "Rotate by 360": volumentations.Rotate((0, 0), (0, 0), (360, 360), p=1),
    "Rotate by 90": volumentations.Rotate((0, 0), (0, 0), (90, 90), p=1),
    "ElasticTransform without deformation": volumentations.ElasticTransform((0, 0), p=1),
}


def center(volume):
    return np.array([(volume * axis).sum() / volume.sum() for axis in np.indices(volume.shape)])


for shape, by_image, by_mask in (((41, 37, 33), 0, 0), ((40, 36, 32), -0.5, -1), ((42, 38, 34), -0.5, -1), ((43, 39, 35), -1, -1)):
    position = (np.array(shape) - 1) // 2 + (-3, 2, 1)
    squares = sum((axis - at) ** 2 for axis, at in zip(np.indices(shape), position))
    image = np.exp(-squares / 12).astype(np.float32)
    mask = (image > 0.5).astype(np.uint8)
    for name, transform in transforms.items():
        result = volumentations.Compose([transform], p=1)(image=image.copy(), mask=mask.copy())
        of_image, of_mask = center(result["image"]) - position, center(result["mask"]) - position
        peak, empty = result["image"].max(), bool((result["image"][:, :, -1] == 0).all())
        print(f"{shape}, {name}: image moved by {np.round(of_image, 2) + 0.0}, mask by {np.round(of_mask, 2) + 0.0},")
        print(f"    peak {peak:.2f}, last plane empty: {empty}")
        assert np.allclose(abs(of_image - of_mask), abs(by_image - by_mask), atol=0.03) and empty == (by_image < 0)
        assert abs(peak - (0.885 if by_image == -0.5 else 1)) < 0.01
        if name != "Rotate by 90":
            assert np.allclose(of_image, by_image, atol=0.03) and np.allclose(of_mask, by_mask, atol=0.03)
PROGRAM
