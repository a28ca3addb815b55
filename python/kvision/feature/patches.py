"""Patches of images around local affine frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._limits import MAX_PYRAMID_LEVELS
from kvision._modes import BORDER, INTERPOLATION
from kvision._ops import register, wants_derivative
from kvision._torch_compat import is_tracing
from kvision.core.exceptions import ShapeError
from kvision.feature._detection import with_finite_gradient
from kvision.feature._laf_units import denormalize_laf
from kvision.geometry.transform.pyramid import pyrdown
from kvision.geometry.transform.resize import resize_reference
from kvision.geometry.transform.sampling import sample

__all__ = ["extract_patches_from_pyramid", "extract_patches_simple"]


# --- the operator ---------------------------------------------------------------------------------------------------


def _level_sizes(size: Sequence[int], levels: int) -> list[tuple[int, int]]:
    return [(size[0] // 2**level, size[1] // 2**level) for level in range(levels)]


def _reference(pyramid: Tensor, laf: Tensor, size: Sequence[int], levels: int, n: int, window: float) -> Tensor:
    laf = laf.expand(pyramid.shape[0], -1, -1, -1)
    finite = laf.isfinite().flatten(2).all(2)[:, :, None, None, None]
    laf = torch.where(finite[..., 0], laf, 0)
    u = (2 * torch.arange(n, dtype=laf.dtype, device=laf.device) + 1) / n - 1
    (xx, xy, x), (yx, yy, y) = (row.unbind(-1) for row in laf[..., None, None].movedim((2, 3), (0, -1)))
    coords = [xx * u + xy * u[:, None] + x, yx * u + yy * u[:, None] + y]  # each (B, N, n, n), in pixels of the image
    level_of_frame = levels_of_frames(laf, levels, window)[:, :, None, None, None]
    height, width = size
    patches: Any = 0
    start = 0
    for level, (h, w) in enumerate(_level_sizes(size, levels)):
        image = pyramid[..., start : start + h * w].unflatten(2, (h, w))
        start += h * w
        on_level = [((c + 0.5) * (m / whole) - 0.5).flatten(2) for c, m, whole in zip(coords, (w, h), (width, height))]
        samples = sample(image, on_level, "bilinear", "border", False).unflatten(3, (n, n)).movedim(1, 2)
        patches = patches + torch.where(level_of_frame == level, samples, 0)
    return torch.where(finite, patches, 0)


def levels_of_frames(laf: Tensor, levels: int, window: float) -> Tensor:
    """The level of each frame, (B, N)."""
    a = laf.detach()
    area = 4 * (a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0]).abs()
    level = torch.zeros_like(area, dtype=torch.int64)
    for finer in range(levels - 1):
        level = level + (area >= window**2 * 4.0 ** (finer + 1))
    return level


def _reference_backward(grad: Tensor, pyramid: Tensor, laf: Tensor, *args: Any) -> tuple[Tensor, Tensor]:
    """The gradients to the pyramid and to the frames, in the type that computes.

    One that is not requested has no channels or frames.
    """
    *options, wants_pyramid, wants_laf = args
    dtype, batch = compute_dtype(pyramid), grad.shape[0]
    pyramid, laf = pyramid.to(dtype).expand(batch, -1, -1), laf.to(dtype).expand(batch, -1, -1, -1)
    vjp_fn = torch.func.vjp(lambda *inputs: _reference(*inputs, *options), pyramid, laf)[1]
    of_pyramid, of_laf = vjp_fn(grad.to(dtype))
    return of_pyramid if wants_pyramid else of_pyramid[:, :0], of_laf if wants_laf else of_laf[:, :0]


def _fake_backward(grad: Tensor, pyramid: Tensor, laf: Tensor, *args: Any) -> list[Tensor]:
    inputs = ((pyramid, args[-2]), (laf, args[-1]))
    sizes = [(grad.shape[0], x.shape[1] if wants else 0, *x.shape[2:]) for x, wants in inputs]
    return [pyramid.new_empty(s, dtype=compute_dtype(pyramid)) for s in sizes]


def _adds_by_atomics(grad: Tensor, *args: Any) -> bool:
    return grad.is_cuda and bool(args[-2])


# (B, C, P) pyramids and (B, N, 2, 3) frames to (B, N, C, n, n) patches. A pyramid has the rows of all its levels, one
# after the other.
_sample_patches = register(
    "sample_patches",
    _reference,
    fake=lambda pyramid, laf, size, levels, n, window: (pyramid.shape[0], laf.shape[1], pyramid.shape[1], n, n),
    gradients="pyramid, laf: sample_patches_backward(wants_pyramid=needs(pyramid), wants_laf=needs(laf))",
)
register(
    "sample_patches_backward",
    _reference_backward,
    fake=_fake_backward,
    casts_outputs=True,
    nondeterministic=_adds_by_atomics,
)


def sample_levels(levels: Sequence[Tensor], laf: Tensor, patch_size: int, window: float) -> Tensor:
    """Patches (B, N, C, n, n) of frames in pixels of `levels[0]`, each from the level that `window` selects.

    Every level (B, C, H, W) has half the height and the width of the one before.
    """
    image = levels[0]
    pyramid = image.flatten(2) if len(levels) == 1 else torch.cat([level.flatten(2) for level in levels], 2)
    frames = with_finite_gradient(as_dtype(laf, compute_dtype(image)))
    patches = _sample_patches(pyramid, frames, list(image.shape[2:]), len(levels), patch_size, float(window))
    return with_finite_gradient(patches)


def build_levels(image: Tensor, smallest: int) -> list[Tensor]:
    """The image and its reductions by 2, 4, 8 and so on, as long as the shorter side has `smallest` pixels."""
    levels = [image]
    for _ in range(_count_levels(image, smallest) - 1):
        levels.append(pyrdown(levels[-1]))
    return levels


def _count_levels(image: Tensor, smallest: int) -> int:
    count, shorter = 1, min(image.shape[2:])
    while count < MAX_PYRAMID_LEVELS and shorter > 2 and shorter // 2 >= smallest:  # pyrdown reflects two pixels
        count, shorter = count + 1, shorter // 2
    return count


def _pyramid_reference(image: Tensor, laf: Tensor, levels: int, n: int, window: float) -> Tensor:
    options = (INTERPOLATION["pyrdown"], False, False, BORDER["reflect"])
    rows, level = [image.flatten(2)], image
    for size in _level_sizes(image.shape[2:], levels)[1:]:
        level = resize_reference(level, size, *options)
        rows.append(level.flatten(2))
    return _reference(torch.cat(rows, 2), laf, image.shape[2:], levels, n, window)


# Patches of the pyramid of images, which the operator builds and does not keep. For gradients `sample_levels` is called with levels
# that other operators compute.
_pyramid_patches = register(
    "pyramid_patches",
    _pyramid_reference,
    fake=lambda image, laf, levels, n, window: (image.shape[0], laf.shape[1], image.shape[1], n, n),
)


# --- functions ------------------------------------------------------------------------------------------------------


def check_frames(op: str, img: Tensor, laf: Tensor, images: str = "img", frames: str = "laf") -> None:
    """Raise unless `laf` (B, N, 2, 3) holds frames for the images `img` (B, C, H, W); `images`, `frames`: their names."""
    _check.images(op, images, img)
    _check.shape(op, frames, laf, "B", "N", 2, 3)
    _check.floating(op, frames, laf)
    if laf.shape[0] != img.shape[0]:
        raise ShapeError(
            f"{op}: expected {frames} for {img.shape[0]} images, got {laf.shape[0]}", actual_shape=laf.shape
        )
    _check.same_device(op, **{images: img, frames: laf})


def _checked(op: str, img: Tensor, laf: Tensor, n: int, normalized: bool) -> tuple[Tensor, Tensor, int]:
    """The image in floating point, the frames in its pixels, the patch size."""
    check_frames(op, img, laf)
    (n,) = _check.ints(op, "PS", n, 1)
    _check.flag(op, "normalize_lafs_before_extraction", normalized)
    if not normalized:
        laf = denormalize_laf(laf, img)
    return floats(img), laf, n


def extract_patches_simple(
    img: Tensor, laf: Tensor, PS: int = 32, normalize_lafs_before_extraction: bool = True
) -> Tensor:
    """Sample a square patch around each local affine frame from the image itself.

    As `extract_patches_from_pyramid`, but frames that are larger than a patch alias. A frame that is not finite gives a patch
    of zeros and no gradient here as well.

    Args:
        img: images (B, C, H, W). Integers are computed in float32.
        laf: local affine frames (B, N, 2, 3).
        PS: side of the patches in pixels.
        normalize_lafs_before_extraction: `laf` is in pixels of `img`. If False, it is as `normalize_laf` returns it.

    Returns:
        Patches (B, N, C, PS, PS), of the dtype of `img`.

    Raises:
        TypeError: `img` or `laf` is not a tensor of real numbers; `laf` is not floating point; `PS` is not an int.
        ValueError: `img` is not (B, C, H, W); `laf` is not (B, N, 2, 3) with the same B; `PS` is not positive.

    Example:
        >>> import torch, kvision as K
        >>> ramp = torch.arange(8.0).expand(1, 1, 8, 8)
        >>> laf = torch.tensor([[[[2.0, 0, 3.5], [0, 2, 3.5]]]])
        >>> K.feature.extract_patches_simple(ramp, laf, 4)[0, 0, 0, 0]
        tensor([2., 3., 4., 5.])
    """
    image, frames, n = _checked("extract_patches_simple", img, laf, PS, normalize_lafs_before_extraction)
    return sample_levels([image], frames, n, n)


def extract_patches_from_pyramid(
    img: Tensor, laf: Tensor, PS: int = 32, normalize_lafs_before_extraction: bool = True
) -> Tensor:
    """Sample a square patch around each local affine frame from the level of an image pyramid that suits its scale.

    Pixel (i, j) of a patch is the image at A (u_j, u_i) + c for the frame [A | c] and u_k = (2 k + 1) / PS - 1,
    interpolated bilinearly; out of bounds the border is repeated. The level is floor(log2(2 scale / PS)) for the scale
    sqrt|det A|, within the pyramid. Levels are made by `pyrdown` while the shorter side has PS pixels, and all of them
    show the same positions. All patches are sampled in one launch.

    Gradients go to the image, through all levels, and to the frames; the level of a patch is not differentiated. A frame
    that is not finite gives a patch of zeros and no gradient. On CUDA the gradient to the image is a sum in any order.

    Args:
        img: images (B, C, H, W). Integers are computed in float32.
        laf: local affine frames (B, N, 2, 3).
        PS: side of the patches in pixels.
        normalize_lafs_before_extraction: `laf` is in pixels of `img`. If False, it is as `normalize_laf` returns it.

    Returns:
        Patches (B, N, C, PS, PS), of the dtype of `img`.

    Raises:
        TypeError: `img` or `laf` is not a tensor of real numbers; `laf` is not floating point; `PS` is not an int.
        ValueError: `img` is not (B, C, H, W); `laf` is not (B, N, 2, 3) with the same B; `PS` is not positive.

    Example:
        >>> import torch, kvision as K
        >>> laf = torch.tensor([[[[16.0, 0, 31.5], [0, 16, 31.5]]]])
        >>> K.feature.extract_patches_from_pyramid(torch.rand(1, 3, 64, 64), laf, 8).shape
        torch.Size([1, 1, 3, 8, 8])
    """
    image, frames, n = _checked("extract_patches_from_pyramid", img, laf, PS, normalize_lafs_before_extraction)
    if is_compiling() or is_tracing() or wants_derivative(image, frames):
        return sample_levels(build_levels(image, n), frames, n, n)
    return _pyramid_patches(image, as_dtype(frames, compute_dtype(image)), _count_levels(image, n), n, float(n))
