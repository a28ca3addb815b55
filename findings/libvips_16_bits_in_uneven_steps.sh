#!/usr/bin/env bash
# libvips 8.18.7 (pyvips 3.2.0): bytes that become 16 bits by colourspace("rgb16") or cast("ushort", shift=True) lie in steps of 1 and of 511.
# Believed: a level of 8 bits is 257 of 16, as in the other direction, or 256, and equal steps stay equal, as with colourspace("grey16"), which is
# 257 throughout. Seen: 0, 1, 2, 3 become 0, 511, 512, 1023, as the lowest bit fills the lower byte: each odd level is one below the next even
# one. So what is computed from there on, a gradient, a difference of frames or a contrast stretch, finds pairs of levels and edges between them, and
# the same gray image is up to 254 of 65535 apart in its "rgb16" and in its "grey16". Saved by pngsave(bitdepth=16) it is in even steps.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvips[binary]==3.2.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import pyvips

print("libvips", *(pyvips.version(part) for part in range(3)))
gray = pyvips.Image.new_from_array(np.tile(np.arange(256, dtype=np.uint8), (4, 1))).copy(interpretation="b-w")
color = gray.bandjoin([gray, gray]).copy(interpretation="srgb")
results = {
    "rgb16 of sRGB": color.colourspace("rgb16"),
    "rgb16 of gray": gray.colourspace("rgb16"),
    "cast with shift": gray.cast("ushort", shift=True),
    "grey16": gray.colourspace("grey16"),
    "PNG of 16 bits": pyvips.Image.new_from_buffer(gray.pngsave_buffer(bitdepth=16), ""),
}
for name, result in results.items():
    levels = result.numpy()[0].reshape(256, -1)[:, 0].astype(int)
    steps = np.unique(np.diff(levels))
    print(f"{name}: {levels[:4]} to {levels[-1]}, steps {steps}, up to {abs(levels - 257 * np.arange(256)).max()} from 257 times the level")
    assert result.format == "ushort" and levels[-1] == 65535
    if name in ("grey16", "PNG of 16 bits"):
        assert np.array_equal(levels, 257 * np.arange(256))
    else:
        assert steps.tolist() == [1, 511]
        assert np.array_equal(levels, 256 * np.arange(256) + 255 * (np.arange(256) % 2))
PROGRAM
