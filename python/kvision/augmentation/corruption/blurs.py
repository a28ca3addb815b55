"""Blurs and ringing of lenses and filters, each image by its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision.augmentation import ranges
from kvision.augmentation.corruption.disk import disk_kernels
from kvision.augmentation.corruption.glass import MAX_DELTA, Moves, glass
from kvision.augmentation.corruption.moved import sum_of_moved
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.lists import filter_lists
from kvision.augmentation.lists.pixels import packed_maps
from kvision.augmentation.lists.sides import sides_of
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import ValueCheckError
from kvision.filters.filter2d import filter_arguments
from kvision.geometry.transform.lists.arguments import smallest_batch
from kvision.geometry.transform.lists.kept_sizes import Operation, Operations


def mean_of_enlargements(sides: Sequence[Any], largest: Tensor, step: Tensor, most: int) -> Operation:
    """The mean of images, once more of themselves, and of enlargements by 1 + k step below `largest`, for k up to `most`.

    The sides are height and width of all images, or (B, 1) of each.
    """
    height, width = sides
    k = torch.arange(max(most, 1), device=step.device, dtype=step.dtype)
    factors = 1 + k * step[:, None]
    counts = torch.where(k == 0, 2.0, (factors < largest[:, None]).to(step))
    shrink = 1 / factors
    moved = 1 - shrink
    weights = counts / counts.sum(1, keepdim=True)
    moves = torch.stack([shrink, moved * ((width - 1) / 2), moved * ((height - 1) / 2), weights], 2)
    return Operation(sum_of_moved, (moves,))


class Defocus(IntensityAugmentationBase2D, keeps_contract=True):
    """Blur images by disks, as a lens out of focus does; borders are reflected.

    Args:
        radius_range: pair of the lowest and the highest radius of the disk in pixels, ints of at least 1.
        alias_blur_range: pair of the lowest and the highest deviation of the Gaussian that blurs the edge of the disk, above 0.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; in a call, images smaller than the disk.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.zeros(1, 1, 9, 9)
        >>> x[..., 4, 4] = 1
        >>> K.augmentation.Defocus((1, 1), (0.1, 0.1), p=1.0)(x)[0, 0, 4, 3:6]
        tensor([0.2000, 0.2000, 0.2000])
    """

    def __init__(
        self,
        radius_range: tuple[int, int] = (3, 10),
        alias_blur_range: Numbers = (0.1, 0.5),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        radii = ranges.parse_integers("Defocus", "radius_range", radius_range, 1)
        self._largest = radii[1]
        self._param_generator = MappedGenerator(
            (alias_blur_range, "alias_blur", None, (1e-3, float("inf"))),
            integers={"radius": radii},
            identity=[1.0],
            op="Defocus",
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(input)

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        deviation = params["alias_blur"].to(like.device, compute_dtype(like))
        radius = params["radius"].to(like.device, torch.int64)
        disks = disk_kernels(deviation, radius, self._largest)
        reach = disks.shape[-1] // 2
        _check.reflectable("Defocus", like, (reach, reach), "reflect", "lower radius_range")
        return Operation(filter_lists.filter2d, filter_arguments("Defocus", like, disks)[1:])


class RingingOvershoot(IntensityAugmentationBase2D, keeps_contract=True):
    """Filter images by circular low-pass filters of few taps, whose edges ring, within [0, 1]; borders are reflected.

    Args:
        blur_range: pair of the lowest and the highest side of the filter in pixels, odd ints of at least 3.
        cutoff_range: pair of the lowest and the highest frequency that passes, within 0 and pi radians a pixel.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; in a call, images smaller than the
            filter.

    Example:
        >>> import torch, kvision as K
        >>> step = 0.5 * (torch.arange(16) > 7).float().expand(1, 1, 16, 16)
        >>> bool(K.augmentation.RingingOvershoot((7, 7), (1.5, 1.5), p=1.0)(step).amax() > 0.52)
        True
    """

    def __init__(
        self,
        blur_range: tuple[int, int] = (7, 15),
        cutoff_range: Numbers = (math.pi / 4, math.pi / 2),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "RingingOvershoot"
        sizes = ranges.parse_integers(op, "blur_range", blur_range, 3)
        _check.odd(op, "blur_range", sizes)
        self._reach = sizes[1] // 2
        self._param_generator = MappedGenerator(
            (cutoff_range, "cutoff", None, (1e-3, math.pi)), integers={"blur": (*sizes, 2)}, identity=[1.0], op=op
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(input)

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        _check.reflectable("RingingOvershoot", like, (self._reach, self._reach), "reflect", "lower blur_range")
        own = compute_dtype(like)
        side, cutoff = (params[name].to(like.device, own)[:, None, None] for name in ("blur", "cutoff"))
        at = torch.arange(-self._reach, self._reach + 1, device=like.device, dtype=own)
        y, x = at[:, None], at
        radius = (y * y + x * x).sqrt()
        wave = torch.special.bessel_j1(cutoff * radius) / (2 * math.pi * radius)
        taps = torch.where(radius == 0, cutoff / (4 * math.pi), wave)
        taps = taps * (torch.maximum(y.abs(), x.abs()) <= (side - 1) / 2)
        total = taps.double().sum((1, 2), keepdim=True).to(own)  # whose bits do not depend on the number of samples
        _, *arguments, _ = filter_arguments("RingingOvershoot", like, taps / total)
        return Operation(filter_lists.filter2d_clamped, tuple(arguments))


class ZoomBlur(IntensityAugmentationBase2D, keeps_contract=True):
    """Average images with enlargements of them about the center, as a lens that zooms during the exposure does.

    The factors are 1, 1 + step, 1 + 2 step, ... below the largest one, and the image counts once more.

    Args:
        max_factor_range: pair of the lowest and the highest bound of factors, of at least 1.
        step_factor_range: pair of the lowest and the highest step, above 0.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; more than 256 factors.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.ZoomBlur(p=1.0)(torch.full((1, 1, 8, 8), 0.25)).mean()
        tensor(0.2500)
    """

    def __init__(
        self,
        max_factor_range: Numbers = (1.0, 1.31),
        step_factor_range: Numbers = (0.01, 0.03),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        generator = MappedGenerator(
            (max_factor_range, "max_factor", None, (1.0, float("inf"))),
            (step_factor_range, "step_factor", None, (1e-4, float("inf"))),
            identity=[1.0, 1.0],
            op="ZoomBlur",
        )
        largest, step = generator._ranges[0].high, generator._ranges[1].low
        self._most = math.ceil((largest - 1) / step)
        if self._most > 256:
            raise ValueCheckError(f"ZoomBlur: expected at most 256 factors, got {self._most} between 1 and {largest:g}")
        self._param_generator = generator

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(input)

    keeps_unchosen = True  # of which the largest factor is 1

    def _operation(self, like: Tensor, params: Params, images: Sequence[Tensor] | None = None) -> Operation:
        largest, step = (params[name].to(like.device, compute_dtype(like)) for name in ("max_factor", "step_factor"))
        return mean_of_enlargements(sides_of(like, images), largest, step, self._most)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        return self._operation(like, self._params_on_device(like, execution, for_users=False), images)


class GlassBlur(IntensityAugmentationBase2D, keeps_contract=True):
    """Blur images, let each pixel read a random neighbor, several times, and blur them again, as frosted glass does.

    Args:
        sigma: standard deviation of both Gaussian blurs in pixels.
        max_delta: how far away the neighbor is at most, along x and along y.
        iterations: how often.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: `sigma` is not a number above 0; the others are no ints of at least 1; in a call, images smaller than
            the window of the blurs.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.GlassBlur(p=1.0)(torch.full((1, 1, 8, 8), 0.5)).mean()
        tensor(0.5000)
    """

    fuses_noise = True

    def __init__(
        self,
        sigma: float = 0.7,
        max_delta: int = 4,
        iterations: int = 2,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "GlassBlur"
        self.sigma = ranges.parse(op, "sigma", (sigma, sigma), bounds=(1e-3, float("inf"))).low
        (_, self.max_delta) = ranges.parse_integers(op, "max_delta", (1, max_delta))
        (_, self.iterations) = ranges.parse_integers(op, "iterations", (1, iterations))
        self._param_generator = MappedGenerator(maps={"offsets": Moves(self.iterations)}, op=op)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(input)

    def _operation(self, like: Tensor, params: Params) -> Operations:
        noise = params["_noise"][1] if "_noise" in params else params["offsets"]
        return glass(like, noise, self.sigma, self.max_delta, self.iterations)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operations:
        params = self._params_on_device(like, execution, for_users=False)
        if "_noise" not in params:
            params["offsets"] = packed_maps(params["offsets"], images, 2 * self.iterations)
        return self._operation(smallest_batch(images), params)

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return self.max_delta <= MAX_DELTA and super()._operates_on(dtype)
