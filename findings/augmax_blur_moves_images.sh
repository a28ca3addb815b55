#!/usr/bin/env bash
# augmax 0.4.1 (jax 0.10.2): GaussianBlur moves the image half a pixel off its mask and key points, and blurs by half its sigma.
# Believed: a blur leaves things where they are, which is why masks and key points pass it unchanged, and sigma, 3 by default, is its standard
# deviation in pixels. Seen: the kernel has 2 sigma pixels a side, an even number, without a middle: at every sigma that was tried the image goes .5
# pixels to the right and down, always to the same side, and the standard deviation is .5, .9, 1.5, 2.7 and 5.6 for 1, 2, 3, 5 and 10. Flips, turns and
# resizing of the package keep all three together.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet augmax==0.4.1 jax==0.10.2 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
from importlib.metadata import version

import augmax
import jax
import jax.numpy as jnp
import numpy as np

print("augmax", version("augmax"), "jax", jax.__version__)
height, width = 96, 120
y, x = np.mgrid[:height, :width]
spot = np.exp(-((x - 70) ** 2 + (y - 40) ** 2) / 100).astype(np.float32)
kinds = [augmax.InputType.IMAGE, augmax.InputType.MASK, augmax.InputType.KEYPOINTS]
inputs = [jnp.asarray(np.repeat(spot[..., None], 3, 2)), jnp.asarray(spot), jnp.array([[40.0, 70.0]])]


def places(transform):
    image, mask, points = augmax.Chain(transform, input_types=kinds)(jax.random.PRNGKey(0), inputs)
    weights = np.asarray(image)[..., 0], np.asarray(mask)
    centers = [[(weight * axis).sum() / weight.sum() for axis in np.indices(weight.shape)] for weight in weights]
    return np.array([*centers, np.asarray(points)[0]])


for name, transform in (
    ("HorizontalFlip", augmax.HorizontalFlip(p=1.0)),
    ("Rotate by 180", augmax.Rotate((180, 180), p=1.0)),
    ("Resize", augmax.Resize(240, 192)),
):
    image, mask, point = places(transform)
    print(f"{name}: image, mask and point at", image.round(2).tolist(), mask.round(2).tolist(), point.round(2).tolist())
    assert abs(image - point).max() < 0.05 and abs(mask - point).max() < 0.05
for sigma, expected in ((1, 0.5), (2, 0.91), (3, 1.52), (5, 2.69), (10, 5.6)):
    blur = augmax.GaussianBlur(sigma=sigma, p=1.0)
    image, mask, point = places(blur)
    dot = jnp.zeros((61, 61, 3)).at[30, 30].set(1.0)
    row = np.asarray(augmax.Chain(blur)(jax.random.PRNGKey(0), dot))[..., 0].sum(0)
    at = np.arange(61) - (row * np.arange(61)).sum() / row.sum()
    deviation = np.sqrt((row * at**2).sum() / row.sum())
    print(f"GaussianBlur({sigma}): image off the mask by {(image - mask).round(2).tolist()}, standard deviation {deviation:.2f}")
    assert np.allclose(image - mask, 0.5, atol=0.02) and np.allclose(mask, point, atol=0.02) and abs(deviation - expected) < 0.02
PROGRAM
