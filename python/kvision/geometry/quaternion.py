"""Quaternions as objects that multiply."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, floats
from kvision._modules import StatefulModule
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry._formula import of_all, register_formula
from kvision.geometry.conversions.euler import euler_from_quaternion, quaternion_from_euler
from kvision.geometry.conversions.rotations import (
    axis_angle_to_quaternion,
    normalize_quaternion,
    quaternion_exp_to_log,
    quaternion_log_to_exp,
    quaternion_to_axis_angle,
    quaternion_to_rotation_matrix,
    rotation_matrix_to_quaternion,
)
from kvision.geometry.linalg import batched_squared_norm, dominant_eigenvector, root

__all__ = ["Quaternion", "average_quaternions"]


class Quaternion(StatefulModule):
    """Quaternions w + x i + y j + z k. Those of length 1 are rotations; q and -q are the same one.

    Operators take other quaternions, tensors (*) and numbers, which are real quaternions. As a module it saves its
    data, and learns it where that is an nn.Parameter.

    Args:
        data: (*, 4) as (w, x, y, z).

    Raises:
        TypeError: `data` is not a tensor of real numbers.
        ValueError: `data` is not of shape (*, 4).

    Example:
        >>> import torch, kvision as K
        >>> i, j = (K.geometry.Quaternion(torch.eye(4)[n]) for n in (1, 2))
        >>> i * j
        Quaternion(data=tensor([0., 0., 0., 1.]))
        >>> (i**0.5).to_axis_angle()
        tensor([1.5708, 0.0000, 0.0000])
    """

    def __init__(self, data: Tensor) -> None:
        _check.trailing_shape("Quaternion", "data", data, 4)
        super().__init__()
        self._store("_data", data)

    def extra_repr(self) -> str:
        return f"data={self.data!r}"

    # --- constructors -----------------------------------------------------------------------------------------------

    @classmethod
    def identity(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Quaternion:
        """1, (4,) or (B, 4): no rotation."""
        one = torch.eye(1, 4, device=device, dtype=dtype)
        return cls(one[0] if batch_size is None else one.repeat(batch_size, 1))

    @classmethod
    def random(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Quaternion:
        """Rotations (4,) or (B, 4), all equally likely.

        Source: K. Shoemake, "Uniform random rotations" (1992).
        """
        shape = () if batch_size is None else (batch_size,)
        r, a, b = torch.rand((3, *shape), device=device, dtype=dtype)
        a, b = 2 * math.pi * a, 2 * math.pi * b
        near, far = (1 - r).sqrt(), r.sqrt()
        return cls(torch.stack([near * a.sin(), near * a.cos(), far * b.sin(), far * b.cos()], -1))

    @classmethod
    def from_coeffs(cls, w: Tensor | float, x: Tensor | float, y: Tensor | float, z: Tensor | float) -> Quaternion:
        """Quaternions of their entries, tensors (*) or numbers."""
        parts = (w, x, y, z)
        if all(isinstance(c, Tensor) for c in parts):
            return cls(torch.stack(parts, -1))  # type: ignore[arg-type]  # all are tensors
        if any(isinstance(c, Tensor) for c in parts):
            raise TypeCheckError("Quaternion.from_coeffs: expected tensors or numbers, got both")
        return cls(torch.tensor(parts))

    @classmethod
    def from_matrix(cls, matrix: Tensor, check_rotation: bool = False) -> Quaternion:
        """Rotations (*, 3, 3); see :func:`rotation_matrix_to_quaternion`."""
        return cls(rotation_matrix_to_quaternion(matrix, check_rotation=check_rotation))

    @classmethod
    def from_euler(cls, roll: Tensor, pitch: Tensor, yaw: Tensor) -> Quaternion:
        """Turns (*) about x, y and z; see :func:`quaternion_from_euler`."""
        return cls(torch.stack(quaternion_from_euler(roll, pitch, yaw), -1))

    @classmethod
    def from_axis_angle(cls, axis_angle: Tensor) -> Quaternion:
        """Axes times angles (*, 3) in radians."""
        return cls(axis_angle_to_quaternion(axis_angle))

    # --- properties -------------------------------------------------------------------------------------------------

    @property
    def data(self) -> Tensor:
        """The entries (*, 4)."""
        return self._data  # type: ignore[return-value]  # a tensor by construction

    @property
    def q(self) -> Tensor:
        """The entries (*, 4)."""
        return self.data

    @property
    def w(self) -> Tensor:
        """Real parts (*)."""
        return self.data[..., 0]

    @property
    def x(self) -> Tensor:
        """Factors (*) of i."""
        return self.data[..., 1]

    @property
    def y(self) -> Tensor:
        """Factors (*) of j."""
        return self.data[..., 2]

    @property
    def z(self) -> Tensor:
        """Factors (*) of k."""
        return self.data[..., 3]

    @property
    def coeffs(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """w, x, y and z."""
        return self.w, self.x, self.y, self.z

    @property
    def real(self) -> Tensor:
        """Real parts (*)."""
        return self.w

    @property
    def scalar(self) -> Tensor:
        """Real parts (*)."""
        return self.w

    @property
    def vec(self) -> Tensor:
        """Vector parts (*, 3)."""
        return self.data[..., 1:]

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the data."""
        return tuple(self.data.shape)

    @property
    def polar_angle(self) -> Tensor:
        """Half the angles (*) of rotation, from 0 to pi."""
        return root(batched_squared_norm(quaternion_exp_to_log(self.data)))

    def squared_norm(self) -> Tensor:
        """The squares (*) of the lengths."""
        return batched_squared_norm(self.data)

    def norm(self, keepdim: bool = False) -> Tensor:
        """The lengths (*), or (*, 1), with a gradient of 0 at 0."""
        return root(batched_squared_norm(self.data, keepdim))

    def matrix(self) -> Tensor:
        """Rotations (*, 3, 3)."""
        return quaternion_to_rotation_matrix(self.data)

    def to_euler(self) -> tuple[Tensor, Tensor, Tensor]:
        """Turns (*) about x, y and z; see :func:`euler_from_quaternion`."""
        return euler_from_quaternion(*self.coeffs)

    def to_axis_angle(self) -> Tensor:
        """Axes times angles (*, 3) in radians, at most pi long."""
        return quaternion_to_axis_angle(self.data)

    def to(self, *args: Any, **kwargs: Any) -> Quaternion:
        """The same quaternions elsewhere or of another type, as torch.Tensor.to takes these."""
        return Quaternion(self.data.to(*args, **kwargs))

    def __getitem__(self, index: Any) -> Quaternion:
        return Quaternion(self.data[index])

    # --- operations -------------------------------------------------------------------------------------------------

    def normalize(self) -> Quaternion:
        """Quaternions of length 1; 0 stays 0."""
        return Quaternion(normalize_quaternion(self.data))

    def conj(self) -> Quaternion:
        """w - x i - y j - z k."""
        return Quaternion(torch.cat([self.data[..., :1], -self.vec], -1))

    def inv(self) -> Quaternion:
        """The multiplicative inverses."""
        return Quaternion(self.conj().data / batched_squared_norm(self.data, keepdim=True))

    def slerp(self, q1: Quaternion, t: Tensor | float) -> Quaternion:
        """Rotations on the shortest way to `q1`: this one at t = 0, that one at 1, turning evenly; t is a number or (*)."""
        if not isinstance(q1, Quaternion):
            raise TypeCheckError(f"Quaternion.slerp: expected q1 to be a Quaternion, got {type(q1).__name__}")
        start = self.normalize()
        way = (start.conj() * q1.normalize()).to_axis_angle()
        if isinstance(t, Tensor) and 0 < t.dim() == way.dim() - 1:
            t = t[..., None]
        return start * Quaternion.from_axis_angle(t * way)

    def __neg__(self) -> Quaternion:
        return Quaternion(-self.data)

    def __add__(self, right: Quaternion | Tensor | float) -> Quaternion:
        return Quaternion(self.data + self._quaternion(right))

    def __radd__(self, left: Tensor | float) -> Quaternion:
        return self + left

    def __sub__(self, right: Quaternion | Tensor | float) -> Quaternion:
        return Quaternion(self.data - self._quaternion(right))

    def __rsub__(self, left: Tensor | float) -> Quaternion:
        return -self + left

    def __mul__(self, right: Quaternion | Tensor | float) -> Quaternion:
        if isinstance(right, Quaternion):
            return Quaternion(quaternion_product(self.data, right.data))
        return Quaternion(self.data * _column(right))

    def __rmul__(self, left: Tensor | float) -> Quaternion:
        return self * left

    def __truediv__(self, right: Quaternion | Tensor | float) -> Quaternion:
        return self * right.inv() if isinstance(right, Quaternion) else Quaternion(self.data / _column(right))

    def __rtruediv__(self, left: Tensor | float) -> Quaternion:
        return self.inv() * left

    def __pow__(self, t: Tensor | float) -> Quaternion:
        return Quaternion(with_kernel_casts(_power)(floats(self.data), _column(t)))

    def _quaternion(self, value: Quaternion | Tensor | float) -> Tensor:
        """A quaternion or a real number as (*, 4)."""
        if isinstance(value, Quaternion):
            return value.data
        real = torch.ones_like(self.data[..., :1]) * _column(value)
        return torch.cat([real, torch.zeros_like(real).expand(*real.shape[:-1], 3)], -1)


