"""Images as the patches that vision-language models take: resized, normalized and cut, tensors and lists of any sizes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Literal, NamedTuple, TypeAlias

import torch
import torch.nn.functional as F
from torch import Tensor, is_grad_enabled
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._limits import MAX_PATCH_CHANNELS
from kvision._modes import BORDER, INTERPOLATION
from kvision._ops import FastPath
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.transform.lists.arguments import check_list
from kvision.geometry.transform.resize import resized


class VisionPatches(NamedTuple):
    """What :func:`vision_patches` returns.

    Attributes:
        patches: (N, C*T*P*P), those of all images one after the other, for 'qwen2_vl'; (B, max_num_patches, P*P*C), zeros after
            those of an image, for 'siglip2'.
        grids: int64, in CPU memory, where models read them: (B, 3) frames, rows and columns of patches, or (B, 2) rows and
            columns.
        mask: (B, max_num_patches), True for the patches of an image; None for 'qwen2_vl'.

    Example:
        >>> import torch, kvision as K
        >>> inputs = K.contrib.vision_patches([torch.rand(3, 60, 90)], "siglip2", max_num_patches=8)
        >>> inputs.patches.shape, inputs.grids, inputs.mask.sum()
        (torch.Size([1, 8, 768]), tensor([[2, 3]]), tensor(6))
    """

    patches: Tensor
    grids: Tensor
    mask: Tensor | None


class _Layout(NamedTuple):
    """What a model wants: how images are resized and how their patches are written."""

    interpolation: str
    patch_size: int
    options: dict[str, int]  # the options that this layout has, and their defaults
    mean: tuple[float, ...]
    std: tuple[float, ...]


PatchLayout: TypeAlias = Literal["qwen2_vl", "siglip2"]
LAYOUTS: dict[PatchLayout, _Layout] = {
    "qwen2_vl": _Layout(
        "bicubic",
        14,
        {"merge_size": 2, "temporal_patch_size": 2, "min_pixels": 56 * 56, "max_pixels": 28 * 28 * 1280},
        (0.48145466, 0.4578275, 0.40821073),  # CLIP's
        (0.26862954, 0.26130258, 0.27577711),
    ),
    "siglip2": _Layout("bilinear", 16, {"max_num_patches": 256}, (0.5, 0.5, 0.5), (0.5, 0.5, 0.5)),
}
_DTYPES = (torch.float32, torch.bfloat16, torch.float16)
_LONGEST_ASPECT = 200  # of images for 'qwen2_vl'
# What the kernel serves: pixels of a side of a patch, how much an image shrinks, and bytes of the image behind one patch.
MAX_PATCH, MAX_SHRINK, MAX_BYTES = 64, 32, 96_000


class _Program(NamedTuple):
    """All that is the same for the images of a call."""

    interpolation: str
    patch: int
    merge: int
    repeats: int  # 0: the channels of a pixel are adjacent, and images are padded
    padded: int  # patches of an image, where they are padded
    scale: tuple[float, ...]  # of levels of bytes, or of floating-point numbers
    offset: tuple[float, ...]
    dtype: torch.dtype


def vision_patches(
    images: Tensor | list[Tensor],
    layout: PatchLayout = "qwen2_vl",
    patch_size: int | None = None,
    *,
    merge_size: int | None = None,
    temporal_patch_size: int | None = None,
    min_pixels: int | None = None,
    max_pixels: int | None = None,
    max_num_patches: int | None = None,
    mean: float | Sequence[float] | None = None,
    std: float | Sequence[float] | None = None,
    dtype: torch.dtype = torch.float32,
) -> VisionPatches:
    """Resize, normalize and cut images into the patches that a vision-language model takes.

    'qwen2_vl' (Qwen2-VL and later) resizes by an antialiased bicubic kernel to multiples of ``patch_size * merge_size`` between
    `min_pixels` and `max_pixels`, about in the aspect of the image, and repeats each patch `temporal_patch_size` times.
    'siglip2' (NaFlex) resizes by an antialiased bilinear kernel so that at most `max_num_patches` cover the image. Sizes and
    values are those of the image processors of transformers. Bytes are resized along rows, then along columns, and rounded to
    levels from 0 to 255 after either, as Pillow and torchvision do on the CPU; on CUDA, one level of noise in 30 is another by
    one, one in 50,000 by two. Floating-point images are neither rounded nor clamped, and have gradients.

    Args:
        images: (B, C, H, W), (C, H, W), or a list of (C, H, W) of any sizes and one dtype; floating point in [0, 1], or
            bytes (uint8).
        layout: 'qwen2_vl' or 'siglip2'.
        patch_size: pixels of a side of a patch. None: 14 for 'qwen2_vl', 16 for 'siglip2'.
        merge_size: side of the blocks of patches that are adjacent in the result. Default 2, for 'qwen2_vl'.
        temporal_patch_size: how often a patch is repeated. Default 2, for 'qwen2_vl'.
        min_pixels: fewest pixels of a resized image. Default 3136, for 'qwen2_vl'.
        max_pixels: most pixels of a resized image. Default 1003520, for 'qwen2_vl'.
        max_num_patches: patches of each image in the result. Default 256, for 'siglip2'.
        mean: subtracted from images in [0, 1], one number or one for each channel. None: the model's.
        std: what images are then divided by. None: the model's.
        dtype: of the patches, float32, bfloat16 or float16.

    Returns:
        :class:`VisionPatches`: patches, grids and mask.

    Raises:
        TypeError: `images` is no tensor or list of tensors of one floating-point type or uint8; an option is not an int, or one
            of the other layout; `dtype` is another type.
        ValueError: a shape is another one; a list is empty, or its images differ in channels or device; a number is below
            1, a `std` not above 0; `min_pixels` exceeds `max_pixels`; an image for 'qwen2_vl' is more than 200 times as long as
            wide, or the mean of other than 3 channels is missing.

    Example:
        >>> import torch, kvision as K
        >>> images = [torch.rand(3, 100, 200), torch.rand(3, 300, 120)]
        >>> patches, grids, _ = K.contrib.vision_patches(images)
        >>> patches.shape, grids.tolist()
        (torch.Size([288, 1176]), [[1, 8, 14], [1, 22, 8]])
        >>> patches, grids, mask = K.contrib.vision_patches(images, "siglip2", max_num_patches=64)
        >>> patches.shape, grids.tolist(), mask.sum(1).tolist()
        (torch.Size([2, 64, 768]), [[5, 10], [12, 5]], [50, 60])
    """
    op = "vision_patches"
    _check.choice(op, "layout", layout, tuple(LAYOUTS))
    given = {
        "merge_size": merge_size,
        "temporal_patch_size": temporal_patch_size,
        "min_pixels": min_pixels,
        "max_pixels": max_pixels,
        "max_num_patches": max_num_patches,
    }
    chosen = LAYOUTS[layout]
    options = _options(op, layout, given)
    patch = chosen.patch_size if patch_size is None else _check.ints(op, "patch_size", patch_size, 1)[0]
    if dtype not in _DTYPES:
        raise TypeCheckError(f"{op}: expected dtype to be float32, bfloat16 or float16, got {dtype!r}")
    parts = _images(op, images)
    x = parts[0]
    scale, offset = _affine(op, x, chosen, mean, std)
    if layout == "qwen2_vl":
        program = _Program(
            chosen.interpolation, patch, options["merge_size"], options["temporal_patch_size"], 0, scale, offset, dtype
        )
        target = _target_of(smart_size, patch * options["merge_size"], options["min_pixels"], options["max_pixels"])
    else:
        program = _Program(chosen.interpolation, patch, 1, 0, options["max_num_patches"], scale, offset, dtype)
        target = _target_of(largest_size, patch, options["max_num_patches"])
    sizes = []
    for i, part in enumerate(parts):
        size = target(*part.shape[-2:])
        if size is None:
            raise ShapeError(
                f"{op}: expected images at most {_LONGEST_ASPECT} times as long as wide, got {tuple(part.shape)}"
                + (f" of image {i}" if isinstance(images, list) else ""),
                actual_shape=part.shape,
            )
        sizes.append(size)
    call = _fused if _serves(parts, sizes, program) else _composed
    patches, mask = call(parts, sizes, program)
    frames = [1] if program.repeats else []
    grids = [
        [*frames, height // patch, width // patch]
        for part, (height, width) in zip(parts, sizes)
        for _ in range(part.shape[0])
    ]
    columns = 2 + len(frames)
    return VisionPatches(patches, torch.tensor(grids, dtype=torch.int64, device="cpu").reshape(-1, columns), mask)


# --- sizes ----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=4096)
def smart_size(height: int, width: int, factor: int, min_pixels: int, max_pixels: int) -> tuple[int, int] | None:
    """The size that an image for 'qwen2_vl' is resized to: multiples of `factor`. None where it is too long."""
    if max(height, width) > _LONGEST_ASPECT * min(height, width):
        return None
    rows, columns = round(height / factor), round(width / factor)
    if rows * columns * factor * factor > max_pixels:
        shrink = math.sqrt(height * width / max_pixels)
        rows, columns = (max(1, math.floor(n / shrink / factor)) for n in (height, width))
    elif rows * columns * factor * factor < min_pixels:
        grow = math.sqrt(min_pixels / (height * width))
        rows, columns = (math.ceil(n * grow / factor) for n in (height, width))
    return rows * factor, columns * factor


@lru_cache(maxsize=4096)
def largest_size(height: int, width: int, patch: int, max_num_patches: int) -> tuple[int, int]:
    """The size that an image for 'siglip2' is resized to: of the largest factor by which at most `max_num_patches` cover it."""
    low, high = 1e-6, 100.0  # transformers searches here, by halves down to 1e-5
    while high - low >= 1e-5:
        middle = (low + high) / 2
        rows, columns = (max(1, math.ceil(n * middle / patch)) for n in (height, width))
        if rows * columns <= max_num_patches:
            low = middle
        else:
            high = middle
    rows, columns = (max(1, math.ceil(n * low / patch)) for n in (height, width))
    return rows * patch, columns * patch


def _target_of(rule: Callable[..., tuple[int, int] | None], *options: int) -> Callable[[int, int], Any]:
    rule = rule.__wrapped__ if is_compiling() else rule  # type: ignore[attr-defined]  # dynamo warns of the cache
    return lambda height, width: rule(int(height), int(width), *options)


# --- one pass -------------------------------------------------------------------------------------------------------

_vision_patches = FastPath("vision_patches", (torch.float32, torch.uint8))


def _serves(parts: list[Tensor], sizes: list[tuple[int, int]], program: _Program) -> bool:
    """Whether the kernel serves: what the definition does, without gradients, in one launch for up to 256 images."""
    first, patch = parts[0], program.patch
    if not _vision_patches.serves(first) or program.dtype == torch.float16:
        return False
    channels, wants_gradient = first.shape[1], is_grad_enabled()
    if channels > MAX_PATCH_CHANNELS or patch > MAX_PATCH:
        return False
    row_bytes = channels * patch * (patch + 4) * first.element_size()
    for x, (height, width) in zip(parts, sizes):
        if (x.requires_grad and wants_gradient) or type(x) is not Tensor:
            return False
        shrink = max(x.shape[2] / height, 1)
        if max(shrink, x.shape[3] / width) > MAX_SHRINK or row_bytes * shrink > MAX_BYTES:
            return False
    return True


def _fused(parts: list[Tensor], sizes: list[tuple[int, int]], program: _Program) -> tuple[Tensor, Tensor | None]:
    images = parts if len(parts) == 1 else [x[0] for x in parts]
    patch = program.patch
    patches, mask = _vision_patches.kernel(
        images,
        [n // patch for size in sizes for n in size],
        INTERPOLATION[program.interpolation],
        patch,
        program.merge,
        program.repeats,
        program.padded,
        program.scale,
        program.offset,
        program.dtype == torch.bfloat16,
    )
    return patches, None if program.repeats else mask


# --- the definition -------------------------------------------------------------------------------------------------


def _composed(parts: list[Tensor], sizes: list[tuple[int, int]], program: _Program) -> tuple[Tensor, Tensor | None]:
    """Patches and mask of images (B, C, H, W), by operators that have gradients."""
    cut = [_patches_of(part, size, program) for part, size in zip(parts, sizes)]  # (B, n, D)
    if program.repeats:
        return torch.cat([p.flatten(0, 1) for p in cut]), None
    masks = [
        torch.arange(program.padded, device=p.device).less(p.shape[1]).expand(p.shape[0], program.padded) for p in cut
    ]
    padded = [F.pad(p, (0, 0, 0, program.padded - p.shape[1])) for p in cut]
    return torch.cat(padded), torch.cat(masks)


def _patches_of(x: Tensor, size: tuple[int, int], program: _Program) -> Tensor:
    """Those of images of one size, (B, n, D)."""
    # Bytes along rows first, rounded there: with negative weights that is no detail but up to 20 levels, where it saturates.
    steps = [(x.shape[2], size[1]), size] if x.dtype == torch.uint8 else [size]
    y = x
    for step in steps:
        if step != tuple(y.shape[2:]):
            y = resized(y, list(step), INTERPOLATION[program.interpolation], False, True, BORDER["replicate"])
    y = y.to(compute_dtype(y))
    shape = (1, -1, 1, 1)
    y = (y * y.new_tensor(program.scale).view(shape) + y.new_tensor(program.offset).view(shape)).to(program.dtype)
    b, c, p, m = y.shape[0], y.shape[1], program.patch, program.merge
    rows, columns = size[0] // p, size[1] // p
    if not program.repeats:
        return y.reshape(b, c, rows, p, columns, p).permute(0, 2, 4, 3, 5, 1).reshape(b, rows * columns, p * p * c)
    y = y.reshape(b, c, rows // m, m, p, columns // m, m, p).permute(0, 2, 5, 3, 6, 1, 4, 7)
    y = y.unsqueeze(6).expand(*y.shape[:6], program.repeats, p, p)
    return y.reshape(b, rows * columns, c * program.repeats * p * p)


# --- arguments ------------------------------------------------------------------------------------------------------


def _options(op: str, layout: PatchLayout, given: dict[str, int | None]) -> dict[str, int]:
    options = dict(LAYOUTS[layout].options)
    for name, value in given.items():
        if value is None:
            continue
        if name not in options:
            raise TypeCheckError(f"{op}: expected no {name} with layout {layout!r}, got {value!r}")
        (options[name],) = _check.ints(op, name, value, 1)
    if "min_pixels" in options and options["min_pixels"] > options["max_pixels"]:
        raise ValueCheckError(
            f"{op}: expected min_pixels of at most max_pixels {options['max_pixels']}, got {options['min_pixels']}"
        )
    return options


def _images(op: str, images: Any) -> list[Tensor]:
    """The images as batches (B, C, H, W), which may have different sizes."""
    if not isinstance(images, list):
        if isinstance(images, Tensor) and images.dim() == 3:
            images = images[None]
        _check.images(op, "images", images)
        _check.floating_or_bytes(op, "images", images)
        if images.shape[1] == 0:
            raise ShapeError(f"{op}: expected images with channels, got {tuple(images.shape)}")
        return [images]
    check_list(op, "images", images)
    if images[0].shape[0] == 0:
        raise ShapeError(f"{op}: expected images with channels, got {tuple(images[0].shape)}")
    _check.floating_or_bytes(op, "images", images[0])
    return [x[None] for x in images]


def _affine(op: str, x: Tensor, layout: _Layout, mean: Any, std: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Factors and offsets that normalize each channel of images of the type of `x`."""
    means, stds = (
        _per_channel(op, name, layout_value if value is None else value, x.shape[1])
        for name, value, layout_value in (("mean", mean, layout.mean), ("std", std, layout.std))
    )
    if min(stds) <= 0:
        raise ValueCheckError(f"{op}: expected std above 0, got {std!r}", actual_value=std)
    levels = 255.0 if x.dtype == torch.uint8 else 1.0
    return tuple(1 / (levels * s) for s in stds), tuple(-m / s for m, s in zip(means, stds))


def _per_channel(op: str, name: str, value: Any, channels: int) -> tuple[float, ...]:
    if isinstance(value, Tensor) and value.dim() == 1:
        value = value.tolist()
    if not isinstance(value, (tuple, list)):
        return (_check.number(op, name, value),) * channels
    numbers = tuple(_check.number(op, name, v) for v in value)
    if len(numbers) != channels:
        raise ValueCheckError(
            f"{op}: expected {name} to be a number or one for each of {channels} channels, got {value!r}"
        )
    return numbers
