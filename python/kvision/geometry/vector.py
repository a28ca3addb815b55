"""Scalars and vectors as tensor wrappers with named entries."""

from __future__ import annotations

from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import TypeCheckError
from kvision.core.tensor_wrapper import TensorWrapper
from kvision.geometry.linalg import batched_dot_product, batched_squared_norm, normalized

__all__ = ["Scalar", "Vector2", "Vector3"]

Self = TypeVar("Self", bound="_Vector")


class Scalar(TensorWrapper):
    """A tensor of scalars.

    Args:
        data: scalars, of any shape.

    Example:
        >>> import torch
        >>> from kvision.geometry.vector import Scalar
        >>> Scalar(torch.tensor(2.0)) * 3
        Scalar(6.0)
    """


class _Vector(TensorWrapper):
    _width: ClassVar[int]

    def __init__(self, vector: Tensor | TensorWrapper) -> None:
        super().__init__(vector)
        _check.trailing_shape(type(self).__name__, "vector", self._data, self._width)

    @classmethod
    def _wrap(cls, value: Any) -> Any:
        """Results that are not vectors, such as a sum, are plain tensors."""
        if isinstance(value, Tensor) and (value.dim() == 0 or value.shape[-1] != cls._width):
            return value
        return super()._wrap(value)

    @property
    def x(self) -> Tensor:
        """The first entries (*)."""
        return self._data[..., 0]

    @property
    def y(self) -> Tensor:
        """The second entries (*)."""
        return self._data[..., 1]

    def normalized(self: Self) -> Self:
        """Unit vectors in the same directions. The vector 0 remains 0."""
        return type(self)(normalized(self._data))

    def dot(self: Self, right: Self) -> Scalar:
        """The dot products with other vectors, of shape (*)."""
        return Scalar(batched_dot_product(self._data, right.data))

    def squared_norm(self) -> Scalar:
        """The squared norms, of shape (*)."""
        return Scalar(batched_squared_norm(self._data))

    @classmethod
    def random(
        cls: type[Self],
        shape: tuple[int, ...] | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Self:
        """Vectors of shape (*shape, D) with entries drawn uniformly from [0, 1)."""
        return cls(torch.rand((*(shape or ()), cls._width), device=device, dtype=dtype))

    @classmethod
    def _from_entries(
        cls: type[Self], coords: tuple[Tensor | float, ...], device: Any, dtype: torch.dtype | None
    ) -> Self:
        if all(isinstance(c, Tensor) for c in coords):
            return cls(torch.stack(coords, -1).to(device=device, dtype=dtype))  # type: ignore[arg-type]  # all are tensors
        if any(isinstance(c, Tensor) for c in coords):
            raise TypeCheckError(f"{cls.__name__}.from_coords: expected tensors or numbers, got both")
        return cls(torch.tensor(coords, device=device, dtype=dtype))


class Vector2(_Vector):
    """Vectors (x, y).

    Args:
        vector: a tensor of shape (*, 2).

    Raises:
        TypeError: `vector` is not a tensor of real numbers.
        ValueError: `vector` is not of shape (*, 2).

    Example:
        >>> from kvision.geometry.vector import Vector2
        >>> Vector2.from_coords(3.0, 4.0).normalized()
        Vector2(tensor([0.6000, 0.8000]))
    """

    _width = 2

    @classmethod
    def from_coords(
        cls,
        x: Tensor | float,
        y: Tensor | float,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Vector2:
        """Vectors from their entries: all tensors of shape (*), or all numbers."""
        return cls._from_entries((x, y), device, dtype)


class Vector3(_Vector):
    """Vectors (x, y, z).

    Args:
        vector: a tensor of shape (*, 3).

    Raises:
        TypeError: `vector` is not a tensor of real numbers.
        ValueError: `vector` is not of shape (*, 3).

    Example:
        >>> from kvision.geometry.vector import Vector3
        >>> v = Vector3.from_coords(1.0, 2.0, 3.0)
        >>> v.z, v.dot(v)
        (tensor(3.), Scalar(14.0))
    """

    _width = 3

    @property
    def z(self) -> Tensor:
        """The third entries (*)."""
        return self._data[..., 2]

    @classmethod
    def from_coords(
        cls,
        x: Tensor | float,
        y: Tensor | float,
        z: Tensor | float,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Vector3:
        """Vectors from their entries: all tensors of shape (*), or all numbers."""
        return cls._from_entries((x, y, z), device, dtype)
