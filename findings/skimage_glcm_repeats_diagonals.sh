#!/usr/bin/env bash
# scikit-image 0.26.0: graycomatrix gives for distance 2 along a diagonal what it gives for distance 1, and diagonals go the other way.
# Believed: distances=[1, 2, 3] and four angles are twelve different textures, a diagonal at distance d being d steps down it, as in mahotas, and pi/4 being "the top-right diagonal neighbor", as its example has it. Seen: a distance is in pixels of length 1, rounded: along both
# diagonals 1 and 2 are one step, 3 is two, 5 and 6 are four and 7 is five, so that features are there twice, others not at all; and pi/4 is the
# neighbor at the lower right. Multiply distances by sqrt(2) for diagonals.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 numpy==2.4.6 mahotas==1.4.19
"$folder/venv/bin/python" - <<'PROGRAM'
import mahotas
import numpy as np
import skimage
from skimage.feature import graycomatrix

print("scikit-image", skimage.__version__)
image = np.random.default_rng(0).integers(0, 8, (64, 64), dtype=np.uint8)


def pairs(first, second):
    table = np.zeros((8, 8), int)
    np.add.at(table, (first.ravel(), second.ravel()), 1)
    return table


def steps(table, neighbor):
    """The numbers of steps towards this neighbor along a diagonal that have this table."""
    flipped = image[::-1] if neighbor == "upper right" else image
    return [n for n in range(1, 9) if (pairs(flipped[:-n, :-n], flipped[n:, n:]) == table).all()]


seen = []
for distance in range(1, 8):
    tables = graycomatrix(image, [distance, distance * np.sqrt(2)], [np.pi / 4, -np.pi / 4], levels=8)
    first, second, scaled = tables[..., 0, 0], tables[..., 0, 1], tables[..., 1, 0]
    by_mahotas = mahotas.features.texture.cooccurence(image, 1, distance=distance, symmetric=False)
    seen += steps(first, "lower right")
    print(f"pi / 4, distance {distance}: {seen[-1]} to the lower right, times sqrt(2) {steps(scaled, 'lower right')},", end=" ")
    print(f"mahotas {steps(by_mahotas, 'lower right')}, -pi / 4: {steps(second, 'upper right')} to the upper right")
    assert steps(second, "upper right") == seen[-1:] and steps(first, "upper right") == []
    assert steps(scaled, "lower right") == steps(by_mahotas, "lower right") == [distance]
assert seen == [1, 1, 2, 3, 4, 4, 5]
right, down = (graycomatrix(image, [2], [angle], levels=8)[..., 0, 0] for angle in (0, np.pi / 2))
assert (right == pairs(image[:, :-2], image[:, 2:])).all() and (down == pairs(image[:-2], image[2:])).all()
PROGRAM
