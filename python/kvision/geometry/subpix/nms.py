"""Non-maxima suppression in windows of images and volumes."""

from __future__ import annotations

import itertools
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import VOLUME, FunctionModule
from kvision._ops import match_layout, register, wants_derivative
from kvision._torch_compat import in_function_transform, is_tracing

__all__ = ["NonMaximaSuppression2d", "NonMaximaSuppression3d", "nms2d", "nms3d", "nms3d_minmax"]


def _is_maximum(x, window, volumes):
    """The elements above all others of their window (z, y, x) of images (B, C, H, W) or volumes (B, D, H, W)."""
    before, after = [(k - 1) // 2 for k in window], [k // 2 for k in window]
    sizes = x.shape[1:] if volumes else (1, *x.shape[2:])
    if any(k > n for k, n in zip(window, sizes)):
        return torch.zeros_like(x, dtype=torch.bool)

    def shifted(offset):
        axes = range(1, 4) if volumes else range(2, 4)
        for axis, b, a, k in zip(axes, before[-len(axes) :], after[-len(axes) :], offset[-len(axes) :]):
            yield axis, b + k, x.shape[axis] - b - a

    def look(offset):
        crop = x
        for axis, start, length in shifted(offset):
            crop = crop.narrow(axis, start, length)
        return crop

    center = look((0, 0, 0))
    above = torch.ones_like(center, dtype=torch.bool)
    for offset in itertools.product(*(range(-b, a + 1) for b, a in zip(before, after))):
        if any(offset):
            above = above & (center > look(offset))
    reach = [side for b, a in zip(reversed(before), reversed(after)) for side in (b, a)]
    return F.pad(above, reach if volumes else reach[:4])


def _flags(x, window, volumes):
    """The mask of _is_maximum as uint8."""
    return match_layout(_is_maximum(x, window, volumes).to(torch.uint8), x)


def _empty(x, volumes, dtype=None):
    """Allocate a result, for images in their layout and for volumes contiguous."""
    result = x.new_empty(x.shape, dtype=dtype)
    return result if volumes else match_layout(result, x)


def _empty_flags(x, window, volumes):
    return _empty(x, volumes, torch.uint8)


def _reference(x, window, volumes, marked):
    """The maxima, with 0 elsewhere, and their mask, which is empty unless `marked`."""
    flags = _flags(x, window, volumes)
    return match_layout(torch.where(flags != 0, x, 0), x), flags if marked else _no_flags(x)


def _no_flags(x):
    return x.new_empty(x.shape[0], 0, dtype=torch.uint8)


_maxima = register(
    "nms",
    _reference,
    fake=lambda x, window, volumes, marked: [
        _empty(x, volumes),
        _empty_flags(x, window, volumes) if marked else _no_flags(x),
    ],
    gradients="input: apply_nms_mask(input=grad, flags=result1)",
    non_differentiable=(1,),
    casts_outputs=True,
)
register(
    "apply_nms_mask",
    lambda x, flags: torch.where(flags != 0, x, 0),
    gradients="input: apply_nms_mask(input=grad)",
    linear=True,
)
_maximum = register("nms_mask", _flags, fake=_empty_flags, casts_outputs=True)
_extrema = register(
    "nms_minmax_masks",
    lambda x, *options: tuple(_flags(v, *options) for v in (x, -x)),
    fake=lambda x, *options: [_empty_flags(x, *options) for _ in range(2)],
    casts_outputs=True,
)


def _nms(x, window, volumes, mask_only):
    if mask_only:
        return _as_bool(_maximum(x.detach(), window, volumes))
    return _maxima(x, window, volumes, wants_derivative(x))[0]


def _as_bool(flags):
    # A view of bytes as bool is free, but inductor does not compile the operators after it (torch 2.13), and vmap does
    # not know it (torch 2.11), nor torch.jit.trace.
    viewable = not (torch.compiler.is_compiling() or is_tracing() or in_function_transform())
    return flags.view(torch.bool) if viewable else flags != 0


def nms2d(input: Tensor, kernel_size: tuple[int, int], mask_only: bool = False) -> Tensor:
    """Keep the pixels that are above all others of their window and set the rest to 0.

    The window reaches (k - 1) // 2 pixels back and k // 2 ahead. Pixels whose window reaches out of the image are
    no maxima, nor are equal neighbors, NaN, and pixels with NaN in their window. The gradient goes to the maxima.

    Args:
        input: images (B, C, H, W). Integers are computed in float32.
        kernel_size: height and width of the window.
        mask_only: return whether each pixel is a maximum instead of the values.

    Returns:
        (B, C, H, W), of the dtype of `input`, or bool with `mask_only`.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `kernel_size` is not two ints; `mask_only` is not a bool.
        ValueError: `input` is not (B, C, H, W); an entry of `kernel_size` is below 1.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 0., 0.], [0., 5., 4., 0.], [0., 0., 0., 0.]]]])
        >>> K.geometry.nms2d(x, (3, 3))[0, 0, 1]
        tensor([0., 5., 0., 0.])
    """
    _check.images("nms2d", "input", input)
    window = [1, *_check.ints("nms2d", "kernel_size", kernel_size, 2, maximum=_check.LARGEST_WINDOW)]
    _check.flag("nms2d", "mask_only", mask_only)
    result: Tensor = _nms(floats(input), window, False, mask_only)
    return result


def nms3d(input: Tensor, kernel_size: tuple[int, int, int], mask_only: bool = False) -> Tensor:
    """Keep the voxels that are above all others of their window and set the rest to 0.

    The window reaches (k - 1) // 2 voxels back and k // 2 ahead. Voxels whose window reaches out of the volume are
    no maxima, nor are equal neighbors, NaN, and voxels with NaN in their window. The gradient goes to the maxima.

    Args:
        input: volumes (B, C, D, H, W). Integers are computed in float32.
        kernel_size: depth, height and width of the window.
        mask_only: return whether each voxel is a maximum instead of the values.

    Returns:
        (B, C, D, H, W), of the dtype of `input`, or bool with `mask_only`.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `kernel_size` is not three ints; `mask_only` is not a bool.
        ValueError: `input` is not (B, C, D, H, W); an entry of `kernel_size` is below 1.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.zeros(1, 1, 3, 3, 3)
        >>> x[0, 0, 1, 1, 1] = 2
        >>> K.geometry.nms3d(x, (3, 3, 3), mask_only=True).nonzero()
        tensor([[0, 0, 1, 1, 1]])
    """
    _check.volumes("nms3d", "input", input)
    window = list(_check.ints("nms3d", "kernel_size", kernel_size, 3, maximum=_check.LARGEST_WINDOW))
    _check.flag("nms3d", "mask_only", mask_only)
    result: Tensor = _nms(_stacked(input), window, True, mask_only)
    return result.reshape(input.shape)


def nms3d_minmax(input: Tensor) -> tuple[Tensor, Tensor]:
    """Find the voxels above, and those below, all of the 26 voxels around them, in one pass.

    Args:
        input: volumes (B, C, D, H, W). Integers are computed in float32.

    Returns:
        Two bool tensors (B, C, D, H, W): whether a voxel is a maximum, and whether it is a minimum. Voxels on the faces
        of the volume are neither.

    Raises:
        TypeError: `input` is not a tensor of real numbers.
        ValueError: `input` is not (B, C, D, H, W).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.zeros(1, 1, 3, 3, 3)
        >>> x[0, 0, 1, 1, 1] = -2
        >>> maxima, minima = K.geometry.nms3d_minmax(x)
        >>> int(maxima.sum()), int(minima.sum())
        (0, 1)
    """
    _check.volumes("nms3d_minmax", "input", input)
    result: Any = _extrema(_stacked(input).detach(), [3, 3, 3], True)
    maxima, minima = (_as_bool(x).reshape(input.shape) for x in result)
    return maxima, minima


def _stacked(input: Tensor) -> Tensor:
    """Volumes in the layout of the operators: (B * C, D, H, W)."""
    return floats(input).flatten(0, 1).contiguous()


class NonMaximaSuppression2d(FunctionModule):
    """Module form of :func:`nms2d`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.NonMaximaSuppression2d((3, 3))(torch.rand(1, 1, 6, 7)).shape
        torch.Size([1, 1, 6, 7])
    """

    def __init__(self, kernel_size: tuple[int, int]) -> None:
        super().__init__(kernel_size=kernel_size)

    def forward(self, x: Tensor, mask_only: bool = False) -> Tensor:
        return nms2d(x, self.kernel_size, mask_only)


class NonMaximaSuppression3d(FunctionModule):
    """Module form of :func:`nms3d`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.NonMaximaSuppression3d((3, 3, 3))(torch.rand(1, 1, 5, 6, 7)).shape
        torch.Size([1, 1, 5, 6, 7])
    """

    samples = (VOLUME,)

    def __init__(self, kernel_size: tuple[int, int, int]) -> None:
        super().__init__(kernel_size=kernel_size)

    def forward(self, x: Tensor, mask_only: bool = False) -> Tensor:
        return nms3d(x, self.kernel_size, mask_only)
