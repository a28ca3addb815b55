"""Morphological reconstruction."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._torch_compat import without_transforms
from kvision.morphology.dilation import dilated

Method: TypeAlias = Literal["dilation", "erosion"]
_METHODS = get_args(Method)
Engine: TypeAlias = Literal["auto", "unfold", "shift"]
_ENGINES = get_args(Engine)


def reconstruction(
    seed: Tensor,
    mask: Tensor,
    kernel: Tensor | None = None,
    method: Method = "dilation",
    num_iters: int | None = None,
    check_every: int = 4,
    engine: Engine = "auto",
) -> Tensor:
    """Reconstruct morphologically: dilate a seed and take the minimum with the mask, until nothing changes.

    Args:
        seed: images (B, C, H, W), floating point or uint8; values above the mask are clamped to it first.
        mask: images of the same shape. Of two types, the wider one is that of the result.
        kernel: the mask of the flat structuring element, of odd size and with its center set; None for 3 x 3.
        method: 'dilation', or 'erosion' for a seed that shrinks above the mask.
        num_iters: the number of steps; None iterates until nothing changes, which waits for the device.
        check_every: number of steps between two checks for convergence.
        engine: for compatibility, 'auto', 'unfold' or 'shift'; the result is the same.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError: not two tensors of floats or uint8.
        ShapeError: not (B, C, H, W), or different shapes; kernel of other than two axes.
        ValueCheckError: an even kernel; an unknown method or engine; num_iters or check_every too small.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: L. Vincent, "Morphological grayscale reconstruction in image analysis" (1993).

    Example:
        >>> import torch, kvision as K
        >>> mask = torch.tensor([[[[5., 3., 4., 0., 9.]]]])
        >>> K.morphology.reconstruction(torch.tensor([[[[5., 0., 0., 0., 0.]]]]), mask)
        tensor([[[[5., 3., 3., 0., 0.]]]])
    """
    op = "reconstruction"
    for name, x in (("seed", seed), ("mask", mask)):
        _check.images(op, name, x)
        _check.floating_or_bytes(op, name, x)
    _check.same_shape(op, seed=seed, mask=mask)
    _check.same_device(op, seed=seed, mask=mask)
    wider = torch.promote_types(seed.dtype, mask.dtype)
    seed, mask = as_dtype(seed, wider), as_dtype(mask, wider)
    if kernel is None:
        kernel = torch.ones(3, 3, dtype=torch.bool, device=seed.device)
    _check.shape(op, "kernel", kernel, "kH", "kW")
    _check.odd(op, "kernel", kernel.shape)
    kernel = _check.to_device_of(op, seed, "kernel", kernel, of="seed")
    _check.choice(op, "method", method, _METHODS)
    _check.choice(op, "engine", engine, _ENGINES)
    if num_iters is not None:
        _check.ints(op, "num_iters", num_iters, 1, 0)
    _check.ints(op, "check_every", check_every, 1)
    origin = (kernel.shape[0] // 2, kernel.shape[1] // 2)
    members = (kernel != 0).to(compute_dtype(seed))[None]
    if method == "erosion":
        return _reversed(_grown(_reversed(seed), _reversed(mask), members, origin, num_iters, check_every))
    return _grown(seed, mask, members, origin, num_iters, check_every)


def _reversed(x: Tensor) -> Tensor:
    """Values in the opposite order."""
    return ~x if x.dtype == torch.uint8 else -x


def _grown(
    seed: Tensor, mask: Tensor, members: Tensor, origin: tuple[int, int], steps: int | None, check_every: int
) -> Tensor:
    y = torch.minimum(seed, mask)

    def after(y: Tensor, steps: int) -> Tensor:
        for _ in range(steps):
            y = torch.minimum(torch.maximum(y, dilated(y, members, None, origin, None)), mask)
        return y

    if steps is not None:
        return after(y, steps)
    while True:
        previous, y = y, after(y, check_every)
        if not without_transforms(y > previous).any():
            return y
