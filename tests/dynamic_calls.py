"""Calls of all public functions at two sizes, for tests of programs that are traced at one size and called at another one."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision as K
from benchmarks.sample_calls import SampleCall, Size, sample_calls

# The program is traced at one size and called at another one. No two numbers of a size are equal, nor equal to the 2, 3, 4, 5, 7 of
# coordinates, matrices, kernels and poses: torch takes equal sizes of an example for the same. Functions of colors take three
# channels only.
SIZES = (
    (Size(14, 6, 22, 38), Size(11, 8, 34, 52)),
    (Size(14, 3, 22, 38), Size(11, 3, 34, 52)),
)

# Functions that do not export, and why; at most 5% of the public names.
SIZE_OF_DATA = "the size of the result depends on the values"
NUMBERS = "gives a bool, a float or a list of floats of Python, computed from the values: a graph holds tensors"
LEFT_OUT = {
    **dict.fromkeys(("geometry.crop_by_boxes", "geometry.crop_by_boxes3d", "geometry.crop_by_indices"), SIZE_OF_DATA),
    **dict.fromkeys(
        (
            "geometry.batched_nms",
            "geometry.nms",
            "geometry.nms_rotated",
            "geometry.remove_small_boxes",
            "geometry.soft_nms",
        ),
        SIZE_OF_DATA,
    ),
    **dict.fromkeys(
        (
            "geometry.validate_bbox",
            "geometry.validate_bbox3d",
            "metrics.auc_from_errors",
            "metrics.mean_average_precision",
        ),
        NUMBERS,
    ),
    "contrib.vision_patches": "the grid of patches follows from the height and width, which a graph fixes",
}
CALLS = {call.name: call for call in sample_calls() if call.axes}


class Call(nn.Module):
    def __init__(self, call: SampleCall) -> None:
        super().__init__()
        self.call = call

    def forward(self, tensors: dict[str, Tensor]) -> list[Tensor]:
        return flat(self.call.call(K, tensors))


def flat(value: Any) -> list[Tensor]:
    if isinstance(value, Tensor):
        return [value]
    return [tensor for part in value for tensor in flat(part)] if isinstance(value, (list, tuple)) else []


def examples(name: str, device: torch.device) -> tuple[dict[str, Tensor], dict[str, Tensor], list[Tensor]]:
    """Tensors at two sizes, and the results of the second ones. Skips the test of a function that is left out."""
    if name in LEFT_OUT:
        pytest.skip(LEFT_OUT[name])
    warnings.simplefilter("ignore")
    call = CALLS[name]
    for first, second in SIZES:
        try:
            call.call(K, call.tensors(first, device))
            tensors = call.tensors(second, device)
            return call.tensors(first, device), tensors, flat(call.call(K, tensors))
        except ValueError:
            continue
    raise AssertionError(f"{call.name} takes neither size")
