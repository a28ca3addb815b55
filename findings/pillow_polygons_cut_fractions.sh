#!/usr/bin/env bash
# Pillow 13.0.0: ImageDraw.polygon cuts the fractions of its points off, so that masks of polygons lie half a pixel up and to the left.
# Believed: coordinates may be fractions, as annotations have them, and are drawn as exactly as whole pixels allow, so that errors go to either
# side. Seen of 397 random polygons, with centers of pixels at whole numbers: masks lie (-.50, -.51) pixels from their polygons on average, those of
# cv2.fillPoly of the rounded points (-.01, -.01). A square that moves by .9 stays where it was; each mask is that of the points without their
# fractions. Round the points first. Where whole numbers are the edges of pixels, as in COCO's polygons, masks are at their place, and rounding
# would move them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pillow==13.0.0 opencv-python-headless==5.0.0.93 shapely==2.2.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np
import PIL
from PIL import Image, ImageDraw
from shapely import Polygon

print("Pillow", PIL.__version__, "OpenCV", cv2.__version__)
random = np.random.default_rng(0)


def pillow(points):
    image = Image.new("1", (101, 101))
    ImageDraw.Draw(image).polygon([tuple(point) for point in points], fill=1)
    return np.array(image)


def pillow_edges(points):
    return pillow(points + 0.5)  # where pixels have their edges at whole numbers


def opencv(points):
    return cv2.fillPoly(np.zeros((101, 101), np.uint8), [np.round(points).astype(np.int32)], 1)


shapes = []
for _ in range(400):
    turns = np.sort(random.random(random.integers(5, 12))) * 2 * np.pi
    radii = random.uniform(20, 40, turns.size)
    points = np.c_[50 + radii * np.cos(turns), 50 + radii * np.sin(turns)]  # centers of pixels at whole numbers
    if Polygon(points).is_valid:
        shapes.append(points)
moved = {}
for draw in (pillow, pillow_edges, opencv):
    off, wider = [], []
    for points in shapes:
        mask, polygon = draw(points), Polygon(points)
        center = [axis[mask > 0].mean() for axis in np.indices(mask.shape)[::-1]]
        off.append(np.array(center) - [polygon.centroid.x, polygon.centroid.y])
        wider.append((np.count_nonzero(mask) - polygon.area) / polygon.length)
    moved[draw.__name__] = np.mean(off, 0)
    print(
        f"{draw.__name__}: {len(shapes)} masks lie {moved[draw.__name__].round(2)} from their polygons, and are {np.mean(wider):.2f} wider all round"
    )
assert np.allclose(moved["pillow"], -0.5, atol=0.1) and np.allclose([moved["opencv"], moved["pillow_edges"]], 0, atol=0.05)
square = np.array([[10, 10], [20, 10], [20, 20], [10, 20]], float)
for shift in (0.3, 0.6, 0.9):
    same, rounded = (np.array_equal(draw(square + shift), draw(square)) for draw in (pillow, opencv))
    print(f"a square moved by {shift}: Pillow draws it as it was: {same}, OpenCV, rounded: {rounded}")
    assert same and rounded == (shift < 0.5)
assert np.array_equal(pillow(square), opencv(square))
cut = sum(np.array_equal(pillow(points), pillow(np.trunc(points))) for points in shapes)
print(f"{cut} of {len(shapes)} masks are those of the points without their fractions")
assert cut == len(shapes)
PROGRAM
