"""Rigid motions of the plane, SE(2): a rotation and a translation."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import as_operands, learned
from kvision.core.exceptions import TypeCheckError
from kvision.geometry._formula import of_rows, register_formula
from kvision.geometry.conversions.series import sinc
from kvision.geometry.liegroup.group import RigidMotion, check_translation, cotangent_rest, shape_of
from kvision.geometry.liegroup.so2 import So2
from kvision.geometry.liegroup.so3 import along_axis
from kvision.geometry.vector import Vector2

__all__ = ["Se2"]


class Se2(RigidMotion[So2]):
    """Rigid motions of the plane: p becomes R p + t.

    A tangent vector is (translation 2, angle). `a * b` applies b first. `a * points` moves points (*, 2). `a[i]` indexes the batch.

    Args:
        rotation: So2 (*).
        translation: (*, 2), or a Vector2.

    Raises:
        TypeError: `rotation` is no So2, or `translation` no floating-point tensor.
        ValueError: `translation` has another shape.

    Source: J. Solà et al., "A micro Lie theory for state estimation in robotics" (2018).

    Example:
        >>> import torch, kvision as K
        >>> Se2 = K.geometry.liegroup.Se2
        >>> move = Se2.exp(torch.tensor([1.0, 0.0, torch.pi / 2]))
        >>> (move * torch.tensor([0.0, 0.0])).detach()
        tensor([0.6366, 0.6366])
        >>> (move * move.inverse()).matrix().detach().round().long()
        tensor([[1, 0, 0],
                [0, 1, 0],
                [0, 0, 1]])
    """

    def __init__(self, rotation: So2, translation: Vector2 | Tensor) -> None:
        super().__init__()
        if not isinstance(rotation, So2):
            raise TypeCheckError(f"Se2: expected rotation to be an So2, got {type(rotation).__name__}")
        data = translation.data if isinstance(translation, Vector2) else translation
        check_translation("Se2", data, 2)
        self._rotation = rotation
        self._store("_translation", learned(data))

    def __mul__(self, right: Any) -> Any:
        """Compose with motions, or move points (*, 2)."""
        if isinstance(right, Se2):
            t = self.r * right.t + self.t
            return Se2(self.r * right.r, as_operands(t, self.r.z, self.t, right.t))
        return self.r * right + self.t

    @property
    def so2(self) -> So2:
        """The rotations."""
        return self._rotation

    @staticmethod
    def exp(v: Tensor) -> Se2:
        """The exponential map.

        Args:
            v: tangent vectors (*, 3), the translation and the angle in radians.

        Returns:
            The motions (*).
        """
        _check.floating_trailing_shape("Se2.exp", "v", v, 3)
        motion = of_rows(_exp, v, 1)
        return Se2(So2(torch.complex(motion[..., 0], motion[..., 1])), motion[..., 2:])

    def log(self) -> Tensor:
        """The tangent vectors (*, 3), with angles from -pi to pi."""
        z = self.r.z
        t = self.t.expand(*torch.broadcast_shapes(z.shape, self.t.shape[:-1]), 2)
        rotation = torch.stack([z.real, z.imag], -1).expand_as(t)
        return of_rows(_log, torch.cat([rotation, t], -1), 1)

    @staticmethod
    def hat(v: Tensor) -> Tensor:
        """The matrices (*, 3, 3) of tangent vectors (*, 3), whose matrix exponential is the motion."""
        _check.trailing_shape("Se2.hat", "v", v, 3)
        x, y, theta = v.unbind(-1)
        zero = torch.zeros_like(x)
        return torch.stack([zero, -theta, x, theta, zero, y, zero, zero, zero], -1).unflatten(-1, (3, 3))

    @staticmethod
    def vee(omega: Tensor) -> Tensor:
        """The tangent vectors (*, 3) of matrices (*, 3, 3), the inverse of :meth:`hat`."""
        _check.trailing_shape("Se2.vee", "omega", omega, 3, 3)
        return torch.stack([omega[..., 0, 2], omega[..., 1, 2], omega[..., 1, 0]], -1)

    @classmethod
    def identity(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Se2:
        """The identity, one or (B,) of them."""
        t = torch.zeros(*shape_of(batch_size), 2, device=device, dtype=dtype)
        return cls(So2.identity(batch_size, device, dtype), t)

    def matrix(self) -> Tensor:
        """Homogeneous matrices (*, 3, 3)."""
        top = torch.cat([self.r.matrix(), self.t[..., None]], -1)
        last = top.new_tensor([0, 0, 1]).expand(*top.shape[:-2], 1, 3)
        return torch.cat([top, last], -2)

    @classmethod
    def from_matrix(cls, matrix: Tensor) -> Se2:
        """Motions of homogeneous matrices (*, 3, 3)."""
        _check.floating_trailing_shape("Se2.from_matrix", "matrix", matrix, 3, 3)
        return cls(So2.from_matrix(matrix[..., :2, :2]), matrix[..., :2, 2].clone())

    def inverse(self) -> Se2:
        """The inverse motions."""
        r = self.r.inverse()
        return Se2(r, as_operands(-(r * self.t), self.r.z, self.t))

    @classmethod
    def random(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Se2:
        """Uniformly distributed rotations with translations in [0, 1)."""
        r = So2.random(batch_size, device, dtype)
        return cls(r, torch.rand(*shape_of(batch_size), 2, device=device, dtype=dtype))

    @classmethod
    def trans(cls, x: Tensor, y: Tensor) -> Se2:
        """Translations by x (*) and y (*)."""
        for name, value in (("x", x), ("y", y)):
            _check.is_tensor("Se2.trans", name, value)
            _check.floating("Se2.trans", name, value)
        t = torch.stack(torch.broadcast_tensors(x, y), -1)
        one = torch.ones_like(t[..., 0]).detach()
        return cls(So2(torch.complex(one, torch.zeros_like(one))), t)

    @classmethod
    def trans_x(cls, x: Tensor) -> Se2:
        """Translations along x by distances (*)."""
        return cls.trans(*along_axis("Se2.trans_x", "x", x, 0, 2).unbind(-1))

    @classmethod
    def trans_y(cls, y: Tensor) -> Se2:
        """Translations along y by distances (*)."""
        return cls.trans(*along_axis("Se2.trans_y", "y", y, 1, 2).unbind(-1))

    def adjoint(self) -> Tensor:
        """The adjoint matrices (*, 3, 3): `g * exp(v) = exp(adjoint @ v) * g`."""
        x, y = self.t.unbind(-1)
        top = torch.cat([self.r.matrix(), torch.stack([y, -x], -1)[..., None]], -1)
        last = top.new_tensor([0, 0, 1]).expand(*top.shape[:-2], 1, 3)
        return torch.cat([top, last], -2)


# --- maps ------------------------------------------------------------------------------------------------------------


def _exp_reference(v: Tensor) -> Tensor:
    """(cos, sin, x, y) of tangent vectors (*, 3)."""
    x, y, theta = v.unbind(-1)
    a, b = sinc(theta.square()), sinc(theta.square() / 4).square() / 2 * theta  # sin x / x, (1 - cos x) / x
    return torch.stack([theta.cos(), theta.sin(), a * x - b * y, b * x + a * y], -1)


def _log_reference(motion: Tensor) -> Tensor:
    """Tangent vectors (*, 3) of (cos, sin, x, y)."""
    cosine, sine, x, y = motion.unbind(-1)
    theta = torch.atan2(sine, cosine)
    a, b = 1 - theta.square() * cotangent_rest(theta.square()), theta / 2
    return torch.stack([a * x + b * y, a * y - b * x, theta], -1)


_exp = register_formula("se2_exp", _exp_reference, lambda *args: (4,))
_log = register_formula("se2_log", _log_reference, lambda *args: (3,))
