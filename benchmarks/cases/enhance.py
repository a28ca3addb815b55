"""The enhance module: adjustments, statistics of whole images, and chains of steps in one pass."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nonlinear_backward, photographs
from benchmarks.peers import optional

cv2 = optional("cv2")
kornia = optional("kornia")
skexposure = optional("skimage.exposure")
tvision = optional("torchvision.transforms.functional")

nonlinear = {"backward": nonlinear_backward}
IMAGENET = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]


@cache
def imagenet(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """ImageNet's mean and standard deviation on the images' device, as a training loop keeps them."""
    mean, std = (torch.tensor(values, dtype=dtype, device=device) for values in IMAGENET)
    return mean, std


def case(name: str, call: Callable[..., Any], bars: Bars, peers: dict[str, Callable[..., Any]], **more: Any) -> Case:
    """A case whose `call(library, input)` is the same for kvision and Kornia."""
    return Case(name, partial(call, kvision), {"kornia": partial(call, kornia), **peers}, bars, **more)


def one_channel(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    return photographs((size[0], 1, *size[2:]), dtype, device)


def two_images(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    (x,) = photographs(size, dtype, device)
    return x, x.flip(-1)


# -- adjustments. Where OpenCV has no such function, several of its functions are combined.


def brightness_opencv(x, out=None):
    out = cv2.add(x, (0.2,) * 4, out)
    return cv2.min(out, (1,) * 4, out)


def contrast_opencv(x, out=None):
    out = cv2.multiply(x, (1.3,) * 4, out)
    return cv2.min(out, (1,) * 4, out)


def contrast_mean_opencv(x, out=None, gray=None):
    gray = cv2.cvtColor(x, cv2.COLOR_RGB2GRAY, gray)
    out = cv2.addWeighted(x, 1.3, x, 0, -0.3 * cv2.mean(gray)[0], out)
    return cv2.max(cv2.min(out, (1,) * 4, out), (0,) * 4, out), gray


# -- chains of steps: augmentation in front of a network


def jitter(name: str, contrast: bool, bars: Bars) -> Case:
    """Brightness, optionally contrast, saturation, hue, ImageNet's normalization; the same factors for all images."""
    steps = (
        ("brightness", 1.2),
        ("contrast", 0.7),
        ("saturation", 1.4),
        ("hue", 0.3),
        ("normalize", *map(tuple, IMAGENET)),
    )
    program = kvision.enhance.ColorProgram(*(step for step in steps if contrast or step[0] != "contrast"))

    def in_kornia(x):
        E = kornia.enhance
        x = E.adjust_brightness_accumulative(x, 1.2)
        x = E.adjust_contrast_with_mean_subtraction(x, 0.7) if contrast else x
        x = E.adjust_hue(E.adjust_saturation_with_gray_subtraction(x, 1.4), 0.3)
        return E.normalize(x, *imagenet(x.dtype, x.device))

    def in_torchvision(x):
        x = tvision.adjust_brightness(x, 1.2)
        x = tvision.adjust_contrast(x, 0.7) if contrast else x
        x = tvision.adjust_hue(tvision.adjust_saturation(x, 1.4), 0.15 / math.pi)
        return tvision.normalize(x, *IMAGENET)

    return Case(name, program, {"kornia": in_kornia, "torchvision": in_torchvision}, bars, **nonlinear)