def _column(value: Tensor | float) -> Tensor | float:
    """Numbers (*) reshaped to multiply (*, 4)."""
    return value[..., None] if isinstance(value, Tensor) and value.dim() > 0 else value


def _product_reference(p: Tensor, q: Tensor) -> Tensor:
    a, b, c, d = p.unbind(-1)
    w, x, y, z = q.unbind(-1)
    return torch.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        -1,
    )


_product_of_rows = register_formula("quaternion_product", _product_reference, lambda *args: (4,))


def quaternion_product(p: Tensor, q: Tensor) -> Tensor:
    """The products (*, 4) of quaternions, in the wider type."""
    dtype = torch.promote_types(p.dtype, q.dtype)
    return of_all(_product_of_rows, 1, as_dtype(p, dtype), q)


def _power(q: Tensor, t: Tensor | float) -> Tensor:
    log = quaternion_exp_to_log(q)
    # A negative real number is a rotation by 2 pi, for which any axis is right.
    negative = (q[..., :1] < 0) & (q[..., 1:] == 0).all(-1, keepdim=True)
    log = torch.cat([torch.where(negative, math.pi, log[..., :1]), log[..., 1:]], -1)
    return root(batched_squared_norm(q, keepdim=True)) ** t * quaternion_log_to_exp(t * log)


