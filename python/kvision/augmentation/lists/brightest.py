"""The largest values of the images of a list."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision.augmentation.corruption.layer import add_layer


def _reference(images: Sequence[Tensor]) -> list[Tensor]:
    """One tensor (B,) of the type that is computed in, of at least 0."""
    return [torch.stack([x.to(compute_dtype(x)).amax().clamp(min=0) for x in images])]


def _gradients(needs: Sequence[bool], grads: Any, results: Any, images: Sequence[Tensor]) -> list[Any]:
    """Pixels that have the value share its gradient."""
    of_images = []
    for x, most, grad in zip(images, results[0].unbind(), grads[0].unbind()):
        shares = (x == most).to(grad)
        of_images.append((shares * (grad / shares.sum().clamp(min=1))).to(x.dtype))
    return [of_images]


_brightest = ListOperator(
    "brightest_list",
    add_layer,  # which has kernels where this has them
    _reference,
    fake=lambda images: [images[0].new_empty(len(images), dtype=compute_dtype(images[0]))],
    backward=_gradients,
    saves_results=True,
)


def brightest(images: Sequence[Tensor]) -> Tensor:
    """The largest values (B,) of images (C, H, W), at least 0, of the type that is computed in."""
    return _brightest(images)[0]
