#!/usr/bin/env bash
# Pillow 13.0.0: in an array of a LAB image a and b wrap around at gray, and are 128 from what getpixel, split and ImageStat say of the same pixels.
# Believed: np.asarray(image) holds what getpixel gives, as it does in RGB, HSV and YCbCr, and a and b have 128 for gray, as in the 8-bit codes of
# OpenCV. Seen: the pixel that getpixel calls (136, 123, 132) is (136, 251, 4) in the array: a and b are there signed bytes that are shown as unsigned, 255
# beside 0. Of a nearly gray picture the mean of a is 92 in the array, with a standard deviation of 122, where ImageStat has 128 and 1.4, and resizing the
# array makes vivid colors of grays, which Pillow's own resize does not. Arrays of the bands from split() are right, and so is the array ^ (0, 128, 128).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pillow==13.0.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import PIL
from PIL import Image, ImageCms, ImageStat

print("Pillow", PIL.__version__)
srgb, lab = ImageCms.createProfile("sRGB"), ImageCms.createProfile("LAB")
to_lab = ImageCms.buildTransform(srgb, lab, "RGB", "LAB")
to_rgb = ImageCms.buildTransform(lab, srgb, "LAB", "RGB")

pixel = ImageCms.applyTransform(Image.new("RGB", (4, 4), (120, 130, 120)), to_lab)
seen = {"getpixel": pixel.getpixel((0, 0)), "array": np.asarray(pixel)[0, 0], "split": [np.asarray(band)[0, 0] for band in pixel.split()]}
seen = {name: tuple(map(int, values)) for name, values in seen.items()}
print("RGB (120, 130, 120):", seen)
assert seen == {"getpixel": (136, 123, 132), "array": (136, 251, 4), "split": (136, 123, 132)}
others = {mode: Image.new(mode, (1, 1), (10, 20, 200)) for mode in ("RGB", "HSV", "YCbCr")}
assert all(np.asarray(image)[0, 0].tolist() == list(image.getpixel((0, 0))) for image in others.values())

grays = np.clip(np.random.default_rng(0).normal(128, 2, (64, 64, 3)), 0, 255).astype(np.uint8)
image = ImageCms.applyTransform(Image.fromarray(grays), to_lab)
array, stat = np.asarray(image), ImageStat.Stat(image)
print(
    f"a of a nearly gray picture: {array[..., 1].mean():.0f} +- {array[..., 1].std():.0f} in the array, {stat.mean[1]:.0f} +- {stat.stddev[1]:.1f} by ImageStat"
)
assert array[..., 1].std() > 100 and stat.stddev[1] < 3 and abs(stat.mean[1] - 128) < 1
assert np.array_equal(array ^ np.array([0, 128, 128], np.uint8), np.asarray(Image.merge("RGB", image.split())))

by_array = Image.fromarray(cv2.resize(array, (16, 16), interpolation=cv2.INTER_AREA), "LAB")
by_pillow = image.resize((16, 16), Image.BOX)
colorful = {
    name: np.ptp(np.asarray(ImageCms.applyTransform(small, to_rgb)).astype(int), 2).max()
    for name, small in (("array", by_array), ("Pillow", by_pillow))
}
print("shrunk to a quarter, the most that red, green and blue of a pixel differ:", {name: int(most) for name, most in colorful.items()})
assert colorful["Pillow"] < 10 and colorful["array"] > 100
PROGRAM
