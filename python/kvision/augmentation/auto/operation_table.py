"""The operations of policies, by name: what they do with a sample's value, for a whole batch at once.

An operation is a number of the sample, and so is its value. What a step of a policy executes on a batch:

    all operations that move pixels       one matrix a sample (the identity for other operations) and one warp
    all operations on single pixels       one color program, whose order has the step of each sample's operation alone
    sharpness, equalize and auto_contrast     a pass each, if the policy has them
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from kvision import enhance
from kvision.augmentation import transforms
from kvision.augmentation.container.runs import Stage, Warp
from kvision.augmentation.geometric_base import warp
from kvision.augmentation.transforms import transform_matrix
from kvision.augmentation.warp_and_color import ColorPart, ColorStep, Resampling, make_pass
from kvision.enhance.posterize import SPLIT


class Operation(NamedTuple):
    """An operation of policies. `neutral` is the value that changes nothing, about which values are mirrored at random."""

    number: int
    neutral: float | None = None


_NAMES = {
    "identity": None,
    "auto_contrast": None,
    "equalize": None,
    "invert": None,
    "rotate": 0.0,  # degrees, counter-clockwise
    "posterize": None,  # bits that are kept
    "solarize": None,  # threshold
    "solarize_add": None,  # what is added before values of at least 0.5 are inverted
    "color": 1.0,  # factors: 0 for gray, mean gray, black, smooth
    "contrast": 1.0,
    "brightness": 1.0,
    "sharpness": 1.0,
    "shear_x": 0.0,  # tangents of the angles
    "shear_y": 0.0,
    "translate_x": 0.0,  # fractions of width and height
    "translate_y": 0.0,
    "translate_x_pixels": 0.0,
    "translate_y_pixels": 0.0,
}
OPERATIONS = {name: Operation(number, neutral) for number, (name, neutral) in enumerate(_NAMES.items())}

_GEOMETRIC = (
    "rotate",
    "shear_x",
    "shear_y",
    "translate_x",
    "translate_y",
    "translate_x_pixels",
    "translate_y_pixels",
)
_COLOR = {  # all take the value from column 0
    "invert": ColorStep("scale_shift", (-1.0, 1.0, 0.0)),
    "posterize": ColorStep("posterize", (0.0, 1.0), (0, -1)),
    "solarize": ColorStep("solarize", (0.0, 0.0, 1.0), (0, -1)),
    "solarize_add": ColorStep("solarize", (0.5, 0.0, 1.0), (-1, 0)),
    "color": ColorStep("saturation_gray", (0.0,), (0,)),
    "contrast": ColorStep("contrast", (0.0,), (0,)),
    "brightness": ColorStep("scale_shift", (0.0, 0.0, 1.0), (0,)),
}
_BILINEAR = Resampling("bilinear", "zeros")


def execute_step(x: Tensor, names: Sequence[str], operation: Tensor, value: Tensor) -> tuple[Tensor, list[Stage]]:
    """Run one operation on each image.

    Args:
        x: images (B, C, H, W).
        names: the operations that may occur.
        operation: numbers (B,) of the operations, -1 for none.
        value: (B,), the values of the operations.

    Returns:
        The images, and what labels have to follow.
    """
    stages: list[Stage] = []
    size = (x.shape[-2], x.shape[-1])
    if any(name in names for name in _GEOMETRIC):
        matrix = _matrix(operation, value, *size)
        x = warp(x, matrix, size, _BILINEAR)
        stages.append(Warp(matrix, size, size, _BILINEAR))
    color = [name for name in _COLOR if name in names]
    if color:
        values = torch.where(operation == OPERATIONS["posterize"].number, value.round(), value)
        order = [torch.where(is_one(operation, name), float(i), -1.0) for i, name in enumerate(color)]
        columns = torch.stack([values, *order], 1)
        steps = [_COLOR[name] for name in color]
        if x.dtype in SPLIT:
            steps = [
                step._replace(parameters=(0.0, SPLIT[x.dtype])) if step.name == "posterize" else step for step in steps
            ]
        x, _ = make_pass(None, parts=[ColorPart(steps, 0, range(1, 1 + len(steps)))]).run(x, columns)
    for name, function in _ALONE.items():
        if name in names:
            chosen = is_one(operation, name)
            x = torch.where(chosen[:, None, None, None], _on_floats(function, x, chosen, value), x)
    return x, stages


def is_one(operation: Tensor, name: str) -> Tensor:
    """(B,), whether the operation of a sample is that of the name."""
    return operation == OPERATIONS[name].number


def _matrix(operation: Tensor, value: Tensor, height: int, width: int) -> Tensor:
    """The matrices (B, 3, 3) of the samples' operations, about the centers of images."""

    def of(name: str) -> Tensor:
        return torch.where(is_one(operation, name), value, 0.0)

    columns = [
        of("rotate"),
        of("translate_x") * width + of("translate_x_pixels"),
        of("translate_y") * height + of("translate_y_pixels"),
        of("shear_x").atan().rad2deg(),
        of("shear_y").atan().rad2deg(),
    ]
    chain = transforms.affine(transforms.center_of((height, width)), angle=0, translation=(1, 2), shear=(3, 4))
    return transform_matrix(torch.stack(columns, 1), [chain])


def _on_floats(function: Callable[..., Tensor], x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    """A function of images in [0, 1], on images of any type."""
    if x.dtype != torch.uint8:
        return function(x, chosen, value).to(x.dtype)
    y = function(x.float() / 255, chosen, value)
    return (y * 255).round().clamp(0, 255).to(torch.uint8)


def _sharpness(x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    return enhance.sharpness(x, torch.where(chosen, value, 1.0).to(x.dtype))


def _equalize(x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    return enhance.equalize(x)


def _auto_contrast(x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    flat = x.amax((-2, -1), keepdim=True) == x.amin((-2, -1), keepdim=True)
    return torch.where(flat, x, enhance.normalize_min_max(x))


_ALONE = {"sharpness": _sharpness, "equalize": _equalize, "auto_contrast": _auto_contrast}
