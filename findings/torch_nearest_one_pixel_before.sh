#!/usr/bin/env bash
# torch 2.13.0 (CPU): F.interpolate(mode="nearest") reads one pixel too early at some places of some sizes, of float64 images, too.
# Believed: result pixel i of m is source pixel floor(i n / m) of n, as cv2.resize and the documentation of ONNX's "floor" have it,
# so that labels shrunk by torch and by OpenCV are the same. Seen: the ratio n / m is rounded to float32 first, whatever the type of
# the image. Where that rounds down and i n / m is whole, the pixel before is read: three of the 96 columns of a label map of 224.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy==2.4.6 opencv-python-headless==5.0.0.93
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import torch

print("torch", torch.__version__, "OpenCV", cv2.__version__)
seen = {}
for n, m in ((84, 100), (168, 100), (210, 100), (212, 100), (200, 100), (224, 96)):
    columns = torch.arange(n, dtype=torch.float64)
    exact = np.arange(m) * n // m
    of_torch = torch.nn.functional.interpolate(columns[None, None, None], (1, m), mode="nearest")[0, 0, 0].numpy().astype(int)
    of_opencv = cv2.resize(columns[None].numpy(), (m, 1), interpolation=cv2.INTER_NEAREST)[0].astype(int)
    seen[n, m] = [(int(i), int(of_torch[i]), int(exact[i])) for i in np.flatnonzero(of_torch != exact)]
    print(f"{n} -> {m}: (result, read by torch, exact) {seen[n, m]}; OpenCV differs from exact at {(of_opencv != exact).sum()}")
    assert (of_opencv == exact).all()
assert seen[210, 100] == [(30, 62, 63), (50, 104, 105), (60, 125, 126), (90, 188, 189)]
assert seen[84, 100] == [(75, 62, 63)] and seen[168, 100] == [(75, 125, 126)]
assert seen[224, 96] == [(27, 62, 63), (51, 118, 119), (54, 125, 126)] and seen[200, 100] == []
PROGRAM
