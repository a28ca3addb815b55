#!/usr/bin/env bash
# monai 1.6.1: smoothing reads zeros around the image, so anti-aliased resizing darkens borders and sharpening brightens them.
# Believed: Resize(anti_aliasing=True) keeps an image of one value, as scikit-image's resize does, to which its documentation points and whose
# standard deviation it takes. Seen: of ones, 64 x 64, the corner becomes .85 at 32 x 32, .80 at 16 and .76 at 8, edges .92 to .87, the mean
# .99 to .94; scikit-image 0.26.0 gives 1. GaussianSmooth(2) leaves .36 in the corner, and GaussianSharpen with its defaults makes it 4.19. Networks see
# a dark frame that images which are resized without anti-aliasing do not have. Pad by the edge before, and crop behind.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet monai==1.6.1 torch==2.13.0 numpy==2.2.6 scikit-image==0.26.0
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy
import torch
from monai.transforms import GaussianSharpen, GaussianSmooth, Resize
from skimage.transform import resize

ones = torch.ones(1, 64, 64)
for side, corner, edge, mean in ((32, 0.846, 0.920, 0.990), (16, 0.804, 0.897, 0.974), (8, 0.759, 0.871, 0.936)):
    small = Resize((side, side), mode="bilinear", anti_aliasing=True)(ones)[0]
    plain = Resize((side, side), mode="bilinear")(ones)
    peer = resize(numpy.ones((64, 64)), (side, side), anti_aliasing=True)
    seen = [float(small[0, 0]), float(small[0, side // 2]), float(small.mean())]
    print(f"64 -> {side}: corner {seen[0]:.3f}, edge {seen[1]:.3f}, mean {seen[2]:.3f}; scikit-image at least {peer.min():.3f}")
    assert all(abs(a - b) < 2e-3 for a, b in zip(seen, (corner, edge, mean)))
    assert abs(plain - 1).max() < 1e-5 and abs(peer - 1).max() < 1e-6 and abs(small[side // 2, side // 2] - 1) < 1e-3
smooth, sharp = float(GaussianSmooth(2.0)(ones)[0, 0, 0]), float(GaussianSharpen()(ones)[0, 0, 0])
print(f"corner by GaussianSmooth(2) {smooth:.3f}, by GaussianSharpen() {sharp:.3f}")
assert abs(smooth - 0.358) < 2e-3 and abs(sharp - 4.188) < 2e-3
PROGRAM
