"""Adding an alpha channel, and removing it by composition with a background."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision._leading import apply_on_batch, flatten_batch
from kvision._modules import FunctionModule
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


def _reference(x: Tensor, background: Tensor) -> Tensor:
    return torch.lerp(background, x[:, :3], x[:, 3:])


_rgba_to_rgb = with_kernel_casts(_reference)


def rgb_to_rgba(image: Tensor, alpha_val: float | Tensor) -> Tensor:
    """Append an alpha channel.

    Args:
        image: RGB images (*, 3, H, W) of any type.
        alpha_val: opacity, a float for all pixels or a tensor (*, 1, H, W): 1 is opaque, 0 transparent.

    Returns:
        RGBA images (*, 4, H, W) in the type of the image.

    Raises:
        TypeCheckError: image is not a tensor; alpha_val is neither a float nor a tensor.
        ShapeError: image is not (*, 3, H, W); a tensor alpha_val of another shape than one channel of it.
        DeviceError: image and alpha_val on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_rgba(torch.zeros(3, 1, 1), 0.5).flatten()
        tensor([0.0000, 0.0000, 0.0000, 0.5000])
    """
    _check.channels("rgb_to_rgba", "image", image, 3)
    return torch.cat([image, _alpha("rgb_to_rgba", image, alpha_val)], -3)


def bgr_to_rgba(image: Tensor, alpha_val: float | Tensor) -> Tensor:
    """Reverse the channels and append an alpha channel.

    Args:
        image: BGR images (*, 3, H, W) of any type.
        alpha_val: opacity, a float for all pixels or a tensor (*, 1, H, W): 1 is opaque, 0 transparent.

    Returns:
        RGBA images (*, 4, H, W), red first, in the type of the image.

    Raises:
        TypeCheckError: image is not a tensor; alpha_val is neither a float nor a tensor.
        ShapeError: image is not (*, 3, H, W); a tensor alpha_val of another shape than one channel of it.
        DeviceError: image and alpha_val on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.color.bgr_to_rgba(torch.tensor([0.1, 0.2, 0.3]).view(3, 1, 1), 1.0).flatten()
        tensor([0.3000, 0.2000, 0.1000, 1.0000])
    """
    _check.channels("bgr_to_rgba", "image", image, 3)
    blue, green, red = image.split(1, -3)
    return torch.cat([red, green, blue, _alpha("bgr_to_rgba", image, alpha_val)], -3)


def _alpha(op: str, image: Tensor, alpha: float | Tensor) -> Tensor:
    channel = image[..., :1, :, :]
    if not isinstance(alpha, Tensor):
        alpha = _check.scalar(op, "alpha_val", alpha)
    elif alpha.dim() == 0:
        _check.numbers(op, "alpha_val", alpha)
        return _check.to_device_of(op, image, "alpha_val", alpha, of="image").to(image.dtype).expand(channel.shape)
    if isinstance(alpha, float):
        _check.representable(op, "alpha_val", alpha, channel.dtype if channel.is_floating_point() else torch.float32)
        return torch.full_like(channel, alpha)
    if not isinstance(alpha, Tensor):
        raise TypeCheckError(f"{op}: expected alpha_val to be a float or a Tensor, got {alpha!r}")
    _check.numbers(op, "alpha_val", alpha)
    if alpha.shape != channel.shape:
        raise ShapeError(f"{op}: expected alpha_val of shape {tuple(channel.shape)}, got {tuple(alpha.shape)}")
    _check.same_device(op, image=image, alpha_val=alpha)
    return alpha.to(image.dtype)


def rgba_to_rgb(image: Tensor, background_color: tuple[float, float, float] | Tensor | None = None) -> Tensor:
    """Compose with a background: alpha * color + (1 - alpha) * background.

    Args:
        image: RGBA images (*, 4, H, W), the alpha in [0, 1]. Integers are computed in float32.
        background_color: three numbers, or a tensor that broadcasts to the result and has three channels; default:
            white, 1.

    Returns:
        RGB images (*, 3, H, W).

    Raises:
        TypeCheckError: image is not a tensor; background_color of the wrong type.
        ShapeError: image is not (*, 4, H, W); a tensor background_color that does not fit it.
        ValueCheckError: a background_color that is not of three numbers.
        DeviceError: background_color on another device; a color in CPU memory is moved.

    Source: T. Porter and T. Duff, "Compositing digital images" (1984).

    Example:
        >>> import torch, kvision as K
        >>> red = torch.tensor([1.0, 0.0, 0.0, 0.5]).view(4, 1, 1)
        >>> K.color.rgba_to_rgb(red).flatten()
        tensor([1.0000, 0.5000, 0.5000])
        >>> K.color.rgba_to_rgb(red, (0.0, 0.0, 1.0)).flatten()
        tensor([0.5000, 0.0000, 0.5000])
    """
    _check.channels("rgba_to_rgb", "image", image, 4)
    if background_color is None:
        return _on_white(image)
    if isinstance(background_color, (tuple, list)):
        background = _color(background_color, image)
    else:
        _check.channels("rgba_to_rgb", "background_color", background_color, 3)
        if background_color.shape[-2:].numel() == 1:  # a color; an image is not moved
            background_color = _check.to_device_of(
                "rgba_to_rgb", image, "background_color", background_color, of="image"
            )
        _check.same_device("rgba_to_rgb", image=image, background_color=background_color)
        background = _background(background_color, image)
    return apply_on_batch(_rgba_to_rgb, floats(image), background)


def _on_white(image: Tensor) -> Tensor:
    return apply_on_batch(_rgba_to_rgb, floats(image), image.new_ones((1, 1, 1, 1), dtype=compute_dtype(image)))


def _color(color: tuple[float, ...] | list[float], image: Tensor) -> Tensor:
    if len(color) != 3:
        raise ValueCheckError(f"rgba_to_rgb: expected background_color to be three numbers, got {color!r}")
    numbers = [_check.number("rgba_to_rgb", "background_color", c) for c in color]
    # Filled on the device, because a copy from the host would wait for it.
    return torch.cat([image.new_full((1, 1, 1, 1), n, dtype=compute_dtype(image)) for n in numbers], 1)


def _background(background: Tensor, image: Tensor) -> Tensor:
    """`background` as (B, 3, H, W), or with axes of size 1 that broadcast over the image."""
    *leading, _, h, w = image.shape
    own = background.shape
    fits = own[-2] in (1, h) and own[-1] in (1, w) and len(own) <= image.dim()
    if not fits or any(n not in (1, m) for n, m in zip(reversed(own[:-3]), reversed(leading))):
        raise ShapeError(
            f"rgba_to_rgb: expected background_color to broadcast to {(*leading, 3, h, w)}, got {tuple(own)}"
        )
    return background[None] if background.dim() == 3 else flatten_batch(background.expand(*leading, *own[-3:]))


def rgba_to_bgr(image: Tensor) -> Tensor:
    """Compose with white, 1, and reverse the channels.

    Args:
        image: RGBA images (*, 4, H, W), the alpha in [0, 1]. Integers are computed in float32.

    Returns:
        BGR images (*, 3, H, W).

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 4, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgba_to_bgr(torch.tensor([1.0, 0.0, 0.0, 0.5]).view(4, 1, 1)).flatten()
        tensor([0.5000, 0.5000, 1.0000])
    """
    _check.channels("rgba_to_bgr", "image", image, 4)
    return _on_white(image).flip(-3)


class RgbToRgba(FunctionModule):
    """Module form of :func:`rgb_to_rgba`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToRgba(1.0)(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 4, 4, 5])
    """

    def __init__(self, alpha_val: float | Tensor) -> None:
        super().__init__(alpha_val=alpha_val)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_rgba(image, self.alpha_val)


class BgrToRgba(FunctionModule):
    """Module form of :func:`bgr_to_rgba`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.BgrToRgba(1.0)(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 4, 4, 5])
    """

    def __init__(self, alpha_val: float | Tensor) -> None:
        super().__init__(alpha_val=alpha_val)

    def forward(self, image: Tensor) -> Tensor:
        return bgr_to_rgba(image, self.alpha_val)


class RgbaToRgb(nn.Module):
    """Module form of :func:`rgba_to_rgb`, on white.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbaToRgb()(torch.rand(2, 4, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgba_to_rgb(image)


class RgbaToBgr(nn.Module):
    """Module form of :func:`rgba_to_bgr`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbaToBgr()(torch.rand(2, 4, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgba_to_bgr(image)
