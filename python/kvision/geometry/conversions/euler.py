"""Euler angles: rotations about the fixed axes x, y and z by roll, pitch and yaw."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, floats
from kvision._ops import Operator
from kvision.geometry._formula import register_formula

__all__ = ["euler_from_quaternion", "quaternion_from_euler"]


def quaternion_from_euler(roll: Tensor, pitch: Tensor, yaw: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Convert Euler angles about the fixed axes x, then y, then z to unit quaternions.

    Args:
        roll: angles about x, in radians, of any shape. Integers give float32.
        pitch: angles about y, in radians, of the shape of `roll`.
        yaw: angles about z, in radians, of the shape of `roll`.

    Returns:
        The components w, x, y and z, each of the shape of `roll`.

    Raises:
        TypeError: an angle is not a tensor of real numbers.
        ValueError: the shapes differ, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> zero = torch.zeros(())
        >>> K.geometry.quaternion_from_euler(zero, zero, torch.tensor(torch.pi))[3]
        tensor(1.)
    """
    _check_same("quaternion_from_euler", roll=roll, pitch=pitch, yaw=yaw)
    w, x, y, z = _columns(_from_euler, roll, pitch, yaw)
    return w, x, y, z


def _from_euler_reference(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    (cr, sr), (cp, sp), (cy, sy) = (((a / 2).cos(), (a / 2).sin()) for a in (roll, pitch, yaw))
    entries = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return torch.stack(entries, -1)


_from_euler = register_formula("quaternion_from_euler", _from_euler_reference, lambda *args: (4,))


def _columns(operator: Operator, *numbers: Tensor) -> tuple[Tensor, ...]:
    """Apply a formula of scalars to tensors (*), and return its results as tensors (*)."""
    shape, dtype = numbers[0].shape, floats(numbers[0]).dtype
    columns = operator(*(as_dtype(x if x.dim() == 1 else x.reshape(-1), dtype) for x in numbers)).unbind(1)
    return columns if len(shape) == 1 else tuple(c.reshape(shape) for c in columns)


def euler_from_quaternion(w: Tensor, x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Convert quaternions to Euler angles about the fixed axes x, then y, then z.

    At gimbal lock, where the pitch is pi / 2 or -pi / 2, only the sum or the difference of roll and yaw is determined. The roll
    is then 0, and the yaw receives the gradients.

    Args:
        w: real parts of the quaternions, of any shape. Quaternions may have any norm. Integers give float32.
        x: first imaginary parts, of the shape of `w`.
        y: second imaginary parts, of the shape of `w`.
        z: third imaginary parts, of the shape of `w`.

    Returns:
        Roll, pitch and yaw in radians, each of the shape of `w`. Roll and yaw are in [-pi, pi], the pitch is in
        [-pi / 2, pi / 2].

    Raises:
        TypeError: a component is not a tensor of real numbers.
        ValueError: the shapes differ, or the tensors are on different devices.

    Source: E. Bernardes, S. Viollet, "Quaternion to Euler angles conversion" (2022).

    Example:
        >>> import torch, kvision as K
        >>> one, zero = torch.ones(()), torch.zeros(())
        >>> K.geometry.euler_from_quaternion(one, zero, zero, one)
        (tensor(0.), tensor(0.), tensor(1.5708))
    """
    _check_same("euler_from_quaternion", w=w, x=x, y=y, z=z)
    roll, pitch, yaw = _columns(_euler, w, x, y, z)
    return roll, pitch, yaw


def _euler_reference(w: Tensor, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    # (yaw + roll) / 2 is the angle of (a, b), (yaw - roll) / 2 that of (c, d). Their norms p^0.5, m^0.5 give the pitch.
    a, b, c, d = w - y, x + z, w + y, z - x
    p, m = a * a + b * b, c * c + d * d
    threshold = (4 * torch.finfo(w.dtype).eps) ** 2 * (p + m)
    up, down = p <= threshold, m <= threshold  # gimbal lock; both for the quaternion 0
    total, difference = _angle(b, a, up), _angle(d, c, down)
    total, difference = torch.where(up & ~down, difference, total), torch.where(down, total, difference)
    locked = up | down
    lengths = (torch.where(locked, 1, m).sqrt(), torch.where(locked, 1, p).sqrt())
    pitch = 2 * torch.atan2(*lengths) - math.pi / 2
    pole = (up.to(w.dtype) - down.to(w.dtype)) * (math.pi / 2)
    angles = [_wrap_to_pi(total - difference), torch.where(locked, pole, pitch), _wrap_to_pi(total + difference)]
    return torch.stack(angles, -1)


def _wrap_to_pi(angle: Tensor) -> Tensor:
    return angle - 2 * math.pi * (angle.detach() / (2 * math.pi)).round()


def _angle(y: Tensor, x: Tensor, none: Tensor) -> Tensor:
    return torch.atan2(torch.where(none, 0, y), torch.where(none, 1, x))


_euler = register_formula("euler_from_quaternion", _euler_reference, lambda *args: (3,))


def _check_same(op: str, **tensors: Tensor) -> None:
    for name, x in tensors.items():
        _check.numbers(op, name, x)
    _check.same_shape(op, **tensors)
    _check.same_device(op, **tensors)
