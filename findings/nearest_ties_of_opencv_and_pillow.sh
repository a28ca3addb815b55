#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93 and Pillow 13.0.0: nearest resizing takes the pixel before or after a tie, by no rule.
# Believed: INTER_NEAREST_EXACT and Image.NEAREST sample the nearest pixel center by exact arithmetic, and a tie, where a
# result pixel lies halfway between two, always falls to the same side. Seen: of the 32 ties of 640 -> 224, 12 take the later pixel
# and 20 the earlier one, of 128 at 512 -> 384 54 and 74; both libraries agree with one another. torch 2.13.0's "nearest-exact" takes the later one at
# all of these. Labels that were resized by one library and images by the other differ by a pixel in a tenth of the columns.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 pillow==13.0.0 numpy==2.4.6 torch==2.13.0
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
from fractions import Fraction

import cv2
import numpy as np
import torch
from PIL import Image

for n, m, later in ((640, 224, 12), (256, 96, 15), (512, 384, 54)):
    line = np.arange(n, dtype=np.float32)[None]
    places = [Fraction(2 * i + 1, 2) * Fraction(n, m) for i in range(m)]
    nearest = np.array([int(place) for place in places])  # the later one where two are as near
    ties = np.array([place.denominator == 1 for place in places])
    results = {
        "OpenCV": cv2.resize(line, (m, 1), interpolation=cv2.INTER_NEAREST_EXACT)[0],
        "Pillow": np.asarray(Image.fromarray(line).resize((m, 1), Image.NEAREST))[0],
        "torch": torch.nn.functional.interpolate(torch.from_numpy(line)[None], m, mode="nearest-exact")[0, 0].numpy(),
    }
    for name, result in results.items():
        after, before = (result[ties] == nearest[ties]).sum(), (result[ties] == nearest[ties] - 1).sum()
        print(f"{n} -> {m}, {ties.sum()} ties: {name} takes the later pixel {after} times, the earlier one {before} times")
        assert (result[~ties] == nearest[~ties]).all() and after + before == ties.sum()
        assert after == (ties.sum() if name == "torch" else later)
PROGRAM
