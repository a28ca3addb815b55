#!/usr/bin/env bash
# keras 3.15.1 with torch 2.13.0: ops.image.gaussian_blur blurs columns and color channels, and no rows, unless data_format is given.
# Believed: without data_format it is keras.config.image_data_format(), channels_last, as the documentation says, whose example calls it so, and a flat
# image stays as it is. Seen: columns and channels are the two axes that are blurred, so that flat red becomes (.45, .27, 0), flat gray .5
# (.36, .5, .36), and a white dot a dash in one row. So it is with the backend jax (0.10.2), while numpy's is right, and so are all with
# data_format="channels_last", which blurs each color by itself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet keras==3.15.1 torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import os

os.environ["KERAS_BACKEND"] = "torch"
import keras
import numpy as np

print("keras", keras.__version__, "backend", keras.backend.backend(), "images are", keras.config.image_data_format())
assert keras.config.image_data_format() == "channels_last"
red, gray, dot = (np.zeros((1, 9, 9, 3), np.float32) for _ in range(3))
red[..., 0], gray[...], dot[0, 4, 4] = 1, 0.5, 1
side, middle, _ = np.exp(-(np.arange(-1, 2) ** 2) / 2) / np.exp(-(np.arange(-1, 2) ** 2) / 2).sum()
blurred_dot = np.zeros((9, 9, 3))
blurred_dot[3:6, 3:6] = np.outer([side, middle, side], [side, middle, side])[..., None]
for how, options in (("by default", {}), ("channels_last", {"data_format": "channels_last"})):
    images = [keras.ops.convert_to_numpy(keras.ops.image.gaussian_blur(image, **options))[0] for image in (red, gray, dot)]
    rows = np.flatnonzero(images[2].any(axis=(1, 2)))
    print(f"{how}: flat red becomes", images[0][4, 4].round(2), "flat gray", images[1][4, 4].round(2), "the dot covers rows", rows)
    if options:
        assert np.allclose(images[0][4, 4], [1, 0, 0], atol=1e-6) and np.allclose(images[1][4, 4], 0.5, atol=1e-6)
        assert np.allclose(images[2], blurred_dot, atol=1e-6)
    else:
        assert np.allclose(images[0][4, 4], [middle, side, 0], atol=1e-6)
        assert np.allclose(images[1][4, 4], [0.5 - side / 2, 0.5, 0.5 - side / 2], atol=1e-6) and list(rows) == [4]
PROGRAM
