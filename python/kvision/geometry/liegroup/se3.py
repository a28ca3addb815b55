"""Rigid motions of space, SE(3): a rotation and a translation."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import as_operands, learned
from kvision.core.exceptions import TypeCheckError
from kvision.geometry._formula import of_rows, register_formula
from kvision.geometry.conversions.series import angle_per_sine, cos, sinc, squared
from kvision.geometry.liegroup.group import (
    RigidMotion,
    check_translation,
    cosine_rest,
    shape_of,
    sine_rest,
    translation_rest,
)
from kvision.geometry.liegroup.so3 import So3, along_axis, left_jacobian_inverse_of, left_jacobian_of, skew
from kvision.geometry.quaternion import Quaternion
from kvision.geometry.vector import Vector3

__all__ = ["Se3"]


class Se3(RigidMotion[So3]):
    """Rigid motions of space: p becomes R p + t.

    A tangent vector is (translation 3, rotation 3). `a * b` applies b first. `a * points` moves points (*, 3). `a[i]` indexes the
    batch.

    Args:
        rotation: So3 or Quaternion (*), of length 1.
        translation: (*, 3), or a Vector3.

    Raises:
        TypeError: `rotation` is neither, or `translation` is not a floating-point tensor.
        ValueError: `translation` has another shape.

    Source: T. D. Barfoot, "State Estimation for Robotics" (2017), chapter 7; J. Solà et al. (2018).

    Example:
        >>> import torch, kvision as K
        >>> Se3 = K.geometry.liegroup.Se3
        >>> screw = Se3.exp(torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0, torch.pi]))
        >>> (screw * torch.tensor([1.0, 2.0, 3.0])).round().long()
        tensor([-1, -2,  4])
        >>> screw.interpolate(screw * screw, 0.5).t.detach()
        tensor([0.0000, 0.0000, 1.5000])
    """

    def __init__(self, rotation: Quaternion | So3, translation: Vector3 | Tensor) -> None:
        super().__init__()
        if not isinstance(rotation, (So3, Quaternion)):
            got = type(rotation).__name__
            raise TypeCheckError(f"Se3: expected rotation to be an So3 or a Quaternion, got {got}")
        data = translation.data if isinstance(translation, Vector3) else translation
        check_translation("Se3", data, 3)
        self._rotation = rotation if isinstance(rotation, So3) else So3(rotation)
        self._store("_translation", learned(data))

    def __mul__(self, right: Any) -> Any:
        """Compose with motions, or move points (*, 3) or a Vector3."""
        if isinstance(right, Se3):
            r, t, right_t = self.r, self.t, right.t  # once: a lookup of a module's tensor takes long
            return Se3(r * right.r, as_operands(r * right_t + t, r.q.data, t, right_t))
        if isinstance(right, Vector3):
            return Vector3(self * right.data)
        return self.r * right + self.t

    @property
    def so3(self) -> So3:
        """The rotations."""
        return self._rotation

    @property
    def quaternion(self) -> Quaternion:
        """The quaternions (*, 4) of the rotations."""
        return self._rotation.q

    @staticmethod
    def exp(v: Tensor) -> Se3:
        """The exponential map.

        Args:
            v: tangent vectors (*, 6), the translation and then the axis times the angle in radians.

        Returns:
            The motions (*).
        """
        _check.floating_trailing_shape("Se3.exp", "v", v, 6)
        motion = of_rows(_exp, v, 1)
        return Se3(Quaternion(motion[..., :4]), motion[..., 4:])

    def log(self) -> Tensor:
        """The tangent vectors (*, 6), with angles of at most pi."""
        q, t = self.quaternion.data, self.t
        shape = torch.broadcast_shapes(q.shape[:-1], t.shape[:-1])
        return of_rows(_log, torch.cat([q.expand(*shape, 4), t.expand(*shape, 3)], -1), 1)

    @staticmethod
    def hat(v: Tensor) -> Tensor:
        """The matrices (*, 4, 4) of tangent vectors (*, 6), whose matrix exponential is the motion."""
        _check.trailing_shape("Se3.hat", "v", v, 6)
        top = torch.cat([skew(v[..., 3:]), v[..., :3, None]], -1)
        return torch.cat([top, torch.zeros_like(top[..., :1, :])], -2)

    @staticmethod
    def vee(omega: Tensor) -> Tensor:
        """The tangent vectors (*, 6) of matrices (*, 4, 4), the inverse of :meth:`hat`."""
        _check.trailing_shape("Se3.vee", "omega", omega, 4, 4)
        return torch.cat([omega[..., :3, 3], So3.vee(omega[..., :3, :3])], -1)

    @classmethod
    def identity(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Se3:
        """The identity, one or (B,) of them."""
        t = torch.zeros(*shape_of(batch_size), 3, device=device, dtype=dtype)
        return cls(So3.identity(batch_size, device, dtype), t)

    def matrix(self) -> Tensor:
        """Homogeneous matrices (*, 4, 4)."""
        top = torch.cat([self.r.matrix(), self.t[..., None]], -1)
        last = top.new_tensor([0, 0, 0, 1]).expand(*top.shape[:-2], 1, 4)
        return torch.cat([top, last], -2)

    @classmethod
    def from_matrix(cls, matrix: Tensor, check_rotation: bool = False) -> Se3:
        """Motions of homogeneous matrices.

        Args:
            matrix: (*, 4, 4).
            check_rotation: refuse matrices that are not rotations, which waits for the device.

        Returns:
            The motions (*).
        """
        _check.floating_trailing_shape("Se3.from_matrix", "matrix", matrix, 4, 4)
        return cls(So3.from_matrix(matrix[..., :3, :3], check_rotation), matrix[..., :3, 3].clone())

    @classmethod
    def from_qxyz(cls, qxyz: Tensor) -> Se3:
        """Motions of quaternions and translations (*, 7), as (w, x, y, z, tx, ty, tz)."""
        _check.floating_trailing_shape("Se3.from_qxyz", "qxyz", qxyz, 7)
        return cls(Quaternion(qxyz[..., :4].clone()), qxyz[..., 4:].clone())

    def inverse(self) -> Se3:
        """The inverse motions."""
        r = self.r.inverse()
        return Se3(r, as_operands(-(r * self.t), self.quaternion.data, self.t))

    @classmethod
    def random(
        cls,
        batch_size: int | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Se3:
        """Uniformly distributed rotations with translations in [0, 1)."""
        r = So3.random(batch_size, device, dtype)
        return cls(r, torch.rand(*shape_of(batch_size), 3, device=device, dtype=dtype))

    @classmethod
    def rot_x(cls, x: Tensor) -> Se3:
        """Rotations about the x axis by angles (*) in radians."""
        return cls(So3.rot_x(x), torch.zeros(*x.shape, 3, dtype=x.dtype, device=x.device))

    @classmethod
    def rot_y(cls, y: Tensor) -> Se3:
        """Rotations about the y axis by angles (*) in radians."""
        return cls(So3.rot_y(y), torch.zeros(*y.shape, 3, dtype=y.dtype, device=y.device))

    @classmethod
    def rot_z(cls, z: Tensor) -> Se3:
        """Rotations about the z axis by angles (*) in radians."""
        return cls(So3.rot_z(z), torch.zeros(*z.shape, 3, dtype=z.dtype, device=z.device))

    @classmethod
    def trans(cls, x: Tensor, y: Tensor, z: Tensor) -> Se3:
        """Translations by x (*), y (*) and z (*)."""
        for name, value in (("x", x), ("y", y), ("z", z)):
            _check.is_tensor("Se3.trans", name, value)
            _check.floating("Se3.trans", name, value)
        t = torch.stack(torch.broadcast_tensors(x, y, z), -1)
        q = torch.cat([torch.ones_like(t[..., :1]), torch.zeros_like(t)], -1)
        return cls(Quaternion(q), t)

    @classmethod
    def trans_x(cls, x: Tensor) -> Se3:
        """Translations along x by distances (*)."""
        return cls.trans(*along_axis("Se3.trans_x", "x", x, 0).unbind(-1))

    @classmethod
    def trans_y(cls, y: Tensor) -> Se3:
        """Translations along y by distances (*)."""
        return cls.trans(*along_axis("Se3.trans_y", "y", y, 1).unbind(-1))

    @classmethod
    def trans_z(cls, z: Tensor) -> Se3:
        """Translations along z by distances (*)."""
        return cls.trans(*along_axis("Se3.trans_z", "z", z, 2).unbind(-1))

    def adjoint(self) -> Tensor:
        """The adjoint matrices (*, 6, 6): `g * exp(v) = exp(adjoint @ v) * g`."""
        R = self.r.matrix()
        return _blocks(R, skew(self.t) @ R)

    @staticmethod
    def left_jacobian(vec: Tensor) -> Tensor:
        """The left Jacobian of the exponential map: exp(v + d) is exp(J d) * exp(v) for small d.

        Args:
            vec: tangent vectors (*, 6).

        Returns:
            (*, 6, 6).
        """
        _check.trailing_shape("Se3.left_jacobian", "vec", vec, 6)
        return of_rows(_left_jacobian, floats(vec), 1)

    @staticmethod
    def left_jacobian_inverse(vec: Tensor) -> Tensor:
        """The inverse of the left Jacobian.

        Args:
            vec: tangent vectors (*, 6) with angles below 2 pi.

        Returns:
            (*, 6, 6).
        """
        _check.trailing_shape("Se3.left_jacobian_inverse", "vec", vec, 6)
        return of_rows(_left_jacobian_inverse, floats(vec), 1)

    @staticmethod
    def right_jacobian(vec: Tensor) -> Tensor:
        """The right Jacobian of the exponential map: exp(v + d) is exp(v) * exp(J d) for small d.

        Args:
            vec: tangent vectors (*, 6).

        Returns:
            (*, 6, 6), the left one of -v.
        """
        return Se3.left_jacobian(-vec)

    @staticmethod
    def right_jacobian_inverse(vec: Tensor) -> Tensor:
        """The inverse of the right Jacobian, for tangent vectors (*, 6) with angles below 2 pi."""
        return Se3.left_jacobian_inverse(-vec)


# --- maps ------------------------------------------------------------------------------------------------------------


def _exp_reference(v: Tensor) -> Tensor:
    """(w, x, y, z, tx, ty, tz) of tangent vectors (*, 6): the translation is the left Jacobian of SO(3) times that of v."""
    rho, phi = v[..., :3], v[..., 3:]
    quarter = squared(phi) / 4
    t = (left_jacobian_of(phi) @ rho[..., None])[..., 0]
    return torch.cat([cos(quarter), phi / 2 * sinc(quarter), t], -1)


def _log_reference(motion: Tensor) -> Tensor:
    """Tangent vectors (*, 6) of (w, x, y, z, tx, ty, tz)."""
    w, axis, t = motion[..., :1], motion[..., 1:4], motion[..., 4:]
    sign = torch.where(w < 0, -1, 1)  # q and -q are one rotation
    phi = 2 * sign * axis * angle_per_sine(squared(axis), sign * w)
    return torch.cat([(left_jacobian_inverse_of(phi) @ t[..., None])[..., 0], phi], -1)


def _blocks(diagonal: Tensor, upper: Tensor) -> Tensor:
    """The matrices [[D, U], [0, D]] (*, 6, 6)."""
    shape = torch.broadcast_shapes(diagonal.shape, upper.shape)
    diagonal, upper = diagonal.expand(shape), upper.expand(shape)
    return torch.cat([torch.cat([diagonal, upper], -1), torch.cat([torch.zeros_like(upper), diagonal], -1)], -2)


def _upper_block(v: Tensor) -> Tensor:
    """Q (*, 3, 3) of the left Jacobian; Barfoot, equation 7.86."""
    square = squared(v[..., 3:])[..., None]
    rho, phi = skew(v[..., :3]), skew(v[..., 3:])
    phi_rho, rho_phi = phi @ rho, rho @ phi
    phi_rho_phi = phi_rho @ phi
    return (
        rho / 2
        + sine_rest(square) * (phi_rho + rho_phi + phi_rho_phi)
        + cosine_rest(square) * (phi @ phi_rho + rho_phi @ phi - 3 * phi_rho_phi)
        + translation_rest(square) * (phi_rho_phi @ phi + phi @ phi_rho_phi)
    )


def _left_jacobian_reference(v: Tensor) -> Tensor:
    return _blocks(left_jacobian_of(v[..., 3:]), _upper_block(v))


def _left_jacobian_inverse_reference(v: Tensor) -> Tensor:
    inverse = left_jacobian_inverse_of(v[..., 3:])
    return _blocks(inverse, -inverse @ _upper_block(v) @ inverse)


_exp = register_formula("se3_exp", _exp_reference, lambda *args: (7,))
_log = register_formula("se3_log", _log_reference, lambda *args: (6,))
_left_jacobian = register_formula("se3_left_jacobian", _left_jacobian_reference, lambda *args: (6, 6))
_left_jacobian_inverse = register_formula(
    "se3_left_jacobian_inverse", _left_jacobian_inverse_reference, lambda *args: (6, 6)
)
