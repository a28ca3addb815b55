"""Decorators that let a function of (B, C, H, W) take any number of leading axes."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError

__all__ = ["perform_keep_shape_image", "perform_keep_shape_video"]


def perform_keep_shape_image(f: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Decorate a function of (B, C, H, W) to take (H, W), (C, H, W) or (*, C, H, W).

    Args:
        f: a function whose first argument and result are images (B, C, H, W). It must keep the batch size; it may change
            C, H and W. Empty batches are passed to it as well.

    Returns:
        The decorated function. Its result has the leading axes of its input; for (H, W) it is the first channel.

    Raises:
        TypeCheckError: the input of the decorated function is not a tensor.
        ShapeError: the input has less than two axes, or H or W is 0.

    Example:
        >>> import torch, kvision as K
        >>> @K.image.perform_keep_shape_image
        ... def first_row(input):
        ...     return input[:, :, :1]
        >>> first_row(torch.rand(2, 5, 3, 8, 9)).shape, first_row(torch.rand(8, 9)).shape
        (torch.Size([2, 5, 3, 1, 9]), torch.Size([1, 9]))
    """
    return _keep_shape(f, "C, H, W")


def perform_keep_shape_video(f: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Decorate a function of (B, C, D, H, W) to take (D, H, W), (C, D, H, W) or (*, C, D, H, W).

    Args:
        f: a function whose first argument and result are volumes (B, C, D, H, W). It must keep the batch size.

    Returns:
        The decorated function. Its result has the leading axes of its input; for (D, H, W) it is the first channel.

    Raises:
        TypeCheckError: the input of the decorated function is not a tensor.
        ShapeError: the input has less than three axes, or D, H or W is 0.

    Example:
        >>> import torch, kvision as K
        >>> @K.image.perform_keep_shape_video
        ... def first_frame(input):
        ...     return input[:, :, :1]
        >>> first_frame(torch.rand(3, 6, 8, 9)).shape
        torch.Size([3, 1, 8, 9])
    """
    return _keep_shape(f, "C, D, H, W")


def _keep_shape(f: Callable[..., Tensor], axes: str) -> Callable[..., Tensor]:
    op, rank = f.__name__, axes.count(",") + 1

    @wraps(f)
    def wrapper(input: Tensor, *args: Any, **kwargs: Any) -> Tensor:
        _check.is_tensor(op, "input", input)
        if input.dim() < rank - 1 or 0 in input.shape[1 - rank :]:
            raise ShapeError(
                f"{op}: expected input of shape (*, {axes}) with at least one pixel, got {tuple(input.shape)}",
                actual_shape=input.shape,
            )
        x = input[None] if input.dim() == rank - 1 else input
        leading = x.shape[:-rank]
        output = f(x.reshape(leading.numel(), *x.shape[-rank:]), *args, **kwargs)
        output = output.reshape(*leading, *output.shape[1:])
        return output[0] if input.dim() == rank - 1 else output

    return wrapper
