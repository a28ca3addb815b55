#!/usr/bin/env bash
# libvips 8.18.7 (pyvips 3.2.0): conv with precision="approximate" divides by the number of layers where the kernel is flat.
# Believed: an approximation keeps the sum of the weights, so that the mean of an image stays, and more layers are more exact. Seen: a box of any size,
# a disc, a ring and a diagonal line, whose weights are all the same or 0, make an image of mean 127 one of 26 at the default of 5 layers, of 13
# with 10 and 6.9 with 20; only with 1 it is right. convsep does it twice, and .2 is left. A Gaussian in fractions of 1 loses as much; (1, 2, 3, 2, 1)
# and gaussblur, whose weights are whole numbers up to 20, keep the mean within .6.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import pyvips

print("libvips", ".".join(str(pyvips.version(part)) for part in range(3)))
image = pyvips.Image.new_from_array(np.random.default_rng(0).random((120, 120)).astype(np.float32) * 255)
squares = np.add.outer(np.arange(-5, 6) ** 2, np.arange(-5, 6) ** 2)
hill = [1, 2, 3, 2, 1]
kernels = {
    "box of 3": np.ones((3, 3)),
    "box of 9": np.ones((9, 9)),
    "disc": (squares <= 25) * 1.0,
    "ring": (abs(squares - 20) <= 6) * 1.0,
    "diagonal": np.eye(9),
    "Gaussian": np.exp(-squares / 8),
    "hill": np.outer(hill, hill).astype(float),
}


def mean(result):
    return float(result.numpy()[20:-20, 20:-20].mean())


for name, kernel in kernels.items():
    matrix = pyvips.Image.new_from_array(kernel.tolist(), scale=float(kernel.sum()))
    exact, approximate = (mean(image.conv(matrix, precision=precision)) for precision in ("float", "approximate"))
    layers = {number: mean(image.conv(matrix, precision="approximate", layers=number)) for number in (1, 2, 5, 10, 20)}
    print(f"{name}: mean {exact:.1f}, approximate {approximate:.1f}, by layers", {number: round(value, 1) for number, value in layers.items()})
    assert approximate == layers[5] and abs(exact - 127.5) < 0.3
    for number, value in layers.items():
        assert abs(value - exact / (1 if name == "hill" else number)) < (16 if name == "Gaussian" else 0.8)
for name, row in (("box of 5", np.ones(5)), ("Gaussian", np.exp(-(np.arange(-6, 7) ** 2) / 8)), ("hill", np.array(hill, float))):
    matrix = pyvips.Image.new_from_array([row.tolist()], scale=float(row.sum()))
    exact, approximate = (mean(image.convsep(matrix, precision=precision)) for precision in ("float", "approximate"))
    print(f"convsep, {name}: mean {exact:.1f}, approximate {approximate:.1f}")
    assert abs(exact - 127.5) < 0.3 and (abs(approximate - exact) < 0.3 if name == "hill" else approximate < 0.5)
for sigma in (2, 5):
    exact, approximate = (mean(image.gaussblur(sigma, precision=precision)) for precision in ("float", "approximate"))
    print(f"gaussblur({sigma}): mean {exact:.1f}, approximate {approximate:.1f}")
    assert abs(exact - approximate) < 0.6
PROGRAM
