#!/usr/bin/env bash
# dask-image 2026.5.0: filters with mode="wrap" wrap chunks around and not the image, so that the seam of a panorama shows.
# Believed: chunks are a matter of storage, and a filter gives what scipy.ndimage gives of the whole image, as these do with the four other modes. Seen: with
# "wrap" a pixel near the left border takes its neighbors from the right end of its own chunk, with what that overlaps, in place of the image's: a
# Gaussian of sigma 2 of 64 x 64 periodic pixels in chunks of 16 or 32 is up to a fifth of the range off within 8 pixels of the border, where one
# chunk is right, and so are uniform, median and maximum filters, sobel and laplace. da.pad(mode="wrap"), filter and crop is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet dask-image==2026.5.0 dask==2026.8.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
from importlib.metadata import version

import dask.array as da
import numpy as np
from dask_image import ndfilters
from scipy import ndimage

print("dask-image", version("dask-image"), "dask", version("dask"))
image = ndimage.gaussian_filter(np.random.default_rng(0).random((64, 64)), 2, mode="wrap")
image = (image - image.min()) / np.ptp(image)
filters = {
    "gaussian_filter": {"sigma": 2},
    "uniform_filter": {"size": 5},
    "median_filter": {"size": 5},
    "maximum_filter": {"size": 5},
    "sobel": {},
    "laplace": {},
}


def wrong(name, mode, chunk):
    seen = getattr(ndfilters, name)(da.from_array(image, chunks=(chunk, chunk)), mode=mode, **filters[name]).compute()
    return abs(seen - getattr(ndimage, name)(image, mode=mode, **filters[name]))


for name in filters:
    others = max(wrong(name, mode, 16).max() for mode in ("reflect", "mirror", "nearest", "constant"))
    off = {chunk: wrong(name, "wrap", chunk) for chunk in (64, 32, 16)}
    print(
        f"{name}: other modes {others:.0e}; wrap, by chunk:",
        {chunk: f"{d.max():.3f} at {(d > 1e-9).mean():.0%}" for chunk, d in off.items()},
    )
    assert others < 1e-12 and off[64].max() < 1e-12 < 0.05 < min(off[32].max(), off[16].max())
off = wrong("gaussian_filter", "wrap", 16)
jump = {chunk: 0.0 for chunk in (64, 16)}
for chunk in jump:
    blurred = ndfilters.gaussian_filter(da.from_array(image, chunks=(chunk, chunk)), sigma=2, mode="wrap").compute()
    jump[chunk] = abs(blurred[:, 0] - blurred[:, -1]).max()
print(
    f"off by {off[8:-8, 8:-8].max()} further inside; step from the last column to the first: {jump[64]:.3f} of one chunk, {jump[16]:.3f} of chunks of 16"
)
assert off[8:-8, 8:-8].max() < 1e-12 and jump[16] > 3 * jump[64]

source = da.from_array(image, chunks=(16, 16))
padded = ndfilters.gaussian_filter(da.pad(source, 8, mode="wrap"), sigma=2)[8:-8, 8:-8].compute()
print("padded first, off by", abs(padded - ndimage.gaussian_filter(image, 2, mode="wrap")).max())
assert np.allclose(padded, ndimage.gaussian_filter(image, 2, mode="wrap"))
PROGRAM
