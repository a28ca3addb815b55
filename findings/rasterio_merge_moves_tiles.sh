#!/usr/bin/env bash
# rasterio 1.4.4: merge puts tiles whose grids differ by a fraction of a pixel up to .75 pixels off their place, also with resampling=bilinear.
# Believed: a mosaic shows each tile where its transform says, within half a pixel by nearest, and exactly by Resampling.bilinear, as reproject and
# WarpedVRT do. Seen of two tiles of one ramp, the second .25, .5 or .75 pixels off the grid of the first: by nearest its content is as
# much too far left, .75 too, where reproject is .25 off; by bilinear it is .24 and .48 off at the tile's beginning and right at its end, a
# stretch, and .75 off all over. The seam shows it, and what is measured across it is too short. Reproject tiles to one grid before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet rasterio==1.4.4 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.io import MemoryFile
from rasterio.merge import merge
from rasterio.transform import from_origin
from rasterio.warp import reproject

print("rasterio", rasterio.__version__)


def tile(first_column):
    """A tile of 60 x 80 pixels of 10 meters, whose values are their own column in the scene."""
    values = np.tile(1 + first_column + np.arange(80), (60, 1)).astype(np.float32)
    profile = {"driver": "GTiff", "height": 60, "width": 80, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    file = MemoryFile()
    with file.open(**profile, transform=from_origin(10 * first_column, 600, 10, 10)) as dataset:
        dataset.write(values, 1)
    return file.open()


for fraction in (0, 0.25, 0.5, 0.75):
    first, second = tile(0), tile(40 + fraction)
    for how in (Resampling.nearest, Resampling.bilinear):
        mosaic, transform = merge([second, first], resampling=how)
        assert transform.c == 0 and transform.a == 10
        off = mosaic[0, 30] - 1 - np.arange(mosaic.shape[2])  # by how many columns what is shown comes from further right
        direct = np.zeros((60, 120), np.float32)
        reproject(rasterio.band(second, 1), direct, dst_transform=transform, dst_crs=second.crs, resampling=how)
        direct_off = direct[30, 42:118] - 1 - np.arange(42, 118)
        print(f"{fraction} pixels, {how.name}: first tile {abs(off[:40]).max():.2f} off,", end=" ")
        print(f"second {off[42]:.2f} at its beginning and {off[117]:.2f} at its end, by reproject {abs(direct_off).max():.2f}")
        assert abs(off[:40]).max() < 1e-4
        assert abs(direct_off).max() <= (0.5 if how == Resampling.nearest else 0.01)
        if how == Resampling.nearest or fraction > 0.5:
            assert np.allclose(off[[42, 117]], fraction, atol=0.01)
        else:
            assert np.isclose(off[42], fraction, atol=0.05) and abs(off[117]) < 0.05
PROGRAM
