"""Similarities of space, Sim(3): a rotation, a translation and a scale.

The translation of the exponential map is an integral over the path exp(u v), u from 0 to 1, and so is its left Jacobian. Both are
computed by Gauss-Legendre quadrature: one smooth formula with derivatives of any order everywhere, where closed forms in the
angle and the log scale cancel near 0. Twenty nodes are exact to the rounding of float64 for tangent vectors of length 20.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import as_operands, learned
from kvision.core.exceptions import TypeCheckError
from kvision.geometry.conversions.series import sinc, squared
from kvision.geometry.liegroup.group import RigidMotion, check_translation, shape_of
from kvision.geometry.liegroup.se3 import Se3
from kvision.geometry.liegroup.so3 import So3, along_axis, left_jacobian_inverse_of, skew
from kvision.geometry.quaternion import Quaternion
from kvision.geometry.vector import Vector3

__all__ = ["Sim3"]

_NODES, _WEIGHTS = ((x / 2).tolist() for x in np.polynomial.legendre.leggauss(20))
_NODES = [0.5 + x for x in _NODES]


class Sim3(RigidMotion[So3]):
    """Similarities of space: p becomes s R p + t.

    A tangent vector is (translation 3, rotation 3, log scale). `a * b` applies b first. `a * points` moves points (*, 3). `a[i]`
    indexes the batch.

    Args:
        rotation: So3 or Quaternion (*), of length 1.
        translation: (*, 3), or a Vector3.
        scale: (*), above 0; None for 1.

    Raises:
        TypeError: `rotation` is neither, or `translation` or `scale` is not a floating-point tensor.
        ValueError: `translation` has another shape.

    Source: E. Eade, "Lie groups for 2D and 3D transformations" (2017), section 6.

    Example:
        >>> import torch, kvision as K
        >>> Sim3 = K.geometry.liegroup.Sim3
        >>> twice = Sim3.exp(torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, torch.pi, 0.6931472]))
        >>> (twice * torch.tensor([1.0, 2.0, 3.0])).round().long()
        tensor([-2, -4,  6])
        >>> round((twice * twice).scale.item(), 4)
        4.0
    """

    def __init__(self, rotation: Quaternion | So3, translation: Vector3 | Tensor, scale: Tensor | None = None) -> None:
        super().__init__()
        if not isinstance(rotation, (So3, Quaternion)):
            got = type(rotation).__name__
            raise TypeCheckError(f"Sim3: expected rotation to be an So3 or a Quaternion, got {got}")
        data = translation.data if isinstance(translation, Vector3) else translation
        check_translation("Sim3", data, 3)
        if scale is None:
            scale = torch.ones_like(data[..., 0])
        _check.floating_trailing_shape("Sim3", "scale", scale)
        self._rotation = rotation if isinstance(rotation, So3) else So3(rotation)
        self._store("_translation", learned(data))
        self._store("_scale", learned(scale))

    def __repr__(self) -> str:
        return f"{super().__repr__()}\nscale: {self.scale}"

    def __getitem__(self, idx: Any) -> Sim3:
        return Sim3(self.r[idx], as_operands(self.t[idx], self.t), as_operands(self.scale[idx], self.scale))

    def __mul__(self, right: Any) -> Any:
        """Compose with similarities, or move points (*, 3) or a Vector3."""
        if isinstance(right, Sim3):
            r, t, s, right_t, right_s = self.r, self.t, self.scale, right.t, right.scale
            moved = as_operands(s[..., None] * (r * right_t) + t, r.q.data, t, s, right_t)
            return Sim3(r * right.r, moved, as_operands(s * right_s, s, right_s))
        if isinstance(right, Vector3):
            return Vector3(self * right.data)
        return self.scale[..., None] * (self.r * right) + self.t

    @property
    def so3(self) -> So3:
        """The rotations."""
        return self._rotation

    @property
    def quaternion(self) -> Quaternion:
        """The quaternions (*, 4) of the rotations."""
        return self._rotation.q

    @property
    def scale(self) -> Tensor:
        """The scales (*)."""
        return self._scale  # type: ignore[return-value]  # a tensor by construction

    @staticmethod
    def exp(v: Tensor) -> Sim3:
        """The exponential map.

        Args:
            v: tangent vectors (*, 7): the translation, the axis times the angle in radians, and the logarithm of the scale.

        Returns:
            The similarities (*).
        """
        _check.floating_trailing_shape("Sim3.exp", "v", v, 7)
        rho, phi, sigma = v[..., :3], v[..., 3:6], v[..., 6]
        a, b, c = _integrals(phi, sigma)
        turned = torch.linalg.cross(phi, rho)
        t = a * rho + b * turned + c * torch.linalg.cross(phi, turned)
        return Sim3(So3.exp(phi), t, sigma.exp())

    def log(self) -> Tensor:
        """The tangent vectors (*, 7), with angles of at most pi."""
        phi, sigma, t = self.r.log(), self.scale.log(), self.t
        a, b, c = _integrals(phi, sigma)
        # On the plane across the axis W = a + b V + c V^2 is the complex number real + i b x, of an angle x with V = i x.
        square = squared(phi)
        real = a - square * c
        norm = real.square() + square * b.square()
        turned = torch.linalg.cross(phi.expand_as(t), t)
        rho = t / a - b / norm * turned + (b.square() - c * real) / (a * norm) * torch.linalg.cross(phi, turned)
        return torch.cat([rho, phi.expand_as(rho), sigma[..., None].expand_as(rho[..., :1])], -1)

    @staticmethod
    def hat(v: Tensor) -> Tensor:
        """The matrices (*, 4, 4) of tangent vectors (*, 7), whose matrix exponential is the similarity."""
        _check.trailing_shape("Sim3.hat", "v", v, 7)
        top = torch.cat([skew(v[..., 3:6]) + _times_identity(v[..., 6]), v[..., :3, None]], -1)
        return torch.cat([top, torch.zeros_like(top[..., :1, :])], -2)

    @staticmethod
    def vee(omega: Tensor) -> Tensor:
        """The tangent vectors (*, 7) of matrices (*, 4, 4), the inverse of :meth:`hat`."""
        _check.trailing_shape("Sim3.vee", "omega", omega, 4, 4)
        return torch.cat([omega[..., :3, 3], So3.vee(omega[..., :3, :3]), omega[..., 0, :1]], -1)

    @classmethod
    def identity(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Sim3:
        """The identity, one or (B,) of them."""
        t = torch.zeros(*shape_of(batch_size), 3, device=device, dtype=dtype)
        return cls(So3.identity(batch_size, device, dtype), t)

    def matrix(self) -> Tensor:
        """Homogeneous matrices (*, 4, 4)."""
        top = torch.cat([self.scale[..., None, None] * self.r.matrix(), self.t[..., None]], -1)
        last = top.new_tensor([0, 0, 0, 1]).expand(*top.shape[:-2], 1, 4)
        return torch.cat([top, last], -2)

    @classmethod
    def from_matrix(cls, matrix: Tensor, check_rotation: bool = False) -> Sim3:
        """Similarities of homogeneous matrices.

        Args:
            matrix: (*, 4, 4), with a positive determinant.
            check_rotation: refuse matrices that are not a rotation times a scale, which waits for the device.

        Returns:
            The similarities (*).
        """
        _check.floating_trailing_shape("Sim3.from_matrix", "matrix", matrix, 4, 4)
        linear = matrix[..., :3, :3]
        scale = (linear[..., 0] * torch.linalg.cross(linear[..., 1], linear[..., 2])).sum(-1) ** (1 / 3)
        rotation = So3.from_matrix(linear / scale[..., None, None], check_rotation)
        return cls(rotation, matrix[..., :3, 3].clone(), scale)

    @classmethod
    def from_qxyz(cls, qxyz: Tensor, scale: Tensor | None = None) -> Sim3:
        """Similarities of quaternions and translations (*, 7), as (w, x, y, z, tx, ty, tz), and scales (*), 1 for None."""
        _check.floating_trailing_shape("Sim3.from_qxyz", "qxyz", qxyz, 7)
        scale = None if scale is None else scale.clone()
        return cls(Quaternion(qxyz[..., :4].clone()), qxyz[..., 4:].clone(), scale)

    @classmethod
    def from_se3(cls, motion: Se3, scale: Tensor | None = None) -> Sim3:
        """Similarities of rigid motions (*) and scales (*), 1 for None."""
        if not isinstance(motion, Se3):
            raise TypeCheckError(f"Sim3.from_se3: expected motion to be an Se3, got {type(motion).__name__}")
        return cls(motion.r, motion.t, scale)

    def inverse(self) -> Sim3:
        """The inverse similarities."""
        r, scale = self.r.inverse(), 1 / self.scale
        t = -(r * self.t) * scale[..., None]
        return Sim3(r, as_operands(t, self.quaternion.data, self.t, self.scale), as_operands(scale, self.scale))

    @classmethod
    def random(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Sim3:
        """Uniformly distributed rotations with translations in [0, 1) and scales in [0.5, 1.5)."""
        r, shape = So3.random(batch_size, device, dtype), shape_of(batch_size)
        t = torch.rand(*shape, 3, device=device, dtype=dtype)
        return cls(r, t, 0.5 + torch.rand(shape, device=device, dtype=dtype))

    @classmethod
    def rot_x(cls, x: Tensor) -> Sim3:
        """Rotations about the x axis by angles (*) in radians."""
        return cls.from_se3(Se3.rot_x(x))

    @classmethod
    def rot_y(cls, y: Tensor) -> Sim3:
        """Rotations about the y axis by angles (*) in radians."""
        return cls.from_se3(Se3.rot_y(y))

    @classmethod
    def rot_z(cls, z: Tensor) -> Sim3:
        """Rotations about the z axis by angles (*) in radians."""
        return cls.from_se3(Se3.rot_z(z))

    @classmethod
    def trans(cls, x: Tensor, y: Tensor, z: Tensor) -> Sim3:
        """Translations by x (*), y (*) and z (*)."""
        return cls.from_se3(Se3.trans(x, y, z))

    @classmethod
    def trans_x(cls, x: Tensor) -> Sim3:
        """Translations along x by distances (*)."""
        return cls.trans(*along_axis("Sim3.trans_x", "x", x, 0).unbind(-1))

    @classmethod
    def trans_y(cls, y: Tensor) -> Sim3:
        """Translations along y by distances (*)."""
        return cls.trans(*along_axis("Sim3.trans_y", "y", y, 1).unbind(-1))

    @classmethod
    def trans_z(cls, z: Tensor) -> Sim3:
        """Translations along z by distances (*)."""
        return cls.trans(*along_axis("Sim3.trans_z", "z", z, 2).unbind(-1))

    def adjoint(self) -> Tensor:
        """The adjoint matrices (*, 7, 7): `g * exp(v) = exp(adjoint @ v) * g`."""
        R, t = self.r.matrix(), self.t
        return _blocks(self.scale[..., None, None] * R, skew(t) @ R, -t, R)

    @staticmethod
    def left_jacobian(vec: Tensor) -> Tensor:
        """The left Jacobian of the exponential map: exp(v + d) is exp(J d) * exp(v) for small d.

        Args:
            vec: tangent vectors (*, 7).

        Returns:
            (*, 7, 7).
        """
        _check.trailing_shape("Sim3.left_jacobian", "vec", vec, 7)
        vec = floats(vec)
        nodes, weights = vec.new_tensor(_NODES), vec.new_tensor(_WEIGHTS)
        adjoints = Sim3.exp(vec[..., None, :] * nodes[:, None]).adjoint()  # of the path from the identity
        return (adjoints * weights[:, None, None]).sum(-3)

    @staticmethod
    def left_jacobian_inverse(vec: Tensor) -> Tensor:
        """The inverse of the left Jacobian.

        Args:
            vec: tangent vectors (*, 7) with angles below 2 pi.

        Returns:
            (*, 7, 7).
        """
        J = Sim3.left_jacobian(vec)
        first = torch.linalg.inv_ex(J[..., :3, :3]).inverse
        rotation = left_jacobian_inverse_of(floats(vec)[..., 3:6])
        last = -(first @ J[..., :3, 6:])[..., 0]
        return _blocks(first, -first @ J[..., :3, 3:6] @ rotation, last, rotation)

    @staticmethod
    def right_jacobian(vec: Tensor) -> Tensor:
        """The right Jacobian of the exponential map: exp(v + d) is exp(v) * exp(J d) for small d.

        Args:
            vec: tangent vectors (*, 7).

        Returns:
            (*, 7, 7), the left one of -v.
        """
        return Sim3.left_jacobian(-vec)

    @staticmethod
    def right_jacobian_inverse(vec: Tensor) -> Tensor:
        """The inverse of the right Jacobian, for tangent vectors (*, 7) with angles below 2 pi."""
        return Sim3.left_jacobian_inverse(-vec)


def _integrals(phi: Tensor, sigma: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """a, b, c (*, 1) of W = a I + b V + c V^2, the integral of exp(u (sigma + V)) for u from 0 to 1, with V = skew(phi)."""
    u, weights = sigma.new_tensor(_NODES), sigma.new_tensor(_WEIGHTS)
    grown = weights * (sigma[..., None] * u).exp()
    square = squared(phi) * u.square()
    b = grown * u * sinc(square)
    c = grown * u.square() * sinc(square / 4).square() / 2
    return grown.sum(-1, keepdim=True), b.sum(-1, keepdim=True), c.sum(-1, keepdim=True)


def _times_identity(x: Tensor) -> Tensor:
    return x[..., None, None] * torch.eye(3, dtype=x.dtype, device=x.device)


def _blocks(A: Tensor, B: Tensor, c: Tensor, D: Tensor) -> Tensor:
    """The matrices [[A, B, c], [0, D, 0], [0, 0, 1]] (*, 7, 7)."""
    shape = torch.broadcast_shapes(A.shape[:-2], B.shape[:-2], c.shape[:-1], D.shape[:-2])
    A, B, D = (x.expand(*shape, 3, 3) for x in (A, B, D))
    top = torch.cat([A, B, c.expand(*shape, 3)[..., None]], -1)
    middle = torch.cat([torch.zeros_like(D), D, torch.zeros_like(D[..., :1])], -1)
    last = torch.zeros_like(top[..., :1, :])
    return torch.cat([top, middle, torch.cat([last[..., :6], torch.ones_like(last[..., 6:])], -1)], -2)
