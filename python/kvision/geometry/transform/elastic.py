"""Elastic deformation of images."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, pixels
from kvision.core.exceptions import TypeCheckError
from kvision.filters import filter2d_separable, get_gaussian_kernel1d
from kvision.geometry.transform import sampling

__all__ = ["elastic_transform2d"]


def elastic_transform2d(
    image: Tensor,
    noise: Tensor,
    kernel_size: tuple[int, int] = (63, 63),
    sigma: tuple[float, float] | Tensor = (32.0, 32.0),
    alpha: tuple[float, float] | Tensor = (1.0, 1.0),
    align_corners: bool = False,
    mode: str = "bilinear",
    padding_mode: str = "zeros",
) -> Tensor:
    """Bend images by a field of random moves that is smooth: noise after a Gaussian blur.

    Args:
        image: images (B, C, H, W), floating point or uint8. Other integers are computed in float32.
        noise: (B, 2, H, W), moves along x and y, in units of half the image's width and height.
        kernel_size: of the blur, (y, x), odd.
        sigma: of the blur, (y, x); a tensor gets a gradient.
        alpha: how much of the noise is taken, (x, y); a tensor gets a gradient.
        align_corners: the image reaches from the middle of its first pixel to that of its last one, not from edge to edge.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.

    Returns:
        (B, C, H, W), of the type of `image`.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: a shape, size or name is not as above.

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
    sampling.check_how(op, mode, padding_mode, align_corners)
    ky, kx = _check.pair(op, "kernel_size", kernel_size)
    images = pixels(image)
    noise = sampling.for_images(op, images, "noise", noise)
    sigmas, (right, down) = (_two(op, name, x, images) for name, x in (("sigma", sigma), ("alpha", alpha)))
    kernel_y = get_gaussian_kernel1d(ky, sigmas[:1, None])
    kernel_x = get_gaussian_kernel1d(kx, sigmas[1:, None])
    moves = filter2d_separable(noise, kernel_x, kernel_y, "constant")
    h, w = image.shape[2:]
    less = 1 if align_corners else 0
    x = torch.arange(w, dtype=moves.dtype, device=moves.device) + moves[:, 0] * (right * (w - less) / 2)
    y = torch.arange(h, dtype=moves.dtype, device=moves.device)[:, None] + moves[:, 1] * (down * (h - less) / 2)
    padding, _ = sampling.padding_and_fill(op, images, padding_mode, None)
    return sampling.remap(images, x, y, None, mode, padding, align_corners, False)


def _two(op: str, name: str, x: Tensor | Sequence[float], like: Tensor) -> Tensor:
    dtype = compute_dtype(like)
    if isinstance(x, Tensor):
        return x.to(like.device, dtype).reshape(-1).expand(2)
    if not isinstance(x, (tuple, list)) or len(x) != 2:
        raise TypeCheckError(f"{op}: expected {name} to be two numbers or a Tensor, got {x!r}")
    return torch.stack([_number(op, name, v, like, dtype) for v in x])


def _number(op: str, name: str, value: Tensor | float, like: Tensor, dtype: torch.dtype) -> Tensor:
    if isinstance(value, Tensor):
        return value.to(like.device, dtype)
    return like.new_full((), _check.number(op, name, value), dtype=dtype)  # made there: a copy would wait
