#!/usr/bin/env bash
# libvips 8.18.7 (pyvips 3.2.0): shrink of bytes by 2 brightens by half a level, and by 3 darkens by two thirds; resize does so, too.
# Believed: the mean of a block is rounded to the nearest level, so that a thumbnail or a level of a pyramid is as bright as its image. Seen, for noise
# and for a smooth image: rows and columns are rounded one after the other, at 2 always up, at 3 always down, and the results are on average .50 levels
# too bright at 2, .25 at 4, and .66 too dark at 3 and .41 at 5; after four halvings noise has gained 2 levels. resize to a quarter, which
# shrinks first, is .5 too bright. In float32 there is no bias. Cast to float before, or round the mean by hand.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import pyvips

print("libvips", ".".join(str(pyvips.version(part)) for part in range(3)))
noise = np.random.default_rng(0).integers(0, 256, (240, 240)).astype(np.uint8)
waves = np.add.outer(np.sin(np.arange(240) / 20), np.cos(np.arange(240) / 15)) * 50 + 128
expected = {2: 0.5, 3: -0.66, 4: 0.25, 5: -0.41, 8: 0.13}
for name, pixels in (("noise", noise), ("waves", np.round(waves).astype(np.uint8))):
    image = pyvips.Image.new_from_array(pixels)
    for factor, bias in expected.items():
        means = pixels.reshape(240 // factor, factor, 240 // factor, factor).mean((1, 3))
        off = image.shrink(factor, factor).numpy() - means
        floating = image.cast("float").shrink(factor, factor).numpy() - means
        rounded = np.round(means) - means
        print(f"{name}, by {factor}: {off.mean():+.2f} levels on average, from {off.min():+.2f} to {off.max():+.2f};",
              f"means rounded once {rounded.mean():+.2f}; float32 {floating.mean():+.2f}")
        assert abs(off.mean() - bias) < (0.03 if name == "noise" else 0.16) and abs(floating).max() < 0.01
    for scale in (0.25, 0.125):
        off = image.resize(scale).numpy() - image.cast("float").resize(scale).numpy()
        print(f"{name}, resize to {scale}: {off.mean():+.2f} levels from the same in float32")
        assert 0.1 < off.mean() < 0.6 and (scale < 0.25 or off.mean() > 0.4)
image = pyvips.Image.new_from_array(noise)
for _ in range(4):
    image = image.shrink(2, 2)
print(f"noise after four halvings: {image.avg() - noise.mean():+.2f} levels")
assert 1.8 < image.avg() - noise.mean() < 2.2
PROGRAM
