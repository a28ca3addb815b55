"""Rotations of space, SO(3), as unit quaternions."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._leading import broadcast_shapes
from kvision._modules import as_operands, learned
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry._formula import of_rows, register_formula
from kvision.geometry.conversions.rotations import (
    axis_angle_to_quaternion,
    quaternion_to_axis_angle,
    quaternion_to_rotation_matrix,
    rotation_matrix_to_quaternion,
    vector_to_skew_symmetric_matrix,
)
from kvision.geometry.conversions.series import sinc, squared
from kvision.geometry.liegroup.group import LieGroup, cotangent_rest, sine_rest
from kvision.geometry.quaternion import Quaternion, quaternion_product
from kvision.geometry.vector import Vector3

__all__ = ["So3"]


class So3(LieGroup):
    """Rotations of space as unit quaternions (w, x, y, z).

    `a * b` rotates by b first. `a * points` rotates points (*, 3). `a[i]` indexes the batch.

    Args:
        q: a Quaternion (*, 4) of length 1.

    Raises:
        TypeError: `q` is no Quaternion.

    Source: J. Solà et al., "A micro Lie theory for state estimation in robotics" (2018).

    Example:
        >>> import torch, kvision as K
        >>> So3 = K.geometry.liegroup.So3
        >>> quarter = So3.exp(torch.tensor([0.0, 0.0, torch.pi / 2]))
        >>> (quarter * torch.tensor([1.0, 2.0, 3.0])).round().long()
        tensor([-2,  1,  3])
        >>> (quarter * So3.rot_z(torch.tensor(1.0))).log().detach()
        tensor([0.0000, 0.0000, 2.5708])
    """

    def __init__(self, q: Quaternion) -> None:
        super().__init__()
        if not isinstance(q, Quaternion):
            raise TypeCheckError(f"So3: expected q to be a Quaternion, got {type(q).__name__}", actual_type=type(q))
        data = learned(q.data)
        self._q = q if data is q.data else Quaternion(data)

    def __repr__(self) -> str:
        return f"{self.q.data}"

    def __getitem__(self, idx: Any) -> So3:
        return self._of(self.q.data[idx])

    def __mul__(self, right: Any) -> Any:
        """Compose with rotations, or rotate points (*, 3) or a Vector3."""
        if isinstance(right, So3):
            p, q = self.q.data, right.q.data
            return So3(Quaternion(as_operands(quaternion_product(p, q), p, q)))
        if isinstance(right, Vector3):
            return Vector3(rotate("So3", self.matrix(), right.data))
        return rotate("So3", self.matrix(), right)

    def _of(self, q: Tensor) -> So3:
        """The result `q` (*, 4) of an operation on these rotations."""
        return So3(Quaternion(as_operands(q, self.q.data)))

    @property
    def q(self) -> Quaternion:
        """The quaternions (*, 4)."""
        return self._q

    @staticmethod
    def exp(v: Tensor) -> So3:
        """The exponential map: rotations about axes by angles.

        Args:
            v: (*, 3), the axis times the angle in radians.

        Returns:
            The rotations (*).
        """
        _check.floating_trailing_shape("So3.exp", "v", v, 3)
        return So3(Quaternion(axis_angle_to_quaternion(v)))

    def log(self) -> Tensor:
        """The inverse of the exponential map.

        Returns:
            (*, 3), the axis times the angle in radians, which is at most pi: q and -q are one rotation.
        """
        return quaternion_to_axis_angle(self.q.data)

    @staticmethod
    def hat(v: Vector3 | Tensor) -> Tensor:
        """Skew-symmetric matrices.

        Args:
            v: (*, 3), or a Vector3.

        Returns:
            (*, 3, 3), whose product with a vector u is v x u.
        """
        data = v.data if isinstance(v, Vector3) else v
        return vector_to_skew_symmetric_matrix(data)

    @staticmethod
    def vee(omega: Tensor) -> Tensor:
        """The vectors of skew-symmetric matrices, the inverse of :meth:`hat`.

        Args:
            omega: (*, 3, 3).

        Returns:
            (*, 3).
        """
        _check.trailing_shape("So3.vee", "omega", omega, 3, 3)
        return torch.stack([omega[..., 2, 1], omega[..., 0, 2], omega[..., 1, 0]], -1)

    def matrix(self) -> Tensor:
        """Rotation matrices (*, 3, 3)."""
        return quaternion_to_rotation_matrix(self.q.data)

    @classmethod
    def from_matrix(cls, matrix: Tensor, check_rotation: bool = False) -> So3:
        """Rotations of matrices.

        Args:
            matrix: (*, 3, 3).
            check_rotation: refuse matrices that are not rotations, which waits for the device.

        Returns:
            The rotations (*).
        """
        return cls(Quaternion(rotation_matrix_to_quaternion(matrix, check_rotation=check_rotation)))

    @classmethod
    def from_wxyz(cls, wxyz: Tensor) -> So3:
        """Rotations of quaternions (*, 4) as (w, x, y, z)."""
        return cls(Quaternion(wxyz))

    @classmethod
    def identity(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> So3:
        """The rotation by 0, one or (B,) of them."""
        return cls(Quaternion.identity(batch_size, device, dtype))

    def inverse(self) -> So3:
        """The inverse rotations."""
        return self._of(self.q.conj().data)

    @classmethod
    def random(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> So3:
        """Uniformly distributed rotations, one or (B,) of them."""
        return cls(Quaternion.random(batch_size, device, dtype))

    @classmethod
    def rot_x(cls, x: Tensor) -> So3:
        """Rotations about the x axis by angles (*) in radians."""
        return cls.exp(along_axis("So3.rot_x", "x", x, 0))

    @classmethod
    def rot_y(cls, y: Tensor) -> So3:
        """Rotations about the y axis by angles (*) in radians."""
        return cls.exp(along_axis("So3.rot_y", "y", y, 1))

    @classmethod
    def rot_z(cls, z: Tensor) -> So3:
        """Rotations about the z axis by angles (*) in radians."""
        return cls.exp(along_axis("So3.rot_z", "z", z, 2))

    def adjoint(self) -> Tensor:
        """The adjoint matrices (*, 3, 3): those of the rotations. `g * exp(v) = exp(adjoint @ v) * g`."""
        return self.matrix()

    @staticmethod
    def left_jacobian(vec: Tensor) -> Tensor:
        """The left Jacobian of the exponential map: exp(v + d) is exp(J d) * exp(v) for small d.

        Args:
            vec: tangent vectors (*, 3).

        Returns:
            (*, 3, 3).
        """
        _check.trailing_shape("So3.left_jacobian", "vec", vec, 3)
        return of_rows(_left_jacobian, floats(vec), 1)

    @staticmethod
    def left_jacobian_inverse(vec: Tensor) -> Tensor:
        """The inverse of the left Jacobian.

        Args:
            vec: tangent vectors (*, 3), shorter than 2 pi.

        Returns:
            (*, 3, 3).
        """
        _check.trailing_shape("So3.left_jacobian_inverse", "vec", vec, 3)
        return of_rows(_left_jacobian_inverse, floats(vec), 1)

    @staticmethod
    def right_jacobian(vec: Tensor) -> Tensor:
        """The right Jacobian of the exponential map: exp(v + d) is exp(v) * exp(J d) for small d.

        Args:
            vec: tangent vectors (*, 3).

        Returns:
            (*, 3, 3), the transpose of the left one.
        """
        return So3.left_jacobian(vec).mT

    @staticmethod
    def right_jacobian_inverse(vec: Tensor) -> Tensor:
        """The inverse of the right Jacobian, for tangent vectors (*, 3) shorter than 2 pi."""
        return So3.left_jacobian_inverse(vec).mT

    Jl = left_jacobian
    Jr = right_jacobian


def along_axis(op: str, name: str, x: Any, axis: int, n: int = 3) -> Tensor:
    """Vectors (*, n) with `x` (*) in the component `axis` and 0 in the others."""
    _check.is_tensor(op, name, x)
    _check.floating(op, name, x)
    return torch.stack([x if i == axis else torch.zeros_like(x) for i in range(n)], -1)


def rotate(op: str, matrix: Tensor, points: Any) -> Tensor:
    """`matrix` (*, n, n) times points (*, n); the leading axes broadcast."""
    _check.trailing_shape(op, "points", points, matrix.shape[-1])
    _check.same_device(op, rotation=matrix, points=points)
    try:
        broadcast_shapes(matrix.shape[:-2], points.shape[:-1])
    except RuntimeError:
        raise ShapeError(
            f"{op}: expected points whose leading axes broadcast with {tuple(matrix.shape[:-2])}, got {tuple(points.shape)}",
            actual_shape=points.shape,
        ) from None
    return (matrix * points[..., None, :]).sum(-1)


# --- Jacobians -------------------------------------------------------------------------------------------------------


def skew(v: Tensor) -> Tensor:
    """The skew-symmetric matrices (*, 3, 3) of v (*, 3)."""
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))


def left_jacobian_of(v: Tensor) -> Tensor:
    """I + b V + c V^2 of V = skew(v), with b = (1 - cos x) / x^2 and c = (x - sin x) / x^3."""
    square = squared(v)[..., None]
    V = skew(v)
    b, c = sinc(square / 4).square() / 2, sine_rest(square)
    return torch.eye(3, dtype=v.dtype, device=v.device) + b * V + c * (V @ V)


def left_jacobian_inverse_of(v: Tensor) -> Tensor:
    """I - V / 2 + d V^2, with d = (1 - (x / 2) cot(x / 2)) / x^2."""
    V = skew(v)
    return torch.eye(3, dtype=v.dtype, device=v.device) - V / 2 + cotangent_rest(squared(v)[..., None]) * (V @ V)


_left_jacobian = register_formula("so3_left_jacobian", left_jacobian_of, lambda *args: (3, 3))
_left_jacobian_inverse = register_formula("so3_left_jacobian_inverse", left_jacobian_inverse_of, lambda *args: (3, 3))
