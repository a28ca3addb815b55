#!/usr/bin/env bash
# ome-zarr 0.18.0: write_image takes of the numbers in scale_factors only how many there are, and write_labels nothing at all.
# Believed: what the documentation says, that scale_factors are "the downsampling factors for each pyramid level", and that a list of numbers applies to
# all spatial axes but z, so that labels written with the factors of their image have its levels. Seen: (4, 16), (3, 9) and (2, 8, 32) give
# images levels at 2, 4 and 8, as many as there are numbers: what was to have a sixteenth of the width has a quarter, and sixteen times the pixels.
# Dictionaries, {"y": 4, "x": 4}, are kept. Labels have levels at 2, 4, 8 and 16 whatever is passed, and those of images with scaler=None, which is
# deprecated. Nothing warns, and the metadata fits what was written.
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
pixels = np.zeros((576, 576), np.uint8)


def levels(group):
    attributes = dict(group.attrs)
    datasets = attributes.get("ome", attributes)["multiscales"][0]["datasets"][1:]
    factors = [int(level["coordinateTransformations"][0]["scale"][1]) for level in datasets]
    assert [group[level["path"]].shape[1] for level in datasets] == [576 // factor for factor in factors]
    return factors


for factors in ([4], [4, 16], [3, 9], [2, 8, 32]):
    for named in (False, True):
        asked = [{"y": factor, "x": factor} for factor in factors] if named else factors
        store = zarr.group()
        write_image(pixels, store, axes="yx", scale_factors=asked)
        write_labels(pixels, store, axes="yx", name="default", scale_factors=asked)
        write_labels(pixels, store, axes="yx", name="without", scale_factors=asked, scaler=None)
        image, default, without = (levels(store[path]) for path in ("/", "labels/default", "labels/without"))
        print("dictionaries" if named else "numbers", factors, "- image:", image, "labels:", default, "labels with scaler=None:", without)
        assert image == without == (factors if named else [2, 4, 8][: len(factors)]) and default == [2, 4, 8, 16]
PROGRAM
