"""Rotations of the plane, SO(2), as unit complex numbers."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import as_operands, learned
from kvision.core.exceptions import TypeCheckError
from kvision.geometry.liegroup.group import LieGroup, shape_of
from kvision.geometry.liegroup.so3 import rotate

__all__ = ["So2"]


class So2(LieGroup):
    """Rotations of the plane as unit complex numbers.

    `a * b` composes rotations. `a * points` rotates points (*, 2), counter-clockwise where y points up. `a[i]` indexes the batch.

    Args:
        z: complex numbers (*) of length 1.

    Raises:
        TypeError: `z` is not a complex tensor.

    Example:
        >>> import torch, kvision as K
        >>> quarter = K.geometry.liegroup.So2.exp(torch.tensor(torch.pi / 2))
        >>> (quarter * torch.tensor([1.0, 2.0])).round().long()
        tensor([-2,  1])
        >>> quarter.inverse().log().detach()
        tensor(-1.5708)
    """

    tangent_axes = 0

    def __init__(self, z: Tensor) -> None:
        super().__init__()
        if not isinstance(z, Tensor) or not z.is_complex():
            got = str(z.dtype) if isinstance(z, Tensor) else type(z).__name__
            raise TypeCheckError(f"So2: expected z to be a complex Tensor, got {got}", actual_type=got)
        self._store("_z", learned(z))

    def __repr__(self) -> str:
        return f"{self.z}"

    def __getitem__(self, idx: Any) -> So2:
        return So2(as_operands(self.z[idx], self.z))

    def __mul__(self, right: Any) -> Any:
        """Compose with rotations, or rotate points (*, 2)."""
        if isinstance(right, So2):
            return So2(as_operands(self.z * right.z, self.z, right.z))
        return rotate("So2", self.matrix(), right)

    @property
    def z(self) -> Tensor:
        """The complex numbers (*)."""
        return self._z  # type: ignore[return-value]  # a tensor by construction

    @staticmethod
    def exp(theta: Tensor) -> So2:
        """The exponential map: rotations by angles (*) in radians."""
        _check.is_tensor("So2.exp", "theta", theta)
        _check.floating("So2.exp", "theta", theta)
        return So2(torch.complex(theta.cos(), theta.sin()))

    def log(self) -> Tensor:
        """The angles (*) in radians, from -pi to pi."""
        return torch.atan2(self.z.imag, self.z.real)

    @staticmethod
    def hat(theta: Tensor) -> Tensor:
        """The skew-symmetric matrices (*, 2, 2) of angles (*)."""
        _check.is_tensor("So2.hat", "theta", theta)
        zero = torch.zeros_like(theta)
        return torch.stack([zero, -theta, theta, zero], -1).unflatten(-1, (2, 2))

    @staticmethod
    def vee(omega: Tensor) -> Tensor:
        """The angles (*) of skew-symmetric matrices (*, 2, 2), the inverse of :meth:`hat`."""
        _check.trailing_shape("So2.vee", "omega", omega, 2, 2)
        return omega[..., 1, 0]

    def matrix(self) -> Tensor:
        """Rotation matrices (*, 2, 2)."""
        cosine, sine = self.z.real, self.z.imag
        return torch.stack([cosine, -sine, sine, cosine], -1).unflatten(-1, (2, 2))

    @classmethod
    def from_matrix(cls, matrix: Tensor) -> So2:
        """Rotations of matrices (*, 2, 2)."""
        _check.floating_trailing_shape("So2.from_matrix", "matrix", matrix, 2, 2)
        return cls(torch.complex(matrix[..., 0, 0].contiguous(), matrix[..., 1, 0].contiguous()))

    @classmethod
    def identity(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> So2:
        """The rotation by 0, one or (B,) of them. `dtype` is that of the real part."""
        one = torch.ones(shape_of(batch_size), device=device, dtype=dtype)
        return cls(torch.complex(one, torch.zeros_like(one)))

    def inverse(self) -> So2:
        """The inverse rotations."""
        return So2(as_operands(self.z.conj().resolve_conj(), self.z))

    @classmethod
    def random(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> So2:
        """Uniformly distributed rotations, one or (B,) of them."""
        return cls.exp(2 * math.pi * torch.rand(shape_of(batch_size), device=device, dtype=dtype))

    def adjoint(self) -> Tensor:
        """Identity matrices (*, 2, 2): rotations of the plane commute."""
        return torch.eye(2, dtype=self.z.real.dtype, device=self.z.device).expand(*self.z.shape, 2, 2).clone()
