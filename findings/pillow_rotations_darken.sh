#!/usr/bin/env bash
# Pillow 13.0.0: rotate and transform of bytes with BILINEAR or BICUBIC darken the image by half a level each time.
# Believed: interpolated values are rounded to the nearest level, as Pillow's own resize rounds them. Seen: fractions
# are cut off, so that noise turned by 10 degrees is .51 levels (BICUBIC .48) below the same image in mode "F", never above; so are AFFINE,
# PERSPECTIVE and RGB images. Twenty turns to and fro lose 9.8 levels. Image.blend cuts, too, and with it ImageEnhance.Brightness: .45.
# Turn once rather than step by step, or in mode "F".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import PIL
from PIL import Image, ImageEnhance

print("Pillow", PIL.__version__)
noise = np.random.default_rng(0).integers(0, 256, (200, 200), dtype=np.uint8)
inner = (slice(60, -60), slice(60, -60))
BILINEAR, BICUBIC = Image.Resampling.BILINEAR, Image.Resampling.BICUBIC
affine, perspective = (1, 0, 0.3, 0, 1, 0.4), (1, 0.1, 0, 0.1, 1, 0, 1e-4, 1e-4)
ways = {
    "rotate, bilinear": lambda image: image.rotate(10, BILINEAR),
    "rotate, bicubic": lambda image: image.rotate(10, BICUBIC),
    "transform, affine": lambda image: image.transform((200, 200), Image.Transform.AFFINE, affine, BILINEAR),
    "transform, perspective": lambda image: image.transform((200, 200), Image.Transform.PERSPECTIVE, perspective, BILINEAR),
    "resize": lambda image: image.resize((217, 217), BILINEAR),
}
for name, way in ways.items():
    floats = np.asarray(way(Image.fromarray(noise.astype(np.float32)))).clip(0, 255)[inner]
    gray = np.asarray(way(Image.fromarray(noise)))[inner] - floats
    color = np.asarray(way(Image.fromarray(noise[..., None].repeat(3, 2))))[inner][..., 0] - floats
    print(f"{name:22}: gray {gray.mean():.2f}, color {color.mean():.2f} levels on average, from {gray.min():.2f} to {gray.max():.2f}")
    if name == "resize":
        assert abs(gray.mean()) < 0.05
    else:
        assert -0.53 < gray.mean() < -0.45 and gray.max() < 0.01 and abs(gray.mean() - color.mean()) < 0.01
dimmed = np.asarray(ImageEnhance.Brightness(Image.fromarray(noise)).enhance(0.7)) - 0.7 * noise
print(f"brightness 0.7: {dimmed.mean():.2f} levels")
assert -0.5 < dimmed.mean() < -0.4
y, x = np.mgrid[:200, :200]
smooth = np.uint8(np.round(128 + 60 * np.sin(x / 20) * np.cos(y / 25)))
means = []
for image in (Image.fromarray(smooth), Image.fromarray(smooth.astype(np.float32))):
    for step in range(20):
        image = image.rotate(7 if step % 2 else -7, BILINEAR)
    means.append(np.asarray(image)[inner].mean())
print(f"mean after twenty turns: bytes {means[0]:.1f}, floats {means[1]:.1f}")
assert 9 < means[1] - means[0] < 10.5
PROGRAM
