"""Flips and rotations by 180 degrees."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import SIGNED
from kvision._modules import FunctionModule
from kvision._ops import FastPath, register
from kvision._torch_compat import below_autograd, is_tracing
from kvision.core.exceptions import ShapeError

__all__ = ["Hflip", "Rot180", "Vflip", "hflip", "rot180", "vflip"]


def _reference(input, columns, rows):
    return input.flip([axis for axis, flips in ((2, rows), (3, columns)) if flips])


flipped = register("flip", _reference, gradients="input: flip(input=grad)", linear=True, bytes=True)
# A copy of a large image empties the caches, after which each Python frame of a call takes microseconds.
_fast = FastPath("flip", flipped.dtypes)

_LARGE = 1 << 16  # bytes


def hflip(input: Tensor) -> Tensor:
    """Flip images horizontally: reverse their columns.

    Args:
        input: images (*, H, W) of any real dtype, or one row (W,).

    Returns:
        Images of the shape and dtype of `input`.

    Raises:
        TypeError: `input` is not a dense tensor of real numbers.
        ValueError: `input` has no axes.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.hflip(torch.tensor([[1, 2], [3, 4]]))
        tensor([[2, 1],
                [4, 3]])
    """
    return _flip("hflip", input, (-1,))


def vflip(input: Tensor) -> Tensor:
    """Flip images vertically: reverse their rows.

    Args:
        input: images (*, H, W) of any real dtype, or one row (W,).

    Returns:
        Images of the shape and dtype of `input`.

    Raises:
        TypeError: `input` is not a dense tensor of real numbers.
        ValueError: `input` has no axes.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.vflip(torch.tensor([[1, 2], [3, 4]]))
        tensor([[3, 4],
                [1, 2]])
    """
    return _flip("vflip", input, (-2,))


def rot180(input: Tensor) -> Tensor:
    """Rotate images by 180 degrees: reverse their rows and columns.

    Args:
        input: images (*, H, W) of any real dtype, or one row (W,).

    Returns:
        Images of the shape and dtype of `input`.

    Raises:
        TypeError: `input` is not a dense tensor of real numbers.
        ValueError: `input` has no axes.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.rot180(torch.tensor([[1, 2], [3, 4]]))
        tensor([[4, 3],
                [2, 1]])
    """
    return _flip("rot180", input, (-2, -1))


def _flip(op: str, input: Tensor, axes: tuple[int, ...]) -> Tensor:
    if type(input) is Tensor and input.dim() == 4 and _fast.serves(input) and input.numel() * input.itemsize >= _LARGE:
        with below_autograd():
            return _fast.kernel(input, -1 in axes, -2 in axes)
    _check.numbers(op, "input", input)
    if input.dim() == 1:
        return _flip(op, input[None], axes)[0]
    if input.dim() == 0:
        raise ShapeError(f"{op}: expected input of shape (*, H, W), got {tuple(input.shape)}", actual_shape=input.shape)
    if input.dtype in SIGNED:
        return _flip(op, input.view(SIGNED[input.dtype]), axes).view(input.dtype)
    if _torch_is_fast(input) or input.dtype not in flipped.dtypes or 0 in input.shape[-2:]:
        return input.flip(axes)
    columns, rows = -1 in axes, -2 in axes
    if input.dim() == 4:
        return flipped(input, columns, rows)
    images = input.reshape(-1, *input.shape[-3:]) if input.dim() > 2 else input[None, None]
    return flipped(images, columns, rows).reshape(input.shape)


def _torch_is_fast(x: Tensor) -> bool:
    """Whether torch's flip takes less time than the kernel, as of float32 and float64 on the CPU.

    The kernel's large results are not in memory that is new to the process, see docs/notes/memory.md.
    """
    if not x.is_cpu or x.dtype not in (torch.float32, torch.float64):
        return False
    if is_compiling() or is_tracing() or (x.requires_grad and torch.is_grad_enabled()):
        return True
    return x.numel() * x.element_size() < _LARGE


class Hflip(FunctionModule):
    """Module form of :func:`hflip`.

    Example:
        >>> import kvision as K
        >>> K.geometry.Hflip()
        Hflip()
    """

    def forward(self, input: Tensor) -> Tensor:
        return hflip(input)


class Vflip(FunctionModule):
    """Module form of :func:`vflip`.

    Example:
        >>> import kvision as K
        >>> K.geometry.Vflip()
        Vflip()
    """

    def forward(self, input: Tensor) -> Tensor:
        return vflip(input)


class Rot180(FunctionModule):
    """Module form of :func:`rot180`.

    Example:
        >>> import kvision as K
        >>> K.geometry.Rot180()
        Rot180()
    """

    def forward(self, input: Tensor) -> Tensor:
        return rot180(input)
