"""Bytes of color images: in [0, 1] as all images, or the 8-bit codes that OpenCV has for a color space."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._leading import apply_on_batch
from kvision.color.program import arguments, run
from kvision.color.steps import STEPS
from kvision.core.exceptions import TypeCheckError

Three = tuple[float, float, float]


def of_rgb(convert: Callable[..., Tensor], image: Tensor, *parameters: float) -> Tensor:
    """`convert`, a step, of RGB images (*, 3, H, W), in floating point.

    Bytes are 255ths, as the step reads them; other integers are taken as they are.
    """
    if image.dtype == torch.uint8:
        return apply_on_batch(partial(convert, dtype=torch.float32), image, *parameters)
    return apply_on_batch(convert, floats(image), *parameters)


def values(op: str, image: Tensor) -> Tensor:
    """Images of a color space in floating point. Its bytes are codes, whose meaning the caller has to name."""
    if image.dtype == torch.uint8:
        raise TypeCheckError(
            f"{op}: expected image to be floating point, or opencv=True for 8-bit codes, got torch.uint8"
        )
    return floats(image)


def are_codes(op: str, image: Tensor, opencv: bool) -> bool:
    """Whether the call takes and gives OpenCV's codes, which are bytes."""
    _check.flag(op, "opencv", opencv)
    if opencv and image.dtype != torch.uint8:
        raise TypeCheckError(f"{op}: expected image to be uint8 with opencv, got {image.dtype}")
    return opencv


def encoder(step: str, scale: Three, offset: Three) -> Callable[..., Tensor]:
    """Bytes of RGB to codes: the values that `step` gives, times `scale` plus `offset`, rounded and saturated."""
    steps = [STEPS[step].number, STEPS["scale_shift_rgb"].number]
    in_255ths = [*(s / 255 for s in scale), *(o / 255 for o in offset), 0.0]
    return lambda x, *numbers: run(x, steps, arguments([*numbers, *in_255ths]))


def decoder(step: str, scale: Three, offset: Three) -> Callable[..., Tensor]:
    """Codes to bytes of RGB, by `step`; the inverse of :func:`encoder`."""
    steps = [STEPS["scale_shift_rgb"].number, STEPS[step].number]
    of_255ths = [*(255 / s for s in scale), *(-o / s for o, s in zip(offset, scale)), 0.0]
    return lambda x, *numbers: run(x, steps, arguments([*of_255ths, *numbers]))
