"""The sheet of the color and enhance modules, and one photo in all hues."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import torch
from torch import Tensor

from kvision import color, enhance
from kvision.demo.sheet import Image, Sheet, Step


def hues_alone(hsv: Tensor) -> Tensor:
    """Colors that have the hue of every pixel at full saturation and value."""
    return color.hsv_to_rgb(torch.cat([hsv[:, :1], torch.ones_like(hsv[:, 1:])], 1))


def at_one_lightness(lab: Tensor) -> Tensor:
    return color.lab_to_rgb(torch.cat([torch.full_like(lab[:, :1], 65.0), lab[:, 1:]], 1))


def plasma(photos: Tensor) -> Tensor:
    """The luminance shown by the colormap plasma."""
    return color.apply_colormap(color.rgb_to_grayscale(photos), PLASMA)


PLASMA = color.ColorMap("plasma", 256)


def per_plane(equalize: Callable[[Image], Any]) -> Callable[[Image], Any]:
    """Apply a function of OpenCV that takes 8-bit planes to every channel."""

    def work(image: Image) -> Any:
        levels = cv2.convertScaleAbs(image, alpha=255)
        return cv2.merge([equalize(plane) for plane in cv2.split(levels)])

    return work


SHEET = Sheet(
    "Color",
    [
        Step(
            "hue",
            "rgb_to_hsv(x): its hue, at full saturation and value",
            color.rgb_to_hsv,
            lambda image: cv2.cvtColor(image, cv2.COLOR_RGB2HSV),
            hues_alone,
        ),
        Step(
            "lab",
            "rgb_to_lab(x): its colors, at lightness 65",
            color.rgb_to_lab,
            lambda image: cv2.cvtColor(image, cv2.COLOR_RGB2LAB),
            at_one_lightness,
        ),
        Step("plasma", 'apply_colormap(rgb_to_grayscale(x), ColorMap("plasma", 256))', plasma),
        Step("sepia", "sepia(x): the tint of old prints", color.sepia),
        Step("saturation", "adjust_saturation(x, 1.8): stronger colors", lambda x: enhance.adjust_saturation(x, 1.8)),
        Step(
            "contrast",
            "adjust_contrast_with_mean_subtraction(x, 1.6): farther from the mean",
            lambda x: enhance.adjust_contrast_with_mean_subtraction(x, 1.6),
        ),
        Step(
            "gamma",
            "adjust_gamma(x, 0.5): square roots lighten the dark",
            lambda x: enhance.adjust_gamma(x, 0.5),
            lambda image: cv2.pow(image, 0.5),
        ),
        Step(
            "equalize",
            "equalize(x, opencv=True): all levels as often",
            lambda x: enhance.equalize(x, opencv=True),
            per_plane(cv2.equalizeHist),
        ),
        Step(
            "clahe",
            "equalize_clahe(x, 4.0, opencv=True): the same in each tile, limited",
            lambda x: enhance.equalize_clahe(x, 4.0, opencv=True),
            per_plane(lambda plane: cv2.createCLAHE(4.0).apply(plane)),
        ),
    ],
)


def hue_wheel(photo: Tensor, count: int) -> Tensor:
    """A photo (3, H, W) with its hues rotated by `count` equal steps around the circle: (count, 3, H, W), in one call."""
    angles = torch.arange(count, device=photo.device) * (2 * math.pi / count)
    return enhance.adjust_hue(photo.expand(count, -1, -1, -1), angles)
