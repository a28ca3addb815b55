#!/usr/bin/env bash
# ids-peak-ipl 1.18.0 (IDS peak): gray from a Bayer image lies half a pixel left of and above its color, for some patterns and some depths.
# Believed: ConvertTo Mono8 and RGB8 show the same scene, so that features found in gray, and a calibration made on it, hold for the color image and
# the raw one. Seen of a smooth spot: RGB8 is at its place for all four patterns. In the default mode Mono8 is at (-.5, -.5) of BayerRG8 and
# BayerGR8, and at its place of BayerGB8 and BayerBG8; Mono10 and Mono12 are right of all four and Mono16 of none. In the mode HighQuality RGB8 is
# right and Mono8 is (-.5, -.5) for all. So depth, pattern and mode, of which a camera turned upside down changes one, decide on half a pixel.
# Convert to RGB8 first and weight the channels by hand.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ids-peak-ipl==1.18.0 ids-peak-common==2.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import ids_peak_ipl.ids_peak_ipl as ipl
import numpy as np

print("ids-peak-ipl", version("ids-peak-ipl"))
y, x = np.mgrid[:96, :120]
spot = np.round(200 * np.exp(-((x - 60) ** 2 + (y - 40) ** 2) / 100)).astype(np.uint8)  # the raw image of a gray scene


def name(kind):
    return getattr(ipl, "PixelFormatName_" + kind)


def moved(converted, kind):
    """How far the spot lies from where it is in the raw image, by channel where there are three."""
    values = converted.get_numpy_3D() if kind == "RGB8" else converted.get_numpy_2D() if kind == "Mono8" else converted.get_numpy_2D_16()
    channels = np.atleast_3d(values).astype(float)
    centers = [[(part * x).sum() / part.sum() - 60, (part * y).sum() / part.sum() - 40] for part in np.moveaxis(channels, 2, 0)]
    assert np.ptp(centers, axis=0).max() < 0.01
    return np.round(centers[0], 2) + 0.0


half = {("BayerRG8", "Mono8"), ("BayerGR8", "Mono8")} | {(f"Bayer{order}8", "Mono16") for order in ("RG", "GR", "GB", "BG")}
for order in ("RG", "GR", "GB", "BG"):
    bayer = f"Bayer{order}8"
    raw = ipl.Image.CreateFromSizeAndPythonBuffer(name(bayer), spot.ravel(), 120, 96)
    kinds = ("RGB8", "Mono8", "Mono10", "Mono12", "Mono16")
    seen = {kind: moved(raw.ConvertTo(name(kind)), kind) for kind in kinds}
    print(f"{bayer}, by default:", {kind: off.tolist() for kind, off in seen.items()})
    for kind, off in seen.items():
        assert np.allclose(off, -0.5 if (bayer, kind) in half else 0, atol=0.02)
    finer = ipl.ImageConverter()
    finer.SetConversionMode(ipl.ConversionMode_HighQuality)
    seen = {kind: moved(finer.Convert(raw, name(kind)), kind) for kind in ("RGB8", "Mono8")}
    print(f"{bayer}, HighQuality:", {kind: off.tolist() for kind, off in seen.items()})
    assert np.allclose(seen["RGB8"], 0, atol=0.02) and np.allclose(seen["Mono8"], -0.5, atol=0.02)
PROGRAM
