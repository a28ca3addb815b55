#!/usr/bin/env bash
# keras 3.15.1 (jax 0.10.2): RandomShear shears boxes by another angle than the image, unless that is square.
# Believed: x_factor moves rows of the image and corners of boxes by the same number of pixels a row. Seen of x_factor=.2 in images of 96 x 120: the
# image goes .2 pixels a row, the box .25, so that it lies 2 pixels beside an object in row 40 and 4 in row 80, in 240 x 320 3 and 5, and in 320 x
# 240 2 and 4 to the other side. y_factor=.2 is .16 for boxes in 96 x 120 and .27 in 320 x 240: 8 pixels in the middle. Boxes are sheared as
# fractions of the image, whose width and height differ, and get wider by the wrong amount, too. In 96 x 96 both agree, within a tenth of a pixel.
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


def both(layer, shape, place):
    """The center of the object and of its box, as a pixel, and the box's width and height."""
    y, x = np.indices(shape)
    spot = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / 12).astype(np.float32)
    box = np.array([place[0] - 5, place[1] - 5, place[0] + 6, place[1] + 6], np.float32)
    data = {"images": np.repeat(spot[..., None], 3, 2)[None], "bounding_boxes": {"boxes": box[None, None], "labels": np.zeros((1, 1))}}
    result = layer(data, training=True)
    image = np.asarray(result["images"])[0, ..., 0]
    at = np.array([(image * axis).sum() / image.sum() for axis in np.indices(shape)[::-1]])
    corners = np.asarray(result["bounding_boxes"]["boxes"])[0, 0].reshape(2, 2)
    return at, corners.mean(0) - 0.5, corners[1] - corners[0]


options = {"fill_mode": "constant", "data_format": "channels_last", "bounding_box_format": "xyxy", "seed": 1}
for shape in ((96, 96), (96, 120), (240, 320), (320, 240)):
    for factors in ((0.2, 0), (0, 0.2)):
        for place in ((shape[1] // 2, 40), (shape[1] // 2, 80)):
            layer = keras.layers.RandomShear((factors[0], factors[0]), (factors[1], factors[1]), **options)
            at, boxed, size = both(layer, shape, place)
            moved, boxes_moved = at - place, boxed - place
            print(
                f"{shape[0]} x {shape[1]}, x and y by {factors}, object at {place}: it moves by {moved.round(2)}, its box by",
                boxes_moved.round(2),
            )
            axis = 0 if factors[0] else 1
            ratio = shape[1] / shape[0] if axis == 0 else shape[0] / shape[1]
            lever = place[1 - axis]
            assert abs(abs(moved[axis]) - 0.2 * lever) < 0.05
            assert abs(abs(boxes_moved[axis]) - 0.2 * ratio * (lever + 0.5)) < 0.05
            assert abs(size[axis] - 11 * (1 + 0.2 * ratio)) < 0.05
PROGRAM
