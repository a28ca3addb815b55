"""`python -m kvision.demo.contact_sheet FILE`: a page of small results without times, the picture of README.md."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from PIL import Image, ImageDraw, ImageFont

from kvision.demo import gallery
from kvision.demo.__main__ import SHEETS, load
from kvision.demo.restore import blur, restore

TILE, GAP, LABEL, ALONE = 176, 8, 38, 288  # pixels; ALONE is the side of a picture in a file of its own
STEPS = 150  # of the restoration

# Photo, step of the gallery, and what made it of the photo x, row by row; "photo", "blurred" and "restored" are no steps.
COLUMNS = 6
CALLS = [
    ("astronaut", "photo", "io.load_image(path)"),
    ("astronaut", "canny", "canny(x)[1]"),
    ("astronaut", "bilateral", "bilateral_blur(x, 21, 0.5, (7, 7))"),
    ("astronaut", "plasma", "apply_colormap(gray, plasma)"),
    ("astronaut", "blurred", "gaussian_blur2d(x, 19, (3, 3))"),
    ("astronaut", "restored", "by descent through the blur"),
    ("chelsea", "photo", "io.load_image(path)"),
    ("chelsea", "sobel", "4 * sobel(x)"),
    ("chelsea", "hue", "rgb_to_hsv(x): its hue alone"),
    ("chelsea", "mosaic", "extract_tensor_patches, sorted"),
    ("chelsea", "motion blur", "motion_blur(x, 21, 35.0, 0.0)"),
    ("chelsea", "pixels", 'resize(small, 320, "nearest")'),
    ("coffee", "photo", "io.load_image(path)"),
    ("coffee", "perspective", "warp_perspective(x, matrix, size)"),
    ("coffee", "elastic", "elastic_transform2d(x, noise)"),
    ("coffee", "clahe", "equalize_clahe(x, 4.0)"),
    ("coffee", "sepia", "sepia(x)"),
    ("coffee", "lab", "rgb_to_lab(x) at one lightness"),
]
CELLS = [(photo, title) for photo, title, _ in CALLS]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m kvision.demo.contact_sheet", description=__doc__)
    parser.add_argument("file", type=Path, metavar="FILE", help="for example docs/pictures/results.jpg")
    parser.add_argument("--tiles", type=Path, help="a folder for the results one by one, larger: docs/pictures/gallery")
    options = parser.parse_args(arguments)
    pictures = cells()
    contact_sheet(pictures).save(options.file, quality=85)
    if options.tiles is not None:
        options.tiles.mkdir(parents=True, exist_ok=True)
        for (name, title), picture in zip(CELLS, pictures):
            resized(picture, ALONE).save(options.tiles / f"{name}_{title.replace(' ', '_')}.jpg", quality=82)
    return 0


def resized(picture: Image.Image, side: int) -> Image.Image:
    return picture.resize((side, side), Image.Resampling.LANCZOS)


def cells() -> list[Image.Image]:
    """The results of CELLS."""
    names, photos = load([])
    results = {"photo": photos}
    titles = {title for _, title in CELLS}
    for sheet in SHEETS:
        for step in sheet.steps:
            if step.title in titles:
                source = photos if step.input is None else step.input.make(photos)
                results[step.title] = step.show(step.call(source)).clamp(0, 1)
    results["blurred"] = blur(photos)
    results["restored"] = torch.cat([restore(photos[:1], range(STEPS)).restored, photos[1:]])
    return [gallery.picture(results[title][names.index(name)]) for name, title in CELLS]


def contact_sheet(pictures: Sequence[Image.Image]) -> Image.Image:
    """The results of CELLS on a page, each with its title and its call below."""
    rows = -(-len(CELLS) // COLUMNS)
    page = Image.new("RGB", (COLUMNS * (TILE + GAP) + GAP, rows * (TILE + LABEL + GAP) + GAP), gallery.PAPER)
    draw, font, small = ImageDraw.Draw(page), ImageFont.load_default(14), ImageFont.load_default(11)
    for i, ((_, title, call), picture) in enumerate(zip(CALLS, pictures)):
        x, y = GAP + i % COLUMNS * (TILE + GAP), GAP + i // COLUMNS * (TILE + LABEL + GAP)
        page.paste(resized(picture, TILE), (x, y))
        draw.text((x, y + TILE + 4), title, fill=gallery.INK, font=font)
        draw.text((x, y + TILE + 20), call, fill=gallery.FAINT, font=small)
    return page


if __name__ == "__main__":
    sys.exit(main())
