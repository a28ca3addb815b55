#!/usr/bin/env bash
# py360convert 1.0.4: c2e lays the cube half a pixel too far to the left and up in the panorama, so that e2c and c2e do not undo one another.
# Believed: the faces that e2c takes from a panorama give it back, up to blur, and a face seen under 90 degrees is where its directions are. Seen on panoramas
# whose pixels hold their own direction: what e2c reads is within .01 degrees of exact, and c2e writes what lies half a pixel further right and
# down, from the faces of e2c and from exact ones, at 128, 256 and 512 columns, by "bilinear" and by "nearest". So each round trip adds .5 pixels,
# and what a network finds on the faces, depth or labels, does not fit the panorama that they were made from.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet py360convert==1.0.4 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import numpy as np
import py360convert

print("py360convert", version("py360convert"))


def panorama(height):
    """Each pixel's direction: x to the right, y up, z forward."""
    row, column = np.mgrid[:height, : 2 * height] + 0.5
    longitude, latitude = (column / height - 1) * np.pi, (0.5 - row / height) * np.pi
    flat = np.cos(latitude)
    return np.stack([flat * np.sin(longitude), np.sin(latitude), flat * np.cos(longitude)], -1)


def exact_faces(size):
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(1, -1, size))
    one = np.ones_like(x)
    axes = {"F": (x, y, one), "R": (one, y, -x), "B": (-x, y, -one), "L": (-one, y, x), "U": (x, one, -y), "D": (x, -one, y)}
    return {name: np.stack(face, -1) / np.linalg.norm(face, axis=0)[..., None] for name, face in axes.items()}


def moved(directions, truth):
    """Where the content lies, in pixels to the right and down, between 30 degrees south and north."""
    angles = [np.stack([np.arctan2(d[..., 0], d[..., 2]), np.arcsin(d[..., 1] / np.linalg.norm(d, axis=-1))]) for d in (directions, truth)]
    off = (angles[0] - angles[1] + np.pi) % (2 * np.pi) - np.pi
    middle = abs(angles[1][1]) < np.pi / 6
    return np.array([-off[0][middle].mean(), off[1][middle].mean()]) * len(truth) / np.pi


for height in (64, 128, 256):
    truth, size = panorama(height), height // 2
    for mode in ("bilinear", "nearest"):
        faces = py360convert.e2c(truth, size, mode=mode, cube_format="dict")
        exact = exact_faces(size)
        cosines = {name: (faces[name] * exact[name]).sum(-1) / np.linalg.norm(faces[name], axis=-1) for name in exact}
        read = max(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() for cosine in cosines.values())
        shifts = {
            "e2c and back": moved(py360convert.c2e(faces, height, 2 * height, mode=mode, cube_format="dict"), truth),
            "exact faces": moved(py360convert.c2e(exact, height, 2 * height, mode=mode, cube_format="dict"), truth),
        }
        print(
            f"{2 * height} columns, {mode}: e2c is {read:.3f} degrees off; c2e moves by",
            {k: v.round(2).tolist() for k, v in shifts.items()},
        )
        assert np.allclose(list(shifts.values()), -0.5, atol=0.06) and (mode == "nearest" or read < 0.01)
PROGRAM
