#!/usr/bin/env bash
# keras 3.15.1 (jax 0.10.2): RandomCrop moves boxes by the wrong offsets, the row's in x and the column's in y.
# Believed: a layer that takes {"images", "bounding_boxes"} crops both alike, so that a box lies around its object, as it does with CenterCrop and
# RandomTranslation. Seen of an object of 11 x 11 pixels and crops of 80 x 100 of 96 x 120: the box is up to 13 pixels from the object, as far to
# the right as up or the other way, and fits only where row and column of the window happen to be equal; the window's row is taken from x and its
# column from y, exactly. Relative boxes, "rel_xyxy", are taken times the size of the crop in place of the image's, and are too small as well.
# Nothing is raised, and the boxes look plausible.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet keras==3.15.1 jax==0.10.2 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import os

os.environ["KERAS_BACKEND"] = "jax"
import keras
import numpy as np

print("keras", keras.__version__)
height, width = 96, 120
y, x = np.mgrid[:height, :width]
spot = np.exp(-((x - 60) ** 2 + (y - 45) ** 2) / 12).astype(np.float32)
box = np.array([[55, 40, 66, 51]], np.float32)  # around the spot, in edges of pixels


def both(layer, boxes):
    """The center of the object and of its box, as a pixel, and the box's size."""
    data = {"images": np.repeat(spot[..., None], 3, 2)[None], "bounding_boxes": {"boxes": boxes[None], "labels": np.zeros((1, 1))}}
    result = layer(data, training=True)
    image = np.asarray(result["images"])[0, ..., 0]
    size = np.array(image.shape[::-1])
    seen = np.array([(image * axis).sum() / image.sum() for axis in np.indices(image.shape)[::-1]])
    corners = np.asarray(result["bounding_boxes"]["boxes"])[0, 0].reshape(2, 2)
    if layer.bounding_box_format == "rel_xyxy":
        corners = corners * size
    return seen, corners.mean(0) - 0.5, corners[1] - corners[0]


xyxy = {"data_format": "channels_last", "bounding_box_format": "xyxy"}
apart = []
for seed in range(8):
    at, boxed, size = both(keras.layers.RandomCrop(80, 100, seed=seed, **xyxy), box)
    left, top = np.array([60, 45]) - np.round(at)
    print(f"window from row {top:2.0f}, column {left:2.0f}: object at {np.round(at, 1)}, center of its box {boxed}")
    assert np.allclose(boxed, [60 - top, 45 - left], atol=0.01) and np.allclose(at, np.round(at), atol=0.05)
    assert np.allclose(size, 11)
    apart.append(np.abs(at - boxed).max())
print(f"apart by {np.round(apart).astype(int).tolist()} pixels")
assert max(apart) > 10
relative = dict(xyxy, bounding_box_format="rel_xyxy")
at, boxed, size = both(keras.layers.RandomCrop(80, 100, seed=1, **relative), box / [width, height, width, height])
print(f"rel_xyxy: object at {np.round(at, 1)}, center of its box {boxed.round(1)}, of {size.round(1)} pixels")
assert np.abs(at - boxed).max() > 1 and np.allclose(size, np.array([11 * 100 / 120, 11 * 80 / 96]), atol=0.01)
for layer in (
    keras.layers.CenterCrop(80, 100, **xyxy),
    keras.layers.RandomTranslation((0.1, 0.1), (0.1, 0.1), fill_mode="constant", **xyxy),
):
    at, boxed, size = both(layer, box)
    print(f"{type(layer).__name__}: object at {np.round(at, 1)}, center of its box {boxed.round(1)}")
    assert np.allclose(at, boxed, atol=0.05) and np.allclose(size, 11, atol=0.01)
PROGRAM
