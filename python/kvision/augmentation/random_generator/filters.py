"""Generators of filters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.keys import refuse_graphs
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import TypeCheckError, ValueCheckError

__all__ = ["JPEGGenerator", "MotionBlurGenerator", "RandomGaussianBlurGenerator"]


class RandomGaussianBlurGenerator(PlainUniformGenerator):
    """Draws the parameters of :class:`RandomGaussianBlur`.

    Args:
        sigma: range of the standard deviation in pixels, above 0.

    Returns:
        sigma (B,).

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not above 0.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.RandomGaussianBlurGenerator((2.0, 2.0))((2, 3, 8, 8))
        {'sigma': tensor([2., 2.])}
    """

    def __init__(self, sigma: Numbers = (0.1, 2.0)) -> None:
        super().__init__((sigma, "sigma", None, (0.0, float("inf"))), identity=[1.0], op="RandomGaussianBlur")
        if self._ranges[0].tensor is None and self._ranges[0].low <= 0:
            raise ValueCheckError(f"RandomGaussianBlur: expected sigma above 0, got {sigma}")


class JPEGGenerator(PlainUniformGenerator):
    """Draws the parameters of :class:`RandomJPEG`.

    Args:
        jpeg_quality: a number q for q to 100, or a pair, within 1 and 100.

    Returns:
        jpeg_quality (B,).

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not within 1 and 100.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.JPEGGenerator((50.0, 50.0))((2, 3, 8, 8))
        {'jpeg_quality': tensor([50., 50.])}
    """

    def __init__(self, jpeg_quality: Numbers = 50.0) -> None:
        if isinstance(jpeg_quality, (int, float)) or (isinstance(jpeg_quality, Tensor) and jpeg_quality.dim() == 0):
            quality: Any = (jpeg_quality, 100.0)
        else:
            quality = jpeg_quality
        super().__init__((quality, "jpeg_quality", None, (1.0, 100.0)), identity=[100.0], op="RandomJPEG")


class MotionBlurGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomMotionBlur`.

    Args:
        kernel_size: length of the line, odd and at least 3, or a pair of lowest and highest.
        angle: degrees: a number a for -a to a, or a pair.
        direction: a number d for -d to d, or a pair, within -1 and 1.

    Returns:
        ksize_factor (B,), int32, the same for all samples; angle_factor and direction_factor (B,).

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; an even size.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.MotionBlurGenerator(3, 35.0, 0.5)((2, 3, 8, 8))["ksize_factor"]
        tensor([3, 3], dtype=torch.int32)
    """

    op = "RandomMotionBlur"

    def __init__(self, kernel_size: int | tuple[int, int], angle: Numbers, direction: Numbers) -> None:
        super().__init__()
        op = self.op
        angle, direction = ranges.keep_parameters(self, angle=angle, direction=direction)
        kernel_size = _check.scalars(op, "kernel_size", kernel_size)
        sizes = (kernel_size, kernel_size) if isinstance(kernel_size, int) else tuple(kernel_size)
        if len(sizes) != 2 or any(type(n) is not int for n in sizes):
            raise TypeCheckError(f"{op}: expected kernel_size to be an int or a pair of ints, got {kernel_size!r}")
        if not 3 <= sizes[0] <= sizes[1] or sizes[0] % 2 == 0 or sizes[1] % 2 == 0:
            raise ValueCheckError(f"{op}: expected kernel_size odd and at least 3, ascending, got {kernel_size}")
        self._sizes = sizes
        self._angle = ranges.parse(op, "angle", angle, center=0.0, bounds=(-360.0, 360.0))
        self._direction = ranges.parse(op, "direction", direction, center=0.0, bounds=(-1.0, 1.0))

    def draws(self, shape: Shape) -> Sequence[Any]:
        low, high = self._sizes
        # 0 for samples that are not chosen, by which the first of the others is known.
        return [Draw("integer", (low, 2, (high - low) // 2 + 1, 0)), self._angle.uniform(), self._direction.uniform()]

    @property
    def _has_one_size(self) -> bool:
        return self._sizes[0] == self._sizes[1]

    def _sizes_on_host(self, ksize: Tensor) -> list[int]:
        """The sizes of samples; one for all if it is the same."""
        if self._has_one_size or ksize.numel() == 0:
            return [self._sizes[0]]
        refuse_graphs(self.op)
        sizes = ksize.tolist()
        return sizes if len(set(sizes)) > 1 else sizes[:1]

    def _sizes_of_samples(self, columns: Tensor) -> Tensor:
        """ksize_factor (B,) of samples with a size each."""
        return columns[:, 0].int().clamp(min=self._sizes[0])

    def _size_of_batch(self, columns: Tensor) -> Tensor:
        """ksize_factor (B,), the same for all: the size drawn for the first sample that is chosen."""
        if columns.shape[0] == 0:
            return columns[:, 0].int()
        sizes = columns[:, 0].int()
        first = (sizes > 0).int().argmax(0, keepdim=True)
        return sizes[first].clamp(min=self._sizes[0]).expand(columns.shape[0])

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {
            "ksize_factor": self._size_of_batch(columns),
            "angle_factor": columns[:, 1],
            "direction_factor": columns[:, 2],
            "idx": torch.zeros(1, dtype=torch.int64, device=columns.device),
        }

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        names = ("ksize_factor", "angle_factor", "direction_factor")
        return torch.stack([params[name].to(params["angle_factor"].dtype) for name in names], 1)
