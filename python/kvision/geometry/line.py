"""Lines in any number of dimensions, by a point and a direction."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import StatefulModule, learned
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError
from kvision.geometry.linalg import batched_dot_product, batched_squared_norm, dominant_eigenvector, normalized, root
from kvision.geometry.plane import Hyperplane, plain, scatter_of
from kvision.geometry.vector import Scalar

__all__ = ["ParametrizedLine", "fit_line"]


class ParametrizedLine(StatefulModule):
    """Lines origin + t direction. As a module it learns and saves both.

    A tensor outside of any graph becomes an nn.Parameter; one that requires a gradient stays part of its graph.

    Args:
        origin: (*, D).
        direction: (*, D), of length 1 where distances are to be distances.

    Raises:
        TypeError: `origin` or `direction` is not a tensor of real numbers.
        ValueError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> line = K.geometry.ParametrizedLine.through(torch.tensor([0.0, 1.0]), torch.tensor([2.0, 1.0]))
        >>> line.point_at(3.0).detach(), line.distance(torch.tensor([5.0, 5.0])).detach()
        (tensor([3., 1.]), tensor(4.))
    """

    def __init__(self, origin: Tensor, direction: Tensor) -> None:
        _check.numbers("ParametrizedLine", "origin", origin)
        if origin.dim() == 0:
            raise ShapeError("ParametrizedLine: expected origin of shape (*, D), got ()")
        _check.trailing_shape("ParametrizedLine", "direction", direction, origin.shape[-1])
        super().__init__()
        self._store("_origin", learned(origin))
        self._store("_direction", learned(direction))

    def extra_repr(self) -> str:
        return f"origin={self.origin!r}, direction={self.direction!r}"

    @property
    def origin(self) -> Tensor:
        """Points (*, D) of the lines, at t = 0."""
        return self._origin  # type: ignore[return-value]  # a tensor by construction

    @property
    def direction(self) -> Tensor:
        """The directions (*, D)."""
        return self._direction  # type: ignore[return-value]  # a tensor by construction

    def __getitem__(self, index: int) -> Tensor:
        return (self.origin, self.direction)[index]

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.origin, self.direction))

    @classmethod
    def through(cls, p0: Tensor, p1: Tensor) -> ParametrizedLine:
        """The lines from points (*, D) towards others; where these are the same the direction is 0."""
        _check.numbers("ParametrizedLine.through", "p0", p0)
        _check.numbers("ParametrizedLine.through", "p1", p1)
        _check.same_shape("ParametrizedLine.through", p0=p0, p1=p1)
        return cls(p0, normalized(floats(p1 - p0)))

    def dim(self) -> int:
        """The number of dimensions."""
        return self.direction.shape[-1]

    def point_at(self, t: Tensor | Scalar | float) -> Tensor:
        """The points (*, D) at a number, or at (*)."""
        t = plain(t) if isinstance(t, Scalar) else t
        if isinstance(t, Tensor) and 0 < t.dim() == self.direction.dim() - 1:
            t = t[..., None]
        return self.origin + self.direction * t

    def projection(self, point: Tensor) -> Tensor:
        """The points of the lines that are nearest to points (*, D)."""
        _check.trailing_shape("ParametrizedLine.projection", "point", point, self.dim())
        along = batched_dot_product(self.direction, point - self.origin, keepdim=True)
        return self.origin + along * self.direction

    def squared_distance(self, point: Tensor) -> Tensor:
        """The squares (*) of the distances of points (*, D) from the lines."""
        return batched_squared_norm(point - self.projection(point))

    def distance(self, point: Tensor) -> Tensor:
        """The distances (*) of points (*, D) from the lines, with a gradient of 0 on them."""
        return root(self.squared_distance(point))

    def intersect(self, plane: Hyperplane, eps: float = 1e-6) -> tuple[Tensor, Tensor]:
        """Where the lines meet planes.

        Args:
            plane: in three dimensions.
            eps: lines whose direction along the normal is less than this are parallel to their plane.

        Returns:
            t (*) and the points (*, 3); 0 and the origin for parallel lines.
        """
        across = batched_dot_product(plane.n, self.direction)
        meets = across.abs() >= eps
        gap = plane.d + batched_dot_product(plane.n, self.origin)
        t = torch.where(meets, -gap / torch.where(meets, across, 1), 0)
        return t, self.point_at(t)


def fit_line(points: Tensor, weights: Tensor | None = None) -> ParametrizedLine:
    """Fit lines to points by least squares.

    Args:
        points: (B, N, D) with N of at least 2; integers give float32.
        weights: (B, N) of the squares, not negative; None for 1. Where all are 0, so is the direction.

    Returns:
        Lines (B) through the points' weighted means, with directions of length 1 whose largest entry is positive; 0 where
        all points are the same.

    Raises:
        TypeError: `points` or `weights` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.fit_line(torch.tensor([[[0.0, 1.0], [2.0, 1.0], [4.0, 1.0]]])).direction.detach()
        tensor([[1., 0.]])
    """
    _check.shape("fit_line", "points", points, "B", "N", "D")
    if points.shape[1] < 2 or points.shape[2] < 1:
        raise ShapeError(f"fit_line: expected points of at least 2 a line, got {tuple(points.shape)}")
    if weights is not None:
        _check.shape("fit_line", "weights", weights, *points.shape[:2])
        _check.same_device("fit_line", points=points, weights=weights)
    return ParametrizedLine(*_fit_line(floats(points), weights))


@with_kernel_casts
def _fit_line(points: Tensor, weights: Tensor | None) -> tuple[Tensor, Tensor]:
    if weights is None:
        mean = points.mean(1, keepdim=True)
    else:
        weights = weights.to(points.dtype)
        total = weights.sum(1)[:, None, None]
        mean = (weights[..., None] * points).sum(1, keepdim=True) / torch.where(total != 0, total, 1)
    return mean.squeeze(1), dominant_eigenvector(scatter_of(points - mean, weights)).to(points.dtype)
