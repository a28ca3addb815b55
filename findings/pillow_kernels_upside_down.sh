#!/usr/bin/env bash
# Pillow 13.0.0: ImageFilter.Kernel puts the first row of the kernel below the pixel, so that its vertical derivatives have the wrong sign.
# Believed: a kernel is laid over the pixel as it is written (correlation, as in OpenCV) or turned by 180 degrees (convolution, as in SciPy).
# Seen: it is turned upside down alone, which is neither: the horizontal Sobel kernel agrees with cv2.filter2D and the vertical one has the
# opposite sign, so that a gradient of 60 degrees is found at -60. A blur along the diagonal runs along the other one, and ImageFilter.EMBOSS
# lights the image from below on the left where cv2.filter2D of its own numbers lights it from above. 3x3 and 5x5 alike; symmetric kernels hide it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pillow==13.0.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import PIL
from PIL import Image, ImageFilter

print("Pillow", PIL.__version__, "OpenCV", cv2.__version__)


def by_pillow(image, kernel, scale=1, offset=0):
    kernel = np.asarray(kernel)
    return np.array(Image.fromarray(image).filter(ImageFilter.Kernel(kernel.shape, kernel.ravel().tolist(), scale, offset)))


for size in (3, 5):
    kernel = np.arange(1, size * size + 1).reshape(size, size)
    point = np.zeros((11, 11), np.uint8)
    point[5, 5] = 1
    reach = slice(5 - size // 2, 6 + size // 2)
    seen = by_pillow(point, kernel)[reach, reach]
    print(f"{size}x{size}: one bright pixel under the rows {kernel.tolist()} becomes {seen.tolist()}")
    assert np.array_equal(seen, kernel[:, ::-1])  # convolution gives the kernel, correlation kernel[::-1, ::-1]

y, x = np.mgrid[:40, :40]
ramp = np.round(40 + 1.5 * x + 2.6 * y).astype(np.uint8)  # rises to the right, and more so downward
across = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]])
gradients = {"Pillow": [], "OpenCV": []}
for kernel in (across, across.T):
    gradients["Pillow"].append(by_pillow(ramp, kernel, 1, 128)[10:30, 10:30].astype(int).mean() - 128)
    gradients["OpenCV"].append(cv2.filter2D(ramp, cv2.CV_32F, kernel.astype(np.float32))[10:30, 10:30].mean())
angles = {name: np.degrees(np.arctan2(*gradient[::-1])) for name, gradient in gradients.items()}
print({name: f"gradient ({gradient[0]:.1f}, {gradient[1]:.1f}), {angles[name]:.0f} degrees" for name, gradient in gradients.items()})
assert abs(angles["OpenCV"] - 60) < 1 and abs(angles["Pillow"] + 60) < 1

(width, height), scale, offset, numbers = ImageFilter.EMBOSS.filterargs
image = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (64, 64), dtype=np.uint8), (0, 0), 2)
own = np.array(Image.fromarray(image).filter(ImageFilter.EMBOSS))[1:-1, 1:-1].astype(float)
rows = np.array(numbers, np.float32).reshape(height, width)
off = {
    name: abs(own - np.clip(cv2.filter2D(image, cv2.CV_32F, k) / scale + offset, 0, 255)[1:-1, 1:-1]).max()
    for name, k in (("as written", rows), ("upside down", rows[::-1]))
}
print("EMBOSS", rows.tolist(), "off cv2.filter2D:", {name: round(float(value), 2) for name, value in off.items()})
assert off["upside down"] <= 0.5 < 5 < off["as written"]
PROGRAM
