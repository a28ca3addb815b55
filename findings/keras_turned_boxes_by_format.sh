#!/usr/bin/env bash
# keras 3.15.1 (jax 0.10.2): RandomRotation and RandomPerspective read boxes of every format as xyxy; a turn by 0 degrees replaces them.
# Believed: bounding_box_format says how boxes are written, and these come back in it, as with RandomFlip and RandomTranslation, whose results agree
# in all eight formats. Seen: boxes go in as corners in pixels whatever the format, and out in the one that was named. By 0 degrees "xyxy" stays,
# and of the others x and y come back exchanged ("yxyx"), a box of 11 x 11 pixels as one of 34 x 24 ("xywh") or 40 x 30 ("center_xywh"), each
# elsewhere, and relative boxes as a tenth of a pixel in the upper left corner. RandomPerspective does the same. And with "xyxy" boxes turn about
# another center than the image: by 180 degrees they are a pixel up and to the left of their objects, by 90 degrees one up.
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
spot = np.exp(-((x - 50) ** 2 + (y - 40) ** 2) / 12).astype(np.float32)
corners = np.array([45.0, 35, 56, 46])
scale = {"x": width, "y": height}


def encode(box, name):
    x1, y1, x2, y2 = box
    kind = name.removeprefix("rel_")
    if kind == "xyxy":
        values = x1, y1, x2, y2
    elif kind == "yxyx":
        values = y1, x1, y2, x2
    elif kind == "xywh":
        values = x1, y1, x2 - x1, y2 - y1
    else:
        values = (x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1
    axes = "yxyx" if kind == "yxyx" else "xyxy"
    return np.array([v / scale[axis] if name.startswith("rel_") else v for v, axis in zip(values, axes)], np.float32)


def decode(values, name):
    kind = name.removeprefix("rel_")
    axes = "yxyx" if kind == "yxyx" else "xyxy"
    a, b, c, d = (v * scale[axis] if name.startswith("rel_") else v for v, axis in zip(values, axes))
    if kind == "xyxy":
        box = a, b, c, d
    elif kind == "yxyx":
        box = b, a, d, c
    elif kind == "xywh":
        box = a, b, a + c, b + d
    else:
        box = a - c / 2, b - d / 2, a + c / 2, b + d / 2
    return np.array(box, float)


def turned(layer):
    boxes = encode(corners, layer.bounding_box_format)[None, None]
    data = {"images": np.repeat(spot[..., None], 3, 2)[None], "bounding_boxes": {"boxes": boxes, "labels": np.zeros((1, 1))}}
    result = layer(data, training=True)
    image = np.asarray(result["images"])[0, ..., 0]
    at = np.array([(image * axis).sum() / image.sum() for axis in np.indices(image.shape)[::-1]])
    return at, decode(np.asarray(result["bounding_boxes"]["boxes"])[0, 0], layer.bounding_box_format)


kinds = ("xyxy", "yxyx", "xywh", "center_xywh")
formats = [*kinds, *("rel_" + kind for kind in kinds)]
layers = {
    "RandomFlip": lambda **options: keras.layers.RandomFlip("horizontal", seed=1, **options),
    "RandomTranslation": lambda **options: keras.layers.RandomTranslation((0.1, 0.1), (0.1, 0.1), fill_mode="constant", **options),
    "RandomRotation by 0": lambda **options: keras.layers.RandomRotation((0.0, 0.0), fill_mode="constant", **options),
    "RandomPerspective": lambda **options: keras.layers.RandomPerspective(1.0, scale=0.3, seed=0, **options),
}
for name, make in layers.items():
    seen = {kind: turned(make(data_format="channels_last", bounding_box_format=kind))[1] for kind in formats}
    print(name, {kind: box.round(2).tolist() for kind, box in seen.items()})
    same = [np.allclose(box, seen["xyxy"], atol=0.01) for box in seen.values()]
    assert all(same) if name in ("RandomFlip", "RandomTranslation") else sum(same) == 1
    if name == "RandomRotation by 0":
        assert np.allclose(seen["xyxy"], corners) and np.allclose(seen["yxyx"], corners[[1, 0, 3, 2]])
        assert np.allclose(seen["xywh"], [11, 11, 45, 35]) and np.allclose(seen["center_xywh"][2:] - seen["center_xywh"][:2], [39.5, 29.5])
        assert np.abs(seen["rel_xyxy"]).max() < 1
for part, off in ((0, (0, 0)), (0.25, (0, -1)), (0.5, (-1, -1))):
    layer = keras.layers.RandomRotation((part, part), fill_mode="constant", data_format="channels_last", bounding_box_format="xyxy")
    at, box = turned(layer)
    center = (box[:2] + box[2:]) / 2 - 0.5
    print(f"xyxy by {360 * part:.0f} degrees: object at {at.round(2)}, center of its box {center.round(2)}")
    assert np.allclose(center - at, off, atol=0.02)
PROGRAM
