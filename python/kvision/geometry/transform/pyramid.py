"""Images at several scales."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from kvision import _check
from kvision._choices import Border
from kvision._dtype import as_dtype, compute_dtype, pixels
from kvision._modes import BORDER, INTERPOLATION
from kvision._modules import FunctionModule
from kvision._ops import register
from kvision._torch_compat import has_static_value
from kvision.core.exceptions import ShapeError
from kvision.filters import filter2d_separable, gaussian_blur2d
from kvision.filters.smoothing.gaussian import gaussian_levels
from kvision.geometry.transform.resize import resize, resize_reference, resized, resized_backward

__all__ = [
    "PyrDown",
    "PyrUp",
    "ScalePyramid",
    "build_laplacian_pyramid",
    "build_pyramid",
    "pyrdown",
    "pyrup",
]

# --- a level of a Laplacian pyramid ---------------------------------------------------------------------------------


def _detail_reference(smaller, image, align_corners, border):
    size = [2 * side for side in smaller.shape[2:]]
    return image - resize_reference(smaller, size, INTERPOLATION["pyrup"], align_corners, False, border)


def _detail_backward(needs, grad, smaller, image, align_corners, border):
    options = (INTERPOLATION["pyrup"], align_corners, False, border)
    return [
        -resized_backward(grad, list(smaller.shape[2:]), *options) if needs[0] else None,
        grad if needs[1] else None,
    ]


# The difference of an image and the pyrup of the next smaller level.
_detail = register(
    "pyramid_detail", _detail_reference, fake=lambda smaller, image, *options: image.shape, backward=_detail_backward
)

# --- functions ------------------------------------------------------------------------------------------------------


def pyrdown(input: Tensor, border_type: Border = "reflect", align_corners: bool = False, factor: float = 2.0) -> Tensor:
    """Blur images with a binomial 5 x 5 kernel and downsample them by bilinear interpolation.

    Args:
        input: images (B, C, H, W), floating point or uint8. Other integers are computed in float32.
        border_type: border of the blur: 'constant', 'reflect', 'replicate' or 'circular'.
        align_corners: align the centers of the corner pixels, not the edges of the images.
        factor: divides both sides, which are rounded down.

    Returns:
        (B, C, H / factor, W / factor), of the dtype of `input`.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `align_corners` is not a bool; `factor` is not a number.
        ValueError: `input` is not (B, C, H, W); `border_type` is unknown; the image is too small for a 'reflect' or
            'circular' border of 2 pixels; a side of the result would be 0.

    Source: P. Burt and E. Adelson, "The Laplacian pyramid as a compact image code" (1983).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.pyrdown(torch.rand(1, 3, 11, 13)).shape
        torch.Size([1, 3, 5, 6])
    """
    _check.images("pyrdown", "input", input)
    _check.flag("pyrdown", "align_corners", align_corners)
    factor = _check.number("pyrdown", "factor", factor)
    size = [math.trunc(side / factor) if factor > 0 else 0 for side in _check.sizes_as_numbers(input)[2:]]
    if 0 in size:
        raise ShapeError(f"pyrdown: expected factor to leave a pixel of {tuple(input.shape[2:])}, got {factor}")
    if border_type == "circular":
        return resize(_blur("pyrdown", input, border_type), (size[0], size[1]), align_corners=align_corners)
    _check.border("pyrdown", border_type)
    _check.reflectable("pyrdown", input, (2, 2), border_type)
    return resized(pixels(input), size, INTERPOLATION["pyrdown"], align_corners, False, BORDER[border_type])


def pyrup(input: Tensor, border_type: Border = "reflect", align_corners: bool = False) -> Tensor:
    """Upsample images to twice their size by bilinear interpolation and blur them with a binomial 5 x 5 kernel.

    Args:
        input: images (B, C, H, W), floating point or uint8. Other integers are computed in float32.
        border_type: border of the blur: 'constant', 'reflect', 'replicate' or 'circular'.
        align_corners: align the centers of the corner pixels, not the edges of the images.

    Returns:
        (B, C, 2 H, 2 W), of the dtype of `input`.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `align_corners` is not a bool.
        ValueError: `input` is not (B, C, H, W); `border_type` is unknown; the result is too small for a 'reflect' or
            'circular' border of 2 pixels.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.pyrup(torch.rand(1, 3, 5, 6)).shape
        torch.Size([1, 3, 10, 12])
    """
    _check.images("pyrup", "input", input)
    _check.flag("pyrup", "align_corners", align_corners)
    size = [2 * side for side in input.shape[2:]]
    if border_type == "circular":
        return _blur("pyrup", resize(input, (size[0], size[1]), align_corners=align_corners), border_type)
    _check.border("pyrup", border_type)
    _check.reflectable("pyrup", input, (1, 1), border_type)  # 2 pixels of the result
    return resized(pixels(input), size, INTERPOLATION["pyrup"], align_corners, False, BORDER[border_type])


def _blur(op: str, image: Tensor, border_type: Border) -> Tensor:
    _check.reflectable(op, image, (2, 2), border_type)
    dtype = image.dtype if image.dtype == torch.float64 else torch.float32
    d = torch.arange(-2, 3, dtype=dtype, device=image.device).abs()
    kernel = ((6 - 1.5 * d - 0.5 * d * d) / 16)[None]  # 1 4 6 4 1, computed on the device
    return filter2d_separable(image, kernel, kernel, border_type)


def build_pyramid(
    input: Tensor, max_level: int, border_type: Border = "reflect", align_corners: bool = False
) -> list[Tensor]:
    """Compute a Gaussian pyramid: each level is the :func:`pyrdown` of the level before.

    Args:
        input: images (B, C, H, W), floating point or uint8. Other integers are computed in float32.
        max_level: number of levels, at least 1, with the images themselves.
        border_type: border of the blur: 'constant', 'reflect', 'replicate' or 'circular'.
        align_corners: align the centers of the corner pixels, not the edges of the images.

    Returns:
        A list of `max_level` levels (B, C, h, w), the largest first; the first one is `input`.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `max_level` is not an int; `align_corners` is not a bool.
        ValueError: `input` is not (B, C, H, W); `max_level` is below 1; `border_type` is unknown; a level is too small
            for a 'reflect' or 'circular' border of 2 pixels.

    Example:
        >>> import torch, kvision as K
        >>> [level.shape[-1] for level in K.geometry.build_pyramid(torch.rand(1, 3, 40, 40), 3)]
        [40, 20, 10]
    """
    _check.images("build_pyramid", "input", input)
    (count,) = _check.ints("build_pyramid", "max_level", max_level, 1)
    levels = [input]
    while len(levels) < count:
        levels.append(pyrdown(levels[-1], border_type, align_corners))
    return levels


def build_laplacian_pyramid(
    input: Tensor, max_level: int, border_type: Border = "reflect", align_corners: bool = False
) -> list[Tensor]:
    """Compute a Laplacian pyramid: the difference of each level of a Gaussian pyramid and the next one's :func:`pyrup`.

    The last level is that of the Gaussian pyramid. Adding the levels up, with :func:`pyrup`, restores the images.
    Images that cannot be halved often enough are first reflected to the next powers of 2 on the right and below.

    Args:
        input: images (B, C, H, W). Integers are computed in float32.
        max_level: number of levels, at least 1.
        border_type: border of the blur: 'constant', 'reflect', 'replicate' or 'circular'.
        align_corners: align the centers of the corner pixels, not the edges of the images.

    Returns:
        A list of `max_level` levels (B, C, h, w), the largest first.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `max_level` is not an int; `align_corners` is not a bool.
        ValueError: `input` is not (B, C, H, W); `max_level` is below 1; `border_type` is unknown; a level is too small
            for a 'reflect' or 'circular' border of 2 pixels.

    Source: P. Burt and E. Adelson, "The Laplacian pyramid as a compact image code" (1983).

    Example:
        >>> import torch, kvision as K
        >>> image = torch.rand(1, 1, 16, 16)
        >>> detail, rest = K.geometry.build_laplacian_pyramid(image, 2)
        >>> torch.allclose(detail + K.geometry.pyrup(rest), image)
        True
    """
    op = "build_laplacian_pyramid"
    _check.images(op, "input", input)
    if input.shape[1] == 0:
        raise ShapeError(f"{op}: expected input with at least one channel, got {tuple(input.shape)}")
    (count,) = _check.ints(op, "max_level", max_level, 1)
    image = input if input.is_floating_point() else input.float()
    h, w = _check.sizes_as_numbers(image)[2:]
    powers = [_next_power_of_2(side) for side in (h, w)]
    halved = 2 ** (count - 1)
    is_padded = (h % halved != 0) | (w % halved != 0) | ((powers[0] != h) & (powers[1] != w))
    if not (has_static_value(h) and has_static_value(w)):  # a branch would make a program for images of one kind
        powers = [torch.sym_ite(is_padded, power, side) for power, side in zip(powers, (h, w))]
        is_padded = True
    if is_padded:
        image = F.pad(image, (0, powers[1] - w, 0, powers[0] - h), "reflect")
    levels = build_pyramid(image, count, border_type, align_corners)
    details = [_level(level, next_, border_type, align_corners) for level, next_ in pairwise(levels)]
    return [*details, levels[-1]]


def _next_power_of_2(n: int) -> int:
    """Of all bits below the highest one of n - 1, plus one: operations that graphs have for symbolic sizes."""
    bits = n - 1
    for shift in (1, 2, 4, 8, 16):
        bits = bits | (bits >> shift)
    return bits + 1


def _level(image: Tensor, smaller: Tensor, border_type: Border, align_corners: bool) -> Tensor:
    if border_type == "circular":
        return image - pyrup(smaller, border_type, align_corners)
    _check.reflectable("build_laplacian_pyramid", smaller, (1, 1), border_type)
    return _detail(smaller, image, align_corners, BORDER[border_type])


class PyrDown(FunctionModule):
    """Module form of :func:`pyrdown`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.PyrDown()(torch.rand(1, 3, 8, 8)).shape
        torch.Size([1, 3, 4, 4])
    """

    def __init__(self, border_type: Border = "reflect", align_corners: bool = False, factor: float = 2.0) -> None:
        super().__init__(border_type=border_type, align_corners=align_corners, factor=factor)

    def forward(self, input: Tensor) -> Tensor:
        return pyrdown(input, self.border_type, self.align_corners, self.factor)


class PyrUp(FunctionModule):
    """Module form of :func:`pyrup`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.PyrUp()(torch.rand(1, 3, 8, 8)).shape
        torch.Size([1, 3, 16, 16])
    """

    def __init__(self, border_type: Border = "reflect", align_corners: bool = False) -> None:
        super().__init__(border_type=border_type, align_corners=align_corners)

    def forward(self, input: Tensor) -> Tensor:
        return pyrup(input, self.border_type, self.align_corners)


class ScalePyramid(nn.Module):
    """The scale space of SIFT: octaves of increasingly blurred images, each half the size of the one before.

    Args:
        n_levels: levels of an octave in which the blur doubles.
        init_sigma: blur of the first level, in pixels of its octave; images are assumed to have a blur of 0.5.
        min_size: there is no further octave whose shorter side would be at most this, in pixels.
        double_image: begin with the images at twice their size.
        extra_levels: levels of an octave in addition to `n_levels`.

    `forward` takes images (B, C, H, W) and returns three lists with an entry for each octave: its levels
    (B, C, n_levels + extra_levels, h, w), their blur in pixels of the octave, (B, n_levels + extra_levels), and how many
    pixels of the image one of the octave is, of the same shape.

    Source: D. Lowe, "Distinctive image features from scale-invariant keypoints" (2004).

    Example:
        >>> import torch, kvision as K
        >>> levels, sigmas, distances = K.geometry.ScalePyramid(3, 1.6, 16)(torch.rand(1, 1, 64, 64))
        >>> [octave.shape[-1] for octave in levels], distances[1][0, 0]
        ([64, 32], tensor(2.))
    """

    def __init__(
        self,
        n_levels: int = 3,
        init_sigma: float = 1.6,
        min_size: int = 15,
        double_image: bool = False,
        extra_levels: int = 3,
    ) -> None:
        super().__init__()
        (self.n_levels,) = _check.ints("ScalePyramid", "n_levels", n_levels, 1)
        (self.extra_levels,) = _check.ints("ScalePyramid", "extra_levels", extra_levels, 1)
        self.init_sigma = _check.number("ScalePyramid", "init_sigma", init_sigma)
        (self.min_size,) = _check.ints("ScalePyramid", "min_size", min_size, 1, minimum=0)
        self.border = self.min_size // 2 - 1
        self.sigma_step = 2 ** (1 / self.n_levels)
        self.double_image = _check.switch("ScalePyramid", "double_image", double_image)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(n_levels={self.n_levels}, init_sigma={self.init_sigma}, min_size={self.min_size}, "
            f"extra_levels={self.extra_levels}, border={self.border}, sigma_step={self.sigma_step}, "
            f"double_image={self.double_image})"
        )

    def get_kernel_size(self, sigma: float) -> int:
        """The odd size of the blur's kernel, which ends four sigmas from its center."""
        return int(8 * sigma + 1) // 2 * 2 + 1

    def get_first_level(self, input: Tensor) -> tuple[Tensor, float, float]:
        """The first level, its blur, and the size of one of its pixels in pixels of the image."""
        image, more, distance = input, self._first_blur(), 1.0
        if self.double_image:
            h, w = input.shape[2:]
            image, distance = resize(input, (2 * h, 2 * w), align_corners=True), 0.5
        if more is None:
            return image, self._assumed_blur(), distance
        return gaussian_blur2d(image, self._window(image.shape[2:], more), more), self.init_sigma, distance

    def _assumed_blur(self) -> float:
        return 1.0 if self.double_image else 0.5

    def _first_blur(self) -> float | None:
        """The sigma that blurs images, after doubling, to the first level; None if they are blurred enough already."""
        if self.init_sigma <= self._assumed_blur():
            return None
        return max(math.sqrt(self.init_sigma**2 - self._assumed_blur() ** 2), 0.01)

    def _window(self, size: Sequence[int], sigma: float) -> int:
        """The size of the window of a blur, at most that of images of height and width `size`."""
        shortest = min(size)
        return min(self.get_kernel_size(sigma), shortest if shortest % 2 else shortest - 1)

    def forward(self, x: Tensor) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
        _check.images("ScalePyramid", "x", x)
        level, base, distance = self.get_first_level(x if x.is_floating_point() else x.float())
        octaves: tuple[list[Tensor], list[Tensor], list[Tensor]] = ([], [], [])
        scales, blurs = self._level_blurs(base)
        count = len(scales)
        # Computed on the device, because a copy from the host would wait for it.
        first, last = math.log2(scales[0]), math.log2(scales[-1])
        sigmas = torch.logspace(first, last, count, 2.0, dtype=compute_dtype(level), device=level.device)
        sigmas = as_dtype(sigmas, level.dtype).expand(len(x), count)
        while True:
            levels = gaussian_levels(level, [self._window(level.shape[2:], sigma) for sigma in blurs], blurs)
            octaves[0].append(levels)
            octaves[1].append(sigmas)
            octaves[2].append(level.new_full((len(x), count), distance))
            level = levels[:, :, -self.extra_levels]
            h, w = (side // 2 for side in level.shape[2:])
            if min(h, w) <= self.min_size:
                return octaves
            level = resize(level, (h, w), align_corners=True)
            distance *= 2

    def _level_blurs(self, base: float) -> tuple[list[float], list[float]]:
        """The blur of each level of an octave whose first level has blur `base`, and the sigmas from each level to the next."""
        scales = [base * self.sigma_step**i for i in range(self.n_levels + self.extra_levels)]
        return scales, [sigma * math.sqrt(self.sigma_step**2 - 1) for sigma in scales[:-1]]

    def _plan(self, height: int, width: int) -> ScaleSpacePlan:
        """The sizes and sigmas of `forward` for images of one size."""
        more = self._first_blur()
        scales, blurs = self._level_blurs(self._assumed_blur() if more is None else self.init_sigma)
        h, w = (2 * height, 2 * width) if self.double_image else (height, width)
        plan = ScaleSpacePlan([], [], [more or 0.0, *blurs], scales)
        while True:
            first = 0 if more is None or plan.sizes else self._window((h, w), more)
            plan.sizes.extend((h, w))
            plan.windows.extend((first, *(self._window((h, w), blur) for blur in blurs)))
            h, w = h // 2, w // 2
            if min(h, w) <= self.min_size:
                return plan


class ScaleSpacePlan(NamedTuple):
    """The sizes and sigmas of a scale space. Each level of an octave is a blur of the level before it."""

    sizes: list[int]  # height and width of each octave
    windows: list[int]  # for each octave, the size of the window of the blur to each level; 0 for no blur
    sigmas: list[float]  # of the blur to each level
    scales: list[float]  # total blur of each level, in pixels of its octave

    def voxels(self) -> int:
        """The count of pixels of all levels of all octaves."""
        return len(self.scales) * sum(h * w for h, w in zip(self.sizes[::2], self.sizes[1::2]))