def jitter_each() -> Case:
    """The steps of `jitter`, with separate factors for each image."""
    program = kvision.enhance.ColorProgram(("brightness", 1.0), ("saturation", 1.0), ("hue", 0.0), ("gamma", 1.0))

    def inputs(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
        factors = torch.linspace(0.6, 1.4, size[0], dtype=dtype, device=device)
        return (*photographs(size, dtype, device), factors, factors.flip(0), factors - 1)

    def call(x, brightness, saturation, hue):
        return program(x, {"brightness": brightness, "saturation": saturation, "hue": hue, "gamma": brightness})

    def in_kornia(x, brightness, saturation, hue):
        E = kornia.enhance
        x = E.adjust_saturation_with_gray_subtraction(E.adjust_brightness_accumulative(x, brightness), saturation)
        return E.adjust_gamma(E.adjust_hue(x, hue), brightness)

    return Case("jitter_each", call, {"kornia": in_kornia}, Bars(floor=1.2, both=1.3), inputs, **nonlinear)


# -- statistics of whole images, one plane after the other


def of_planes(equalize: Callable[[Any], Any]) -> Callable[..., Any]:
    """Equalize planes by OpenCV, which takes bytes: floor(255 x) of the same float image."""

    def work(x, out=None, levels=None):
        levels = np.empty(x.shape, np.uint8) if levels is None else levels
        np.multiply(x, 255, levels, casting="unsafe")
        for channel in range(levels.shape[2]):
            cv2.insertChannel(equalize(cv2.extractChannel(levels, channel)), levels, channel)
        return np.multiply(levels, np.float32(1 / 255), out), levels

    return work


def clahe_opencv(plane):
    return cv2.createCLAHE(40.0, (8, 8)).apply(plane)


CASES = [
    case(
        "brightness",
        lambda K, x: K.enhance.adjust_brightness(x, 0.2),
        Bars(floor=1.1, both=1.3, half=1.7, opencv=1.0),
        {"opencv": brightness_opencv},
        **nonlinear,
    ),
    case(
        "contrast",
        lambda K, x: K.enhance.adjust_contrast(x, 1.3),
        Bars(floor=1.1, both=1.3, half=1.7, opencv=1.0),
        {"opencv": contrast_opencv},
        **nonlinear,
    ),
    case(
        "contrast_mean",
        lambda K, x: K.enhance.adjust_contrast_with_mean_subtraction(x, 1.3),
        Bars(floor=1.7, launches=2, opencv=1.0),
        {"opencv": contrast_mean_opencv, "torchvision": lambda x: tvision.adjust_contrast(x, 1.3)},
        **nonlinear,
    ),
    case(
        "saturation",
        lambda K, x: K.enhance.adjust_saturation(x, 1.3),
        Bars(floor=1.12, both=1.3, half=1.7),
        {},
        **nonlinear,
    ),
    case(
        "saturation_gray",
        lambda K, x: K.enhance.adjust_saturation_with_gray_subtraction(x, 1.3),
        Bars(floor=1.12, both=1.3, half=1.7),
        {"torchvision": lambda x: tvision.adjust_saturation(x, 1.3)},
        **nonlinear,
    ),
    case(
        "hue",
        lambda K, x: K.enhance.adjust_hue(x, 0.6),
        Bars(floor=1.12, both=1.3, half=1.7),
        {"torchvision": lambda x: tvision.adjust_hue(x, 0.3 / math.pi)},
        **nonlinear,
    ),
    case(
        "gamma",
        lambda K, x: K.enhance.adjust_gamma(x, 2.2),
        Bars(floor=1.15, both=1.3, half=1.7, opencv=1.0),
        {
            "opencv": lambda x, out=None: cv2.pow(x, 2.2, out),
            "skimage": lambda x: skexposure.adjust_gamma(x, 2.2),
            "torchvision": lambda x: tvision.adjust_gamma(x, 2.2),
        },
        **nonlinear,
    ),
    case(
        "invert",
        lambda K, x: K.enhance.invert(x),
        Bars(floor=1.1, half=1.7),
        {"torchvision": lambda x: tvision.invert(x)},
    ),
    case(
        "normalize",
        lambda K, x: K.enhance.normalize(x, *imagenet(x.dtype, x.device)),
        Bars(floor=1.12, both=1.3, half=1.7),
        {"torchvision": lambda x: tvision.normalize(x, *IMAGENET)},
    ),
    jitter("jitter", False, Bars(floor=1.2, both=1.3, half=1.7)),
    jitter("jitter_contrast", True, Bars(floor=1.8, launches=2)),
    jitter_each(),
    case(
        "equalize",
        lambda K, x: K.enhance.equalize(x),
        Bars(floor=2.0),
        {},
    ),
    Case(
        "equalize_opencv",
        lambda x: kvision.enhance.equalize(x, opencv=True),
        {"opencv": of_planes(lambda plane: cv2.equalizeHist(plane))},
        Bars(floor=2.0, opencv=1.0),
    ),
    case("clahe", lambda K, x: K.enhance.equalize_clahe(x), Bars(floor=4.0, launches=None), {}),
    Case(
        "clahe_opencv",
        lambda x: kvision.enhance.equalize_clahe(x, opencv=True),
        {"opencv": of_planes(clahe_opencv)},
        Bars(floor=4.0, launches=None, opencv=1.0),
    ),
    case(
        "histogram",
        lambda K, x: K.enhance.image_histogram2d(x, 0.0, 1.0, 256)[0],
        Bars(floor=6.0, launches=None),
        {},
        **nonlinear,
    ),
    case(
        "histogram_gaussian",
        lambda K, x: K.enhance.image_histogram2d(x, 0.0, 1.0, 256, kernel="gaussian")[0],
        Bars(floor=6.0, launches=None),
        {},
        **nonlinear,
    ),
    case(
        "histogram_gray",
        lambda K, x: K.enhance.image_histogram2d(x, 0.0, 1.0, 256)[0],
        Bars(launches=None),
        {},
        inputs=one_channel,
        **nonlinear,
    ),
    case("sharpness", lambda K, x: K.enhance.sharpness(x, 1.5), Bars(), {}, **nonlinear),
    case("add_weighted", lambda K, x, y: K.enhance.add_weighted(x, 0.6, y, 0.5, -0.1), Bars(), {}, inputs=two_images),
    case("min_max", lambda K, x: K.enhance.normalize_min_max(x), Bars(floor=2.0, launches=2), {}, **nonlinear),
]