def average_quaternions(Q: Quaternion, w: Tensor | None = None) -> Quaternion:
    """Average rotations: the one with the least sum of squared chordal distances from the others.

    Args:
        Q: (N, 4).
        w: weights (N,) of the squares, not negative; None for 1.

    Returns:
        (1, 4), of length 1, with its largest entry positive.

    Raises:
        TypeError: `Q` is not a Quaternion.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Source: F. Markley et al., "Averaging quaternions" (2007).

    Example:
        >>> import torch
        >>> from kvision.geometry.quaternion import Quaternion, average_quaternions
        >>> turns = torch.tensor([[0.0, 0.0, 0.2], [0.0, 0.0, 0.4]])
        >>> average_quaternions(Quaternion.from_axis_angle(turns)).to_axis_angle()
        tensor([[0.0000, 0.0000, 0.3000]])
    """
    if not isinstance(Q, Quaternion):
        raise TypeCheckError(f"average_quaternions: expected Q to be a Quaternion, got {type(Q).__name__}")
    _check.shape("average_quaternions", "Q", Q.data, "N", 4)
    if Q.data.shape[0] == 0:
        raise ShapeError("average_quaternions: expected Q of at least one quaternion, got (0, 4)")
    if w is not None:
        _check.shape("average_quaternions", "w", w, Q.data.shape[0])
        _check.same_device("average_quaternions", Q=Q.data, w=w)
    return Quaternion(with_kernel_casts(_average)(floats(Q.data), w)[None])


def _average(data: Tensor, w: Tensor | None) -> Tensor:
    unit = normalize_quaternion(data)
    weighted = unit if w is None else unit * w.to(unit.dtype)[:, None]
    return dominant_eigenvector(weighted.T @ unit)
