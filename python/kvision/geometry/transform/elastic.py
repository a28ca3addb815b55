"""Elastic deformation of images."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Interpolation, PaddingOrFill
from kvision._dtype import compute_dtype
from kvision._modes import INTERPOLATION
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.filters.smoothing.gaussian import _gaussian_blur2d as blur
from kvision.filters.smoothing.gaussian import blur_arguments
from kvision.geometry.transform import sampling
from kvision.geometry.transform.nearest import as_values, of_values

__all__ = ["elastic_transform2d"]


def elastic_transform2d(
    image: Tensor,
    noise: Tensor,
    kernel_size: tuple[int, int] = (63, 63),
    sigma: tuple[float, float] | Tensor = (32.0, 32.0),
    alpha: tuple[float, float] | Tensor = (1.0, 1.0),
    align_corners: bool = False,
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
) -> Tensor:
    """Deform images by a smooth random displacement field: noise after a Gaussian blur.

    Args:
        image: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        noise: displacements along x and y, (B, 2, H, W), in units of half the image's width and height.
        kernel_size: size of the blur's kernel, (y, x), odd.
        sigma: standard deviations of the blur in pixels, (y, x), positive; a tensor of one or two gets a
            gradient.
        alpha: factors of the noise, (x, y); a tensor of one or two gets a gradient.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.

    Returns:
        (B, C, H, W), of the dtype of `image`.

    Raises:
        TypeError: `image` or `noise` is not a tensor of real numbers; `kernel_size` is not two ints; `sigma` or `alpha` is
            not two numbers or a tensor; `align_corners` is not a bool.
        ValueError: `image` is not (B, C, H, W); `noise` is not (B, 2, H, W); an entry of `kernel_size` is even; `sigma`
            is not positive; `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Source: P. Simard, D. Steinkraus and J. Platt, "Best practices for convolutional neural networks" (2003).

    Example:
        >>> import torch, kvision as K
        >>> image = torch.rand(1, 3, 5, 5)
        >>> still = K.geometry.elastic_transform2d(image, torch.zeros(1, 2, 5, 5))
        >>> torch.allclose(still, image, atol=1e-6)
        True
    """
    op = "elastic_transform2d"
    _check.images(op, "image", image)
    _check.shape(op, "noise", noise, "B", 2, *image.shape[2:])
    sampling.check_options(op, mode, padding_mode, align_corners)
    images = as_values(image, mode)
    _check.same_device(op, image=image, noise=noise)
    noise = sampling.cast_to_image(op, images, "noise", noise)
    if isinstance(sigma, Tensor) or not _are_numbers(sigma):
        sigma = _two(op, "sigma", sigma, images)[None]
    arguments = blur_arguments(op, noise, kernel_size, sigma, "constant")
    # The noise is scaled before the blur, so that no step follows the blur.
    if not _are_numbers(alpha) or alpha[0] != alpha[1]:
        noise = noise * _two(op, "alpha", alpha, images)[:, None, None]
    elif alpha[0] != 1:
        noise = noise * alpha[0]
    right, down = blur(noise, *arguments[1:]).unbind(1)
    padding, _ = sampling.padding_and_fill(op, images, padding_mode, None)
    options = (INTERPOLATION[mode], padding, align_corners, True, True)
    return of_values(sampling.remap(images, right, down, None, None, *options), image, mode)


def _are_numbers(x: Tensor | Sequence[float]) -> bool:
    return isinstance(x, (tuple, list)) and len(x) == 2 and all(isinstance(v, (int, float)) for v in x)


def _two(op: str, name: str, x: Tensor | Sequence[float], like: Tensor) -> Tensor:
    dtype = compute_dtype(like)
    if isinstance(x, Tensor):
        if x.numel() not in (1, 2):
            raise ShapeError(f"{op}: expected {name} of one or two numbers, got a Tensor {tuple(x.shape)}")
        return _check.to_device_of(op, like, name, x, of="image").to(dtype).reshape(-1).expand(2)
    if not isinstance(x, (tuple, list)) or len(x) != 2:
        raise TypeCheckError(f"{op}: expected {name} to be two numbers or a Tensor, got {x!r}")
    return torch.stack([_number(op, name, v, like, dtype) for v in x])


def _number(op: str, name: str, value: Tensor | float, like: Tensor, dtype: torch.dtype) -> Tensor:
    if isinstance(value, Tensor):
        return _check.to_device_of(op, like, name, value, of="image").to(dtype)
    return like.new_full(
        (), _check.number(op, name, value), dtype=dtype
    )  # created on the device, without a copy from the host
