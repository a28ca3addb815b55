"""Connected regions of masks."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import pixels
from kvision._leading import apply_on_batch
from kvision._ops import register
from kvision.core.exceptions import ShapeError


def _reference(x: Tensor) -> Tensor:
    """int64 labels of masks (B, C, H, W): 1 + the index of the first pixel in its plane, 0 where the mask is not 1.

    Pointer jumping: every pixel starts as its root. A root links to the lowest root adjacent to its region,
    and every pixel links to the root of its root, until nothing changes.
    """
    inside = x == 1
    nothing = x.numel()
    roots = torch.arange(nothing, device=x.device).view(x.shape)
    while nothing > 0:
        lowest = _lowest_around(torch.where(inside, roots, nothing))
        lowest = torch.where(inside, lowest, roots)
        merged = roots.flatten().scatter_reduce(0, roots.flatten(), lowest.flatten(), "amin")
        while not torch.equal(merged, further := merged[merged]):
            merged = further
        if torch.equal(merged, roots.flatten()):
            break
        roots = merged.view(x.shape)
    return torch.where(inside, roots % (x.shape[-2] * x.shape[-1]) + 1, 0)


def _lowest_around(x: Tensor) -> Tensor:
    for axis, pads in ((3, (1, 1)), (2, (0, 0, 1, 1))):
        padded = F.pad(x, pads, value=x.numel())
        x = torch.minimum(
            torch.minimum(x, padded.narrow(axis, 0, x.shape[axis])), padded.narrow(axis, 2, x.shape[axis])
        )
    return x


def _fake(x: Tensor) -> Tensor:
    return x.new_empty(x.shape, dtype=torch.int64)


_connected_components = register(
    "connected_components", _reference, fake=_fake, non_differentiable=(0,), bytes=True, casts_outputs=True
)


def connected_components(image: Tensor, num_iterations: int = 100) -> Tensor:
    """Number the connected regions of masks, corners included (8-connected).

    Args:
        image: masks (*, 1, H, W), 1 inside of regions; every other value is outside.
        num_iterations: for compatibility, at least 1; the regions are complete whatever it is.

    Returns:
        int64 labels (*, 1, H, W): 0 outside, and for each region 1 + the index that its first pixel has in its image.

    Raises:
        TypeCheckError: image is not a real tensor; num_iterations not an int.
        ShapeError: image is not (*, 1, H, W).
        ValueCheckError: num_iterations below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.connected_components(torch.tensor([[[1., 0., 1.], [0., 0., 1.]]]))
        tensor([[[1, 0, 3],
                 [0, 0, 3]]])
    """
    _check.ints("connected_components", "num_iterations", num_iterations, 1)
    return _labels("connected_components", image)


def connected_components_union_find(image: Tensor) -> Tensor:
    """Number the connected regions of masks; the same as :func:`connected_components`.

    Args:
        image: masks (*, 1, H, W), 1 inside of regions.

    Returns:
        int64 labels (*, 1, H, W).

    Raises:
        TypeCheckError, ShapeError: as :func:`connected_components`.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.connected_components_union_find(torch.tensor([[[1., 0., 1.]]]))
        tensor([[[1, 0, 3]]])
    """
    return _labels("connected_components_union_find", image)


def _labels(op: str, image: Tensor) -> Tensor:
    _check.channels(op, "image", image, 1, ShapeError)
    if 0 in image.shape[-2:]:
        raise ShapeError(
            f"{op}: expected image with H, W of at least 1, got {tuple(image.shape)}", actual_shape=image.shape
        )
    return apply_on_batch(_connected_components, pixels(image))
