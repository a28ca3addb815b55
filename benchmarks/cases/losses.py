"""Losses, metrics, morphology and patches, which training loops call in every step.

Losses are measured as in training.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nbytes, photographs
from benchmarks.peers import optional

cv2 = optional("cv2")
kornia = optional("kornia")

CLASSES = 21


def case(name: str, call: Callable[..., Any], bars: Bars, peers: dict[str, Callable[..., Any]], **more: Any) -> Case:
    """A case whose `call(library, inputs...)` is the same for kvision and Kornia."""
    return Case(name, partial(call, kvision), {"kornia": partial(call, kornia), **peers}, bars, **more)


def append_zero(y: Tensor) -> Tensor:
    """Append a zero to losses. Results are compared relative to their range, and a single number has none."""
    return torch.cat([y.new_zeros(1), y.flatten()])


def of_loss(inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> int:
    """Bytes of a loss's backward: all inputs are read and the gradient of the first one is written."""
    return nbytes(inputs) + nbytes(inputs[:1])


def pairs(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    (x,) = photographs(size, dtype, device)
    return x, (0.9 * x + 0.1 * x.flip(-1)).contiguous()


def segmentation(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """Logits of 21 classes with as many pixels in total, and labels."""
    b, _, h, w = size
    generator = torch.Generator(device).manual_seed(0)
    logits = torch.randn((max(1, b // 8), CLASSES, h, w), dtype=torch.float32, device=device, generator=generator)
    labels = torch.randint(0, CLASSES, (len(logits), h, w), device=device, generator=generator)
    return (2 * logits).to(dtype), labels


def masks(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    (x,) = photographs(size, dtype, device)
    return ((x.mean(1, keepdim=True) > 0.5).to(dtype),)


def depth_and_image(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    (x,) = photographs(size, dtype, device)
    return 0.1 + x.mean(1, keepdim=True), x


def window(height: int, width: int, x: Tensor) -> Tensor:
    """A structuring element, created in the call as by users. It counts as one launch."""
    return torch.ones(height, width, device=x.device)


def morphology(name: str, height: int, width: int, bars: Bars) -> Case:
    element = np.ones((height, width), np.uint8)
    opencv = cv2.dilate if name == "dilation" else cv2.erode if name == "erosion" else None

    def work(x, out=None):
        return opencv(x, element, out)

    return case(
        f"{name}{height}",
        lambda K, x: getattr(K.morphology, name)(x, window(height, width, x)),
        bars,
        {"opencv": work},
        backward=lambda inputs, outputs: nbytes(outputs) + 2 * nbytes(inputs),
    )


as_number = {"result": append_zero, "border": 0}
segmentations = {"inputs": segmentation, "backward": of_loss, **as_number}
images = {"inputs": pairs, "backward": of_loss}

CASES = [
    case("ssim11", lambda K, x, y: K.metrics.ssim(x, y, 11), Bars(floor=1.6, both=2.5), {}, **images),
    case(
        "ssim_loss11",
        lambda K, x, y: K.losses.ssim_loss(x, y, 11),
        Bars(floor=1.6, both=2.5, launches=2),
        {},
        **images,
        **as_number,
    ),
    case("ssim_loss31", lambda K, x, y: K.losses.ssim_loss(x, y, 31), Bars(launches=2), {}, **images, **as_number),
    case(
        "ms_ssim",
        lambda K, x, y: K.losses.MS_SSIMLoss().to(x.device)(x, y),
        Bars(launches=2),
        {},
        **images,
        **as_number,
    ),
    Case(
        "l1_ssim_loss11",
        lambda x, y: kvision.losses.l1_ssim_loss(x, y, 11),
        {},
        Bars(floor=1.6, both=2.5, launches=2),
        pairs,
        backward=of_loss,
        **as_number,
    ),
    case(
        "charbonnier",
        lambda K, x, y: K.losses.charbonnier_loss(x, y, "mean"),
        Bars(floor=1.15, both=1.4, launches=2),
        {},
        **images,
        **as_number,
    ),
    case(
        "psnr",
        lambda K, x, y: K.metrics.psnr(x, y, 1.0),
        Bars(floor=1.15, both=1.4, launches=2),
        {},
        **images,
        **as_number,
    ),
    case(
        "total_variation",
        lambda K, x: K.losses.total_variation(x),
        Bars(floor=1.2, both=1.4, launches=2),
        {},
        backward=of_loss,
        **as_number,
    ),
    case(
        "smoothness",
        lambda K, x, image: K.losses.inverse_depth_smoothness_loss(x, image),
        Bars(both=1.4, launches=3),
        {},
        inputs=depth_and_image,
        backward=of_loss,
        **as_number,
    ),
    case(
        "focal",
        lambda K, x, t: K.losses.focal_loss(x, t, 0.5, reduction="mean"),
        Bars(both=1.5, launches=None),
        {},
        **segmentations,
    ),
    case("dice", lambda K, x, t: K.losses.dice_loss(x, t), Bars(both=1.5, launches=None), {}, **segmentations),
    case(
        "tversky",
        lambda K, x, t: K.losses.tversky_loss(x, t, 0.5, 0.5),
        Bars(both=1.5, launches=None),
        {},
        **segmentations,
    ),
    morphology("dilation", 3, 3, Bars(floor=1.2, both=1.4, launches=2, opencv=1.0)),
    morphology("erosion", 3, 3, Bars(floor=1.2, both=1.4, launches=2, opencv=1.0)),
    morphology("dilation", 15, 15, Bars(floor=1.5, both=1.4, launches=2, opencv=1.0)),
    case(
        "patches32",
        lambda K, x: K.contrib.extract_tensor_patches(x, 32, 32),
        Bars(floor=1.1, both=1.4),
        {},
    ),
    Case(
        "components",
        lambda x: kvision.contrib.connected_components(x),
        {},  # the numbering of labels differs between libraries
        Bars(launches=None),
        masks,
    ),
]
