"""Planes in space, and lines in the plane: the points whose distance along a normal is the same."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats, promoted
from kvision._modules import StatefulModule, learned
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.core.tensor_wrapper import TensorWrapper
from kvision.geometry.linalg import adjugate, batched_dot_product, dominant_eigenvector, normalized
from kvision.geometry.vector import Scalar, Vector3

__all__ = ["Hyperplane", "fit_plane"]


class Hyperplane(StatefulModule):
    """Planes n x + d = 0. As a module it learns and saves both.

    A tensor outside of any graph becomes an nn.Parameter; one that requires a gradient stays part of its graph.

    Args:
        n: normals (*, 3), of length 1 where distances are to be distances; a Vector3 or a tensor.
        d: offsets (*); a Scalar or a tensor.

    Raises:
        TypeError: `n` or `d` is not a tensor.
        ValueError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> floor = K.geometry.Hyperplane(torch.tensor([0.0, 0.0, 1.0]), torch.tensor(-2.0))
        >>> floor.signed_distance(torch.tensor([5.0, 5.0, 3.0]))
        Scalar(1.0)
        >>> floor.projection(torch.tensor([5.0, 5.0, 3.0])).data.detach()
        tensor([5., 5., 2.])
    """

    def __init__(self, n: Vector3 | Tensor, d: Scalar | Tensor) -> None:
        n, d = plain(n), plain(d)
        _check.trailing_shape("Hyperplane", "n", n, 3)
        _check.numbers("Hyperplane", "d", d)
        if n.shape[:-1] != d.shape:
            _check.broadcastable("Hyperplane", n=n.shape[:-1], d=d.shape)
        super().__init__()
        self._store("_n", learned(n))
        self._store("_d", learned(d))

    def extra_repr(self) -> str:
        return f"n={self.n!r}, d={self.d!r}"

    @classmethod
    def from_vector(cls, n: Vector3 | Tensor, e: Vector3 | Tensor) -> Hyperplane:
        """The planes with normals `n` through points `e`."""
        return cls(n, -batched_dot_product(plain(n), plain(e)))

    @classmethod
    def through(cls, p0: Vector3 | Tensor, p1: Vector3 | Tensor, p2: Vector3 | Tensor | None = None) -> Hyperplane:
        """The planes through three points (*, 3); normals are 0 where these are on a line."""
        if p2 is None:
            raise ValueCheckError("Hyperplane.through: expected three points, got two")
        points = {"p0": plain(p0), "p1": plain(p1), "p2": plain(p2)}
        for name, p in points.items():
            _check.trailing_shape("Hyperplane.through", name, p, 3)
        _check.same_shape("Hyperplane.through", **points)
        normal = with_kernel_casts(lambda a, b, c: normalized(torch.linalg.cross(c - a, b - a)))(
            *map(floats, points.values())
        )
        return cls.from_vector(normal, floats(points["p0"]))

    @property
    def n(self) -> Tensor:
        """The normals (*, 3)."""
        return self._n  # type: ignore[return-value]  # a tensor by construction

    @property
    def d(self) -> Tensor:
        """The offsets (*)."""
        return self._d  # type: ignore[return-value]  # a tensor by construction

    @property
    def normal(self) -> Vector3:
        """The normals (*, 3)."""
        return Vector3(self.n)

    @property
    def offset(self) -> Scalar:
        """The offsets (*)."""
        return Scalar(self.d)

    def signed_distance(self, p: Vector3 | Tensor) -> Scalar:
        """How far points (*, 3) are in front of the planes, (*)."""
        return Scalar(batched_dot_product(self.n, plain(p)) + self.d)

    def abs_distance(self, p: Vector3 | Tensor) -> Scalar:
        """How far points (*, 3) are from the planes, (*)."""
        return Scalar(self.signed_distance(p).data.abs())

    def projection(self, p: Vector3 | Tensor) -> Vector3:
        """The points of the planes that are nearest to points (*, 3)."""
        return Vector3(plain(p) - self.signed_distance(p).data[..., None] * self.n)


def fit_plane(points: Vector3 | Tensor) -> Hyperplane:
    """Fit planes to points by least squares.

    Args:
        points: (*, N, 3) with N of at least 3; a tensor or a Vector3.

    Returns:
        Planes (*). Points on a line have many planes; one of them comes out, or one with the normal 0.

    Raises:
        TypeError: `points` is not a tensor of real numbers.
        ValueError: `points` is not of shape (*, N, 3).

    Example:
        >>> import torch, kvision as K
        >>> plane = K.geometry.fit_plane(torch.tensor([[1.0, 0, 2], [0, 1, 2], [3, 4, 2]]))
        >>> plane.abs_distance(torch.tensor([7.0, 7.0, 5.0])).data.detach().round()
        tensor(3.)
    """
    points = plain(points)
    _check.trailing_shape("fit_plane", "points", points, 3)
    if points.dim() < 2 or points.shape[-2] < 3:
        raise ShapeError(f"fit_plane: expected points of shape (*, N, 3), N of at least 3, got {tuple(points.shape)}")
    return Hyperplane(*_fit_plane(floats(points)))


@with_kernel_casts
def _fit_plane(points: Tensor) -> tuple[Tensor, Tensor]:
    mean = points.mean(-2, keepdim=True)
    scatter = scatter_of(points - mean)
    normal = dominant_eigenvector(adjugate(scatter)).to(points.dtype)
    return normal, -(normal * mean.squeeze(-2)).sum(-1)


def scatter_of(offsets: Tensor, weights: Tensor | None = None) -> Tensor:
    """Sums (*, D, D) of products of offsets (*, N, D) from their mean, up to a factor."""
    is_float64 = offsets.dtype == torch.float64
    offsets = promoted(offsets)
    if is_float64 or offsets.dtype != torch.float64:  # products of narrower types are within the range of float64
        scale = offsets.detach().abs().amax((-2, -1), keepdim=True)
        offsets = offsets / scale.clamp(min=torch.finfo(scale.dtype).tiny)
    heavy = offsets if weights is None else offsets * promoted(weights)[..., None]
    return torch.bmm(heavy.mT, offsets) if offsets.dim() == 3 else heavy.mT @ offsets


def plain(x: Tensor | TensorWrapper) -> Tensor:
    return x.data if isinstance(x, TensorWrapper) else x
