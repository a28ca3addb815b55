#!/usr/bin/env bash
# rasterio 1.4.4 (GDAL 3.10.3): the resampling "gauss" moves the content up and to the left, by .5, 1.5 and 3.5 pixels in overviews.
# Believed: the methods of build_overviews and of read(out_shape=...) differ in sharpness alone, and a coarser level covers the same ground; gauss is
# smooth and symmetric. Seen on a ramp, 64 pixels wide: overviews 2, 4 and 8 made by gauss hold what lies .5, 1.5 and 3.5 pixels of the source further to
# the right and below, almost half a pixel of the level in the end; those by average, bilinear, cubic and lanczos are centered. Read at half, a
# quarter and an eighth of the size, gauss is .5 pixels off, at 1.5 to 3 times the size up to a whole one. Mirrored images do not have
# mirrored overviews.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet rasterio==1.4.4 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import warnings

import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.io import MemoryFile

warnings.simplefilter("ignore")
print("rasterio", rasterio.__version__, "GDAL", rasterio.__gdal_version__)
ramp = np.tile(np.arange(64, dtype=np.float32), (64, 1))


def off(result):
    """How far to the right what a pixel shows lies, in pixels of the source, away from the borders."""
    n = len(result)
    centers = (np.arange(n) + 0.5) * 64 / n - 0.5
    edge = max(2, n // 8)
    return float((result[n // 2] - centers)[edge:-edge].mean())


def levels(image, method):
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", width=64, height=64, count=1, dtype="float32") as file:
            file.write(image, 1)
            file.build_overviews([2, 4, 8], Resampling[method])
        for level in range(3):
            with memory.open(overview_level=level) as file:
                yield file.read(1)


def read(image, size, method):
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", width=64, height=64, count=1, dtype="float32") as file:
            file.write(image, 1)
        with memory.open() as file:
            return file.read(1, out_shape=(size, size), resampling=Resampling[method])


for method in ("average", "bilinear", "cubic", "lanczos", "gauss"):
    columns = [off(level) for level in levels(ramp, method)]
    rows = [off(level.T) for level in levels(ramp.T.copy(), method)]
    at_reading = [off(read(ramp, size, method)) for size in (32, 16, 8, 96, 128, 192)]
    print(f"{method}: overviews", np.round(columns, 3), np.round(rows, 3), "read at 1/2, 1/4, 1/8, 1.5, 2, 3", np.round(at_reading, 3))
    assert np.allclose(columns, [0.5, 1.5, 3.5] if method == "gauss" else 0, atol=0.02) and np.allclose(columns, rows, atol=0.02)
    if method == "gauss":
        assert np.allclose(at_reading[:3], 0.5, atol=0.02) and 0.9 < max(at_reading[3:]) < 1.1
    else:
        assert np.allclose(at_reading, 0, atol=0.02)
bump = np.exp(-((np.arange(64) - 31.5) ** 2 + (np.arange(64)[:, None] - 31.5) ** 2) / 200).astype(np.float32)
for method in ("average", "gauss"):
    eighth = list(levels(bump, method))[2]
    print(method, "level 8 of a centered bump, the middle row:", eighth[3].round(2))
    assert np.allclose(eighth, eighth[:, ::-1], atol=1e-5) == (method == "average")
PROGRAM
