#!/usr/bin/env bash
# imagecodecs 2026.3.6 (OpenJPEG 2.5.4), tifffile 2026.3.3: uint32 label maps in lossless JPEG 2000 come back with other labels, background 0 as 1.
# Believed: jpeg2k_encode is lossless by default, and what it has no room for raises, as 64 bits do. Seen: uint32 zeros of 64 x 64 come back as ones;
# of disks numbered from 1 on a background of 0, 64 x 64, 2041 of 4096 pixels are one too large, of 128 x 200 some labels become 262144. The
# same maps are exact in uint16, and in int32; int32 noise is exact up to 24 bits, and of 28 bits nearly every pixel is wrong. tifffile's
# compression="jpeg2000" loses labels of uint32 in the same way. Nothing warns. Store labels as uint16, or by another codec.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet imagecodecs==2026.3.6 tifffile==2026.3.3 numpy==2.4.6
"$folder/venv/bin/python" -W error - "$folder" <<'PROGRAM'
import sys

import imagecodecs
import numpy as np
import tifffile

print("imagecodecs", imagecodecs.__version__, imagecodecs.jpeg2k_version())


def wrong(image):
    back = imagecodecs.jpeg2k_decode(imagecodecs.jpeg2k_encode(image))
    assert back.dtype == image.dtype and back.shape == image.shape
    return back[back != image]


zeros = np.zeros((64, 64), np.uint32)
print("zeros of uint32 become", np.unique(wrong(zeros)), "in", wrong(zeros).size, "of 4096 pixels")
assert (wrong(zeros) == 1).all() and wrong(zeros).size == zeros.size
for height, width in ((64, 64), (128, 200)):
    y, x = np.mgrid[:height, :width]
    labels = np.zeros((height, width), np.uint32)
    centers = [(cx, cy) for cy in range(20, height - 10, 24) for cx in range(20, width - 10, 24)]
    for k, (cx, cy) in enumerate(centers):
        labels[np.hypot(x - cx, y - cy) < 9] = k + 1
    file = f"{sys.argv[1]}/labels.tif"
    tifffile.imwrite(file, labels, compression="jpeg2000", tile=(64, 64))
    lost = int((tifffile.imread(file) != labels).sum())
    print(f"{len(centers)} labels of uint32, {width} x {height}: {wrong(labels).size} of {labels.size} pixels wrong,", end=" ")
    print(f"labels up to {wrong(labels).max()}, {lost} pixels wrong in TIFF, {wrong(labels.astype(np.uint16)).size} as uint16,", end=" ")
    print(wrong(labels.astype(np.int32)).size, "as int32")
    assert wrong(labels).size > 1000 and lost > 1000
    assert not wrong(labels.astype(np.uint16)).size and not wrong(labels.astype(np.int32)).size
    if height == 128:
        assert wrong(labels).max() >= 262144
random = np.random.default_rng(0)
for bits in (16, 20, 24, 28, 31):
    noise = random.integers(0, 2**bits, (64, 64)).astype(np.int32)
    print(f"int32 noise of {bits} bits: {wrong(noise).size / noise.size:.1%} of the pixels wrong")
    assert not wrong(noise).size if bits <= 24 else wrong(noise).size > 0.99 * noise.size
PROGRAM
