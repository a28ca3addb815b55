#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.AlignMTB moves exposures apart that lie on one another, where they are smooth: by (-1, -1) to (-5, -2) pixels.
# Believed: of two equal images the shift is 0, whatever they show, and a bitmap that tells nothing moves nothing. Seen: of textures without detail
# below 15 pixels calculateShift(image, image) is (-1, -1), of 25 (-3, -1), and other shifts are as much off; of clouds, noise with a spectrum
# of 1 / f^2, it is (-5, -2). Pixels within exclude_range=4 levels of the median do not count, which in smooth images is all that a small shift changes, so
# that several shifts are equally good, and the first one tried, up and left, wins. With exclude_range=0 all of them are right, without noise.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
size = 1024


def crop(image, dx, dy):
    return image[100 + dy : size - 100 + dy, 100 + dx : size - 100 + dx]


def texture(blur):
    noise = np.random.default_rng(0).integers(0, 256, (size, size)).astype(np.float32)
    return np.uint8(cv2.normalize(cv2.GaussianBlur(noise, (0, 0), blur), None, 0, 255, cv2.NORM_MINMAX))


def clouds(power):
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size))
    frequency[0, 0] = 1
    image = np.real(np.fft.ifft2(np.fft.fft2(np.random.default_rng(0).normal(size=(size, size))) / frequency**power))
    return np.uint8(np.clip((image - image.mean()) / image.std() * 40 + 128, 0, 255))


cases = {"texture of 6 pixels": texture(6), "of 15": texture(15), "of 25": texture(25), "of 40": texture(40), "clouds, 1 / f": clouds(1), "1 / f^2": clouds(2)}
for name, image in cases.items():
    for exclude in (4, 0):
        align = cv2.createAlignMTB(exclude_range=exclude) if exclude == 0 else cv2.createAlignMTB()
        shifts = ((0, 0), (2, 0), (-2, -3))
        found = [align.calculateShift(crop(image, 0, 0), crop(image, *shift)) for shift in shifts]
        off = np.array(found) - shifts
        print(f"{name}, exclude_range={exclude}: shifts {shifts} are found as {found}")
        if exclude == 0 or name in ("texture of 6 pixels", "clouds, 1 / f"):
            assert (off == 0).all()
        elif name == "of 15":
            assert (off == -1).all()
        else:
            assert (off.min(1) <= -2).all() and (off.max(1) <= 1).all()
PROGRAM
