#!/usr/bin/env bash
# ome-zarr 0.18.0: the coarser levels of a label map lie almost half a pixel before those of the image, by the metadata of both.
# Believed: write_image and write_labels, each with its defaults, give levels that lie on one another where scale and translation say, so that objects
# may be measured, shown and trained on at any level. Seen where each pixel holds its own column, or row: levels 2, 4, 8 and 16 of the image hold
# their positions, those of the labels what lies .5, 1.5, 3.5 and 7.5 pixels of the full image further right and down, and so it is in
# stacks. "nearest" keeps the last pixel of each block, labels[1::2, 1::2], whose place needs a translation of 1, 3, 7 and 15
# pixels, and those of means are written, .5 to 7.5.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ome-zarr==0.18.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import logging

import numpy as np
import ome_zarr
import zarr
from ome_zarr.writer import write_image, write_labels

logging.disable(logging.WARNING)
print("ome-zarr", ome_zarr.__version__)


def levels(group):
    """Factor, data and translation of each level."""
    attributes = dict(group.attrs)
    for level in attributes.get("ome", attributes)["multiscales"][0]["datasets"]:
        scale, translation = level["coordinateTransformations"]
        assert scale["type"] == "scale" and translation["type"] == "translation"
        yield int(scale["scale"][-1]), group[level["path"]][:], translation["translation"][-1]


for shape in ((256, 256), (4, 256, 256)):
    for axis in (-1, -2):
        place = np.indices(shape)[axis]
        store = zarr.group()
        write_image(place.astype(np.float32), store, axes="zyx"[-len(shape) :])
        write_labels(place.astype(np.int32), store, axes="zyx"[-len(shape) :], name="objects")
        for (factor, image, translation), level in zip(levels(store), levels(store["labels/objects"]), strict=True):
            assert (factor, translation) == (level[0], level[2]) and translation == (factor - 1) / 2
            where = np.indices(image.shape)[axis] * factor + translation
            inner = (..., slice(2, -2), slice(2, -2))
            off = (image - where)[inner], (level[1] - where)[inner]
            print(f"{shape}, axis {axis}, level {factor}: the image is", np.unique(off[0].round(2)) + 0.0, "off, the labels", np.unique(off[1]))
            assert np.allclose(off[0], 0, atol=0.01) and (off[1] == (factor - 1) / 2).all()
            assert np.array_equal(level[1], place[..., factor - 1 :: factor, factor - 1 :: factor])
PROGRAM
