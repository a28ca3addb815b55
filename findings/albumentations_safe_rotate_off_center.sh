#!/usr/bin/env bash
# AlbumentationsX 2.5.1: SafeRotate moves the image half a pixel to the right and down, with its masks and key points, and its boxes not.
# Believed: it turns the image about its center, shrunk so that all of it stays inside, and targets move together; turned by 180 degrees an image is
# upside down, as Rotate and Affine have it. Seen: by 180 degrees every pixel is the mean of four, the first row and column are half fill, and a
# spot lies (.5, .5) from where both flips put it, in images of even and odd sizes; by 30, 45 and 90 degrees it lies as far from the turned and
# scaled position. Boxes are at that position, so that a detector learns boxes half a pixel off.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet albumentationsx==2.5.1 opencv-python-headless==5.0.0.93 numpy==2.4.6 torch==2.13.0
"$folder/venv/bin/python" - <<'PROGRAM'
import albumentations as A
import numpy as np

print("AlbumentationsX", A.__version__)
box_params = A.BboxParams(coord_format="pascal_voc", label_fields=["labels"])
point_params = A.KeypointParams(coord_format="xy", remove_invisible=False)


def center(weight):
    return np.array([(weight * axis).sum() / weight.sum() for axis in np.indices(weight.shape)[::-1]])


for height, width in ((96, 120), (95, 121)):
    y, x = np.mgrid[:height, :width]
    middle, at = np.array([width - 1, height - 1]) / 2, np.array([50, 40])
    spot = np.repeat(np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 40)[..., None], 3, 2).astype(np.float32)
    mask = ((abs(x - at[0]) <= 8) & (abs(y - at[1]) <= 8)).astype(np.uint8)
    sample = {"image": spot, "mask": mask, "keypoints": [tuple(at)], "bboxes": [[*(at - 8), *(at + 9)]], "labels": [1]}
    for kind in (A.SafeRotate, A.Affine):
        for angle in (180, 90, 30, 45):
            options = {"angle_range": (angle, angle)} if kind is A.SafeRotate else {"rotate": (angle, angle), "scale": (1, 1), "shear": (0, 0)}
            result = A.Compose([kind(**options, p=1)], bbox_params=box_params, keypoint_params=point_params)(**sample)
            radians = np.deg2rad(angle)
            turn = np.array([[np.cos(radians), np.sin(radians)], [-np.sin(radians), np.cos(radians)]])
            size = np.array([width, height])
            scale = size / (abs(turn) @ size) if kind is A.SafeRotate else 1
            expected = middle + scale * (turn @ (at - middle))
            box = np.array(result["bboxes"][0])
            off = {
                "image": center(result["image"][..., 0]) - expected,
                "key point": np.array(result["keypoints"][0]) - expected,
                "box": (box[:2] + box[2:]) / 2 - 0.5 - expected,
            }
            print(kind.__name__, (height, width), angle, {name: (np.round(value, 2) + 0.0).tolist() for name, value in off.items()})
            shift = 0.5 if kind is A.SafeRotate else 0
            assert all(np.allclose(off[name], 0 if name == "box" else shift, atol=0.08) for name in off)
    noise = np.random.default_rng(0).random((height, width, 3)).astype(np.float32)
    turned = A.SafeRotate(angle_range=(180, 180), p=1)(image=noise)["image"]
    padded = np.pad(noise[::-1, ::-1], ((1, 0), (1, 0), (0, 0)))
    blended = (padded[1:, 1:] + padded[:-1, 1:] + padded[1:, :-1] + padded[:-1, :-1]) / 4
    print(f"SafeRotate {height, width} by 180: {abs(turned - noise[::-1, ::-1]).max():.2f} from upside down,",
          f"{abs(turned - blended).max():.4f} from that moved by half a pixel")
    assert abs(turned - noise[::-1, ::-1]).max() > 0.5 and abs(turned - blended).max() < 0.01
PROGRAM
