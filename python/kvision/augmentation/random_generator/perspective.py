"""Generators of perspective transforms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw, uniform
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape

__all__ = ["PerspectiveGenerator"]

SamplingMethod: TypeAlias = Literal["basic", "area_preserving"]
_METHODS = get_args(SamplingMethod)


class PerspectiveGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomPerspective`.

    Args:
        distortion_scale: how far a corner moves at most, as a fraction of half of width and height.
        sampling_method: 'basic' moves corners inward, 'area_preserving' inward or outward.

    Returns:
        start_points and end_points (B, 4, 2): the corners of the image and where they go, clockwise from top left.

    Raises:
        TypeError: `distortion_scale` is not a number.
        ValueError: `distortion_scale` is not within 0 and 1; `sampling_method` is unknown.

    Example:
        >>> import kvision as K
        >>> params = K.augmentation.random_generator.PerspectiveGenerator(0.5)((1, 3, 8, 8))
        >>> params["start_points"]
        tensor([[[0., 0.],
                 [7., 0.],
                 [7., 7.],
                 [0., 7.]]])
    """

    fields = (("end_points", 8),)

    def __init__(self, distortion_scale: float | Tensor = 0.5, sampling_method: SamplingMethod = "basic") -> None:
        super().__init__()
        op = "RandomPerspective"
        low = ranges.parse(op, "distortion_scale", [float(distortion_scale)] * 2, bounds=(0.0, 1.0)).low
        _check.choice(op, "sampling_method", sampling_method, _METHODS)
        self.distortion_scale, self.sampling_method = low, sampling_method

    def draws(self, shape: Shape) -> Sequence[Draw]:
        inward = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        draws = []
        for corner, signs in zip(corners(shape), inward):
            for coordinate, sign, size in zip(corner, signs, (shape[-1], shape[-2])):
                most = self.distortion_scale * size / 2
                if self.sampling_method == "basic":
                    low, high = (coordinate, coordinate + most) if sign > 0 else (coordinate - most, coordinate)
                else:
                    low, high = coordinate - most, coordinate + most
                draws.append(uniform(low, high, coordinate))
        return draws

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        start = torch.tensor(corners(shape), dtype=columns.dtype, device=columns.device)
        return {"start_points": start.expand(columns.shape[0], 4, 2), "end_points": columns.reshape(-1, 4, 2)}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return params["end_points"].reshape(-1, 8)


def corners(shape: Shape) -> list[tuple[float, float]]:
    """The corners (x, y) of an image, clockwise from top left."""
    right, bottom = float(shape[-1] - 1), float(shape[-2] - 1)
    return [(0.0, 0.0), (right, 0.0), (right, bottom), (0.0, bottom)]
