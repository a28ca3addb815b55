"""The sheet of augmentations: rows of draws, with the masks, boxes and key points that follow them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor, nn

import kvision.augmentation as A
from kvision.augmentation.container.sheet import draw_samples
from kvision.demo import gallery

DRAWS, CELL = 6, 208  # draws of a row, and the side of their pictures
TITLE = "Augmentation: six draws of each, with the masks, boxes and key points that follow"
KEYS = ("image", "mask", "bbox_xyxy", "keypoints")
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

# Outlines of objects and key points in fractions of the image. The first sample photograph has a head, a space shuttle and
# a helmet; on other images the object is a disc in the middle.
# fmt: off
HEAD = ((.300, .141), (.325, .100), (.369, .063), (.422, .034), (.469, .031), (.516, .047), (.556, .081), (.584, .131),
        (.588, .181), (.572, .225), (.544, .256), (.519, .266), (.512, .297), (.500, .331), (.494, .363), (.453, .369),
        (.400, .359), (.369, .344), (.359, .297), (.350, .256), (.338, .225), (.306, .194))
SHUTTLE = ((.781, .000), (.838, .000), (.853, .056), (.863, .084), (.878, .084), (.888, .141), (.888, .438), (.897, .519),
           (.859, .525), (.850, .456), (.819, .469), (.806, .516), (.744, .519), (.738, .475), (.719, .500), (.731, .444),
           (.694, .438), (.694, .406), (.738, .338), (.738, .194), (.756, .156), (.750, .109), (.772, .063))
HELMET = ((.550, .938), (.556, .875), (.575, .819), (.613, .756), (.656, .713), (.706, .684), (.775, .672), (.838, .678),
          (.891, .703), (.931, .750), (.959, .813), (.975, .891), (.988, .938), (.994, .997), (.550, .997))
FACE = ((.394, .197), (.484, .200), (.441, .247), (.400, .275), (.475, .275))
# fmt: on
DISC = tuple((0.5 + 0.3 * float(np.cos(t)), 0.5 + 0.3 * float(np.sin(t))) for t in np.linspace(0, 2 * np.pi, 64))
AXES = ((0.5, 0.5), (0.2, 0.5), (0.8, 0.5), (0.5, 0.2), (0.5, 0.8))


class Row(NamedTuple):
    """A label, and the call of a class of kvision.augmentation whose module makes the draws of a row."""

    title: str
    call: str

    @property
    def augment(self) -> nn.Module:
        module: nn.Module = eval(self.call, {**vars(A)})
        return module


def rows(side: int) -> list[Row]:
    """The pipelines of the sheet for images of a side."""
    crop = (side * 7 // 8,) * 2
    return [
        Row("affine", "RandomAffine(30.0, (0.1, 0.1), (0.7, 1.1), 10.0, p=1.0)"),
        Row("perspective", "RandomPerspective(0.6, p=1.0)"),
        Row("elastic", elastic(side, 1.5)),
        Row("thin-plate spline", "RandomThinPlateSpline(0.15, p=1.0)"),
        Row("resized crop", f"RandomResizedCrop({crop}, scale=(0.2, 0.9))"),
        Row("color jitter", "ColorJitter(0.4, 0.4, 0.6, 0.3, p=1.0)"),
        Row("erasing", "RandomErasing((0.05, 0.2), value=0.5, p=1.0)"),
        Row("plasma shadow", "RandomPlasmaShadow((0.5, 0.8), (-0.6, -0.3), (0.4, 0.6), p=1.0)"),
        Row("rain", f"RandomRain((300, 500), {(side // 8, side // 4)}, {(-side // 16, side // 16)}, p=1.0)"),
        Row("RandAugment", "auto.RandAugment(2, 15)"),
        Row(
            "A: in a training loop",
            f"ImageSequential(RandomResizedCrop({crop}), RandomHorizontalFlip(), ColorJitter(0.2, 0.2, 0.2, 0.1), "
            f"Normalize({MEAN}, {STD}))",
        ),
        Row(
            "B: resampled once",
            "ImageSequential(RandomAffine(20.0, (0.05, 0.05), (0.9, 1.1), p=1.0), RandomPerspective(0.3, p=1.0), "
            f'{elastic(side, 0.8)}, RandomCrop({crop}), resample="once")',
        ),
    ]


def elastic(side: int, strength: float) -> str:
    """Waves of about a fifth of the image."""
    kernel, sigma, alpha = 2 * round(side * 5 / 32) + 1, side / 16, round(strength * side / 96, 2)
    return f"RandomElasticTransform({(kernel,) * 2}, {(sigma,) * 2}, {(alpha,) * 2}, p=1.0)"


def cells(row: Row, photo: Tensor, name: str) -> list[Image.Image]:
    """A photo (3, H, W) and its draws with their labels."""
    side = photo.shape[-1]
    inputs = (photo, *(label.to(photo.device) for label in labels(name, side)))
    drawn = draw_samples(row.augment, inputs, KEYS, DRAWS, side, seed=0)
    return [_middle(gallery.picture(cell), side).resize((CELL, CELL), Image.Resampling.LANCZOS) for cell in drawn]


def section(drawn: Sequence[tuple[Row, list[Image.Image]]], name: str) -> gallery.Section:
    columns = [name, *(f"draw {i + 1}" for i in range(DRAWS))]
    rows = [(row.title, cells) for row, cells in drawn]
    return gallery.Section(TITLE, [(title, "") for title in columns], rows, notes=[row.call for row, _ in drawn])


def labels(name: str, side: int) -> tuple[Tensor, Tensor, Tensor]:
    """A mask (1, H, W) of numbered objects, their boxes (N, 4), and key points (M, 2)."""
    known = name == "astronaut"
    objects, points = ((HEAD, SHUTTLE, HELMET), FACE) if known else ((DISC,), AXES)
    mask = Image.new("L", (side, side))
    boxes = []
    for i, outline in enumerate(objects):
        corners = (np.array(outline) * side).round()
        ImageDraw.Draw(mask).polygon([tuple(xy) for xy in corners.tolist()], fill=i + 1)
        boxes.append([*corners.min(0), *(corners.max(0) + 1).clip(max=side)])
    return (
        torch.from_numpy(np.array(mask))[None],
        torch.tensor(np.array(boxes), dtype=torch.float32),
        torch.tensor(points) * side - 0.5,
    )


def _middle(cell: Image.Image, side: int) -> Image.Image:
    """An image that is smaller than the others in the middle of a square."""
    square = Image.new("RGB", (side, side), gallery.PAPER)
    square.paste(cell, ((side - cell.width) // 2, (side - cell.height) // 2))
    return square
