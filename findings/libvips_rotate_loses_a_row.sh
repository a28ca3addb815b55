#!/usr/bin/env bash
# libvips 8.18.7 (pyvips 3.2.0): rotate by 90, 180 or 270 degrees moves the image by a pixel and puts a black row or column in place of a lost one.
# Believed: rotate(180) is what rot("d180") and both flips give, as all pixels fall on pixels. Seen: it is that moved by (1, 1), so that the first row
# and column are black and the last ones are gone; by 90 degrees it is moved to the right alone, by 270 down alone, in bytes and floats, for even and
# odd sizes, with the interpolators bilinear (the default), bicubic, lbb and nohalo. Boxes and masks that were turned otherwise are a pixel off.
# Turn by rot where the angle may be a right one.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import pyvips

print("libvips", ".".join(str(pyvips.version(part)) for part in range(3)))
random = np.random.default_rng(0)
for shape in ((60, 80), (61, 63)):
    for kind in (np.uint8, np.float32):
        pixels = random.integers(1, 256, shape).astype(kind)
        image = pyvips.Image.new_from_array(pixels)
        for angle, (down, right) in ((90, (0, 1)), (180, (1, 1)), (270, (1, 0))):
            turned = np.rot90(pixels, -angle // 90)
            assert np.array_equal(image.rot(f"d{angle}").numpy(), turned)
            moved = np.zeros_like(turned)
            moved[down:, right:] = turned[: len(turned) - down, : turned.shape[1] - right]
            for name in ("bilinear", "bicubic", "lbb", "nohalo"):
                result = image.rotate(angle, interpolate=pyvips.Interpolate.new(name)).numpy()
                assert np.allclose(result, moved, atol=1e-6) and not np.allclose(result, turned, atol=100)
            assert np.array_equal(image.rotate(angle).numpy(), image.rotate(angle, interpolate=pyvips.Interpolate.new("bilinear")).numpy())
            print(f"{shape}, {np.dtype(kind)}: rotate({angle}) is rot moved by {right} to the right and {down} down, the rest is 0")
PROGRAM
