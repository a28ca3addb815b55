#!/usr/bin/env bash
# libvips 8.18.7 (pyvips 3.2.0): sobel, prewitt and scharr give bytes for every image, so that edges in 0..1 are gone; of bytes diagonals are 41% too strong.
# Believed: a gradient of floats is floats, as gaussblur's is, and a fast way for bytes differs by rounding. Seen: of a float ramp from 0 to 1
# over 30 pixels the gradients are 0, 0 and 1, and of 16 bits all that is strong is 255. Of a ramp along x bytes and floats agree, 24 for three levels a
# pixel; of one along the diagonal, 3 levels in x and in y, bytes give 48, the sum of both derivatives, and floats 33, the length of 33.94 cut off.
# A threshold on edges of bytes depends on their direction.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvips[binary]==3.2.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import pyvips

print("libvips", *(pyvips.version(part) for part in range(3)))
along_x = np.tile(np.arange(30) * 3, (30, 1))
diagonal = along_x + along_x.T
unit = np.tile(np.linspace(0, 1, 30, dtype=np.float32), (30, 1))
wide = np.tile(np.arange(30) * 2000, (30, 1)).astype(np.uint16)
for name, scale in (("sobel", 8), ("prewitt", 6), ("scharr", 32)):
    outcome = []
    for image in (along_x.astype(np.uint8), along_x.astype(np.float32), diagonal.astype(np.uint8), diagonal.astype(np.float32), unit, wide):
        result = getattr(pyvips.Image.new_from_array(image), name)()
        assert result.format == "uchar"
        outcome.append(int(result.numpy()[15, 15]))
    print(f"{name}: along x bytes {outcome[0]}, floats {outcome[1]}; diagonal bytes {outcome[2]}, floats {outcome[3]}; 0..1 {outcome[4]}; 16 bits {outcome[5]}")
    length = scale * 3 * 2**0.5
    assert outcome[0] == outcome[1] == scale * 3
    assert outcome[3] == int(length) and outcome[2] == min(2 * scale * 3, 254)
    assert outcome[2] > 1.3 * outcome[3]
    assert outcome[4] <= 1 and outcome[5] == 255
PROGRAM
