"""The color module: conversions, one pass over the pixels each."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nonlinear_backward, photographs
from benchmarks.peers import optional

cv2 = optional("cv2")
kornia = optional("kornia")
skcolor = optional("skimage.color")
tvision = optional("torchvision.transforms.functional")


def conversion(
    name: str, function: str, bars: Bars, code: str, peers: dict[str, Any] | None = None, **more: Any
) -> Case:
    """A case of `function` in kvision.color and kornia.color, and of OpenCV's cvtColor with this code."""

    def convert(K: Any, x: Tensor) -> Tensor:
        return getattr(K.color, function)(x)

    def opencv(x, out=None):
        return cv2.cvtColor(x, getattr(cv2, f"COLOR_{code}"), out)

    peers = {"kornia": partial(convert, kornia), "opencv": opencv, **(peers or {})}
    return Case(name, partial(convert, kvision), peers, bars, **more)


def converted(function: str) -> Callable[[Size, torch.dtype, torch.device], tuple[Tensor, ...]]:
    """Photographs converted by `function`, as inputs of the inverse conversion."""

    def inputs(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
        return tuple(getattr(kvision.color, function)(x) for x in photographs(size, dtype, device))

    return inputs


def in_degrees(hsv: Tensor) -> Tensor:
    """Convert the hue to OpenCV's degrees."""
    return torch.cat([hsv[:, :1] * (180 / math.pi), hsv[:, 1:]], 1)


def in_radians(x, out=None, degrees=None):
    degrees = cv2.multiply(x, (180 / math.pi, 1, 1, 1), degrees)
    return cv2.cvtColor(degrees, cv2.COLOR_HSV2RGB, out), degrees


nonlinear = {"backward": nonlinear_backward}

CASES = [
    conversion(
        "gray",
        "rgb_to_grayscale",
        Bars(floor=1.12, both=1.3, half=1.7, opencv=1.0),
        "RGB2GRAY",
        {"torchvision": lambda x: tvision.rgb_to_grayscale(x), "skimage": lambda x: skcolor.rgb2gray(x)},
    ),
    conversion(
        "rgb_to_hsv",
        "rgb_to_hsv",
        Bars(floor=1.12, both=1.3, half=1.7, opencv=1.0),
        "RGB2HSV",
        {"skimage": lambda x: skcolor.rgb2hsv(x) * (360, 1, 1)},
        result=in_degrees,
        **nonlinear,
    ),
    conversion(
        "hsv_to_rgb",
        "hsv_to_rgb",
        Bars(floor=1.12, both=1.3, half=1.7, opencv=1.0),
        "HSV2RGB",
        {"opencv": in_radians, "skimage": lambda x: skcolor.hsv2rgb(x * (0.5 / math.pi, 1, 1))},
        inputs=converted("rgb_to_hsv"),
        **nonlinear,
    ),
    conversion(
        "rgb_to_lab",
        "rgb_to_lab",
        Bars(floor=1.2, both=1.3, opencv=1.0),
        "RGB2LAB",
        {"skimage": lambda x: skcolor.rgb2lab(x)},
        **nonlinear,
    ),
    conversion(
        "lab_to_rgb",
        "lab_to_rgb",
        Bars(floor=1.2, both=1.3, opencv=1.0),
        "LAB2RGB",
        {"skimage": lambda x: skcolor.lab2rgb(x)},
        inputs=converted("rgb_to_lab"),
        **nonlinear,
    ),
    conversion(
        "rgb_to_luv",
        "rgb_to_luv",
        Bars(floor=1.2, both=1.3),
        "RGB2LUV",
        {"skimage": lambda x: skcolor.rgb2luv(x)},
        **nonlinear,
    ),
    conversion(
        "rgb_to_ycbcr",
        "rgb_to_ycbcr",
        Bars(floor=1.12, both=1.3, half=1.7, opencv=1.0),
        "RGB2YCrCb",
        result=lambda y: y[:, [0, 2, 1]],  # OpenCV's channel order
    ),
    conversion("rgb_to_xyz", "rgb_to_xyz", Bars(floor=1.12, both=1.3, half=1.7), "RGB2XYZ"),
    Case(
        "rgb_to_yuv420",
        lambda x: kvision.color.rgb_to_yuv420(x),
        {"kornia": lambda x: kornia.color.rgb_to_yuv420(x)},
        Bars(),
        result=lambda planes: planes[1],
    ),
]
