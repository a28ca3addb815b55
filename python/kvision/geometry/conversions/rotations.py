"""Rotations of space as axis and angle, quaternions (w, x, y, z) and matrices.

All gradients are finite, also at the identity and at rotations by pi. Quotients that are 0 / 0 there are replaced by a series, or
masked by `where` both before and after the division, so that no infinite derivative is multiplied by 0.
"""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision.geometry._formula import of_rows, register_formula
from kvision.geometry.conversions.poses import check_is_rotation
from kvision.geometry.conversions.series import angle_per_sine, cos, sinc, squared

__all__ = [
    "angle_axis_to_quaternion",
    "angle_axis_to_rotation_matrix",
    "axis_angle_to_quaternion",
    "axis_angle_to_rotation_matrix",
    "normalize_quaternion",
    "quaternion_exp_to_log",
    "quaternion_log_to_exp",
    "quaternion_to_angle_axis",
    "quaternion_to_axis_angle",
    "quaternion_to_rotation_matrix",
    "rotation_matrix_to_angle_axis",
    "rotation_matrix_to_axis_angle",
    "rotation_matrix_to_quaternion",
    "vector_to_skew_symmetric_matrix",
]

# --- axis and angle -------------------------------------------------------------------------------------------------


def axis_angle_to_rotation_matrix(axis_angle: Tensor) -> Tensor:
    """Convert axis-angle vectors to rotation matrices, by Rodrigues' formula.

    Args:
        axis_angle: rotation axes scaled by the angle in radians, of shape (*, 3). Integers give float32.

    Returns:
        Matrices of shape (*, 3, 3).

    Raises:
        TypeError: `axis_angle` is not a tensor of real numbers.
        ValueError: `axis_angle` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.axis_angle_to_rotation_matrix(torch.tensor([0.0, 0.0, torch.pi / 2])).round().long()[0]
        tensor([ 0, -1,  0])
    """
    _check.trailing_shape("axis_angle_to_rotation_matrix", "axis_angle", axis_angle, 3)
    return of_rows(_rodrigues, floats(axis_angle), 1)


def _rodrigues_reference(v: Tensor) -> Tensor:
    square = squared(v)
    versine = sinc(square / 4).square() / 2  # (1 - cos) / angle^2
    xx, yy, zz = (v * v * versine).unbind(-1)
    xy, yz, zx = (v * v.roll(-1, -1) * versine).unbind(-1)
    ax, ay, az = (v * sinc(square)).unbind(-1)
    entries = [1 - yy - zz, xy - az, zx + ay, xy + az, 1 - zz - xx, yz - ax, zx - ay, yz + ax, 1 - xx - yy]
    return torch.stack(entries, -1).unflatten(-1, (3, 3))


_rodrigues = register_formula("axis_angle_to_rotation_matrix", _rodrigues_reference, lambda *args: (3, 3))


def axis_angle_to_quaternion(axis_angle: Tensor) -> Tensor:
    """Convert axis-angle vectors to unit quaternions.

    Args:
        axis_angle: rotation axes scaled by the angle in radians, of shape (*, 3). Integers give float32.

    Returns:
        Quaternions (w, x, y, z) of shape (*, 4), with w = cos(angle / 2), of either sign.

    Raises:
        TypeError: `axis_angle` is not a tensor of real numbers.
        ValueError: `axis_angle` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.axis_angle_to_quaternion(torch.tensor([0.0, 0.0, torch.pi / 2]))
        tensor([0.7071, 0.0000, 0.0000, 0.7071])
    """
    _check.trailing_shape("axis_angle_to_quaternion", "axis_angle", axis_angle, 3)
    return of_rows(_exponential, floats(axis_angle), 1, 0.5)


def _exponential_reference(v: Tensor, factor: float) -> Tensor:
    """The quaternion of a rotation about `v` by twice `factor` times the norm of `v`."""
    v = v * factor
    square = squared(v)
    return torch.cat([cos(square), v * sinc(square)], -1)


_exponential = register_formula("quaternion_exponential", _exponential_reference, lambda *args: (4,))


def quaternion_to_axis_angle(quaternion: Tensor) -> Tensor:
    """Convert quaternions to axis-angle vectors.

    Args:
        quaternion: quaternions (w, x, y, z) of shape (*, 4), of any norm. Integers give float32.

    Returns:
        Axis-angle vectors of shape (*, 3), whose norm is in [0, pi]. The quaternion 0 gives 0.

    Raises:
        TypeError: `quaternion` is not a tensor of real numbers.
        ValueError: `quaternion` is not of shape (*, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.quaternion_to_axis_angle(torch.tensor([1.0, 0.0, 0.0, 1.0]))
        tensor([0.0000, 0.0000, 1.5708])
    """
    _check.trailing_shape("quaternion_to_axis_angle", "quaternion", quaternion, 4)
    return of_rows(_axis_angle, floats(quaternion), 1)


def _axis_angle_reference(q: Tensor) -> Tensor:
    w, v = q[..., :1], q[..., 1:]
    sign = torch.where(w < 0, -1, 1)  # q and -q are the same rotation
    return 2 * sign * v * angle_per_sine(squared(v), sign * w)


_axis_angle = register_formula("quaternion_to_axis_angle", _axis_angle_reference, lambda *args: (3,))


# --- matrices -------------------------------------------------------------------------------------------------------


def quaternion_to_rotation_matrix(quaternion: Tensor) -> Tensor:
    """Convert quaternions to rotation matrices.

    Args:
        quaternion: quaternions (w, x, y, z) of shape (*, 4), of any norm. Integers give float32.

    Returns:
        Matrices of shape (*, 3, 3). The quaternion 0 gives the identity.

    Raises:
        TypeError: `quaternion` is not a tensor of real numbers.
        ValueError: `quaternion` is not of shape (*, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.quaternion_to_rotation_matrix(torch.tensor([1.0, 0.0, 0.0, 1.0]))[0]
        tensor([ 0., -1.,  0.])
    """
    _check.trailing_shape("quaternion_to_rotation_matrix", "quaternion", quaternion, 4)
    return of_rows(_matrix, floats(quaternion), 1)


def _matrix_reference(q: Tensor) -> Tensor:
    square = squared(q)
    none = square < torch.finfo(q.dtype).tiny
    twice = torch.where(none, 0, 2 / torch.where(none, 1, square))
    x, y, z = q[..., 1:].unbind(-1)
    sw, sx, sy, sz = (q * twice).unbind(-1)
    wx, wy, wz, xx, xy, xz = sw * x, sw * y, sw * z, sx * x, sx * y, sx * z
    yy, yz, zz = sy * y, sy * z, sz * z
    entries = [1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy]
    return torch.stack(entries, -1).unflatten(-1, (3, 3))


_matrix = register_formula("quaternion_to_rotation_matrix", _matrix_reference, lambda *args: (3, 3))


def rotation_matrix_to_quaternion(rotation_matrix: Tensor, eps: float = 1e-8, check_rotation: bool = False) -> Tensor:
    """Convert rotation matrices to unit quaternions. The largest component is computed first.

    Args:
        rotation_matrix: rotation matrices of shape (*, 3, 3). Integers give float32.
        eps: not used; accepted for compatibility.
        check_rotation: raise an error for matrices that are not rotations. This waits for the device.

    Returns:
        Quaternions (w, x, y, z) of shape (*, 4). Up to an angle of 2 pi / 3, w is not negative. For larger angles the largest of
        x, y and z is not negative.

    Raises:
        TypeError: `rotation_matrix` is not a tensor of real numbers.
        ValueError: `rotation_matrix` is not of shape (*, 3, 3), or with `check_rotation` a matrix is not a rotation.

    Source: S. W. Shepperd, "Quaternion from rotation matrix" (1978).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.rotation_matrix_to_quaternion(torch.eye(3))
        tensor([1., 0., 0., 0.])
    """
    return of_rows(_quaternion, _rotations("rotation_matrix_to_quaternion", rotation_matrix, check_rotation), 2)


def _rotations(op: str, matrix: Tensor, check_rotation: bool) -> Tensor:
    _check.trailing_shape(op, "rotation_matrix", matrix, 3, 3)
    _check.flag(op, "check_rotation", check_rotation)
    if check_rotation:
        check_is_rotation(op, "rotation_matrix", matrix)
    return floats(matrix)


def _quaternion_reference(R: Tensor) -> Tensor:
    # Each row is the quaternion times 4 of its components: w, x, y, z.
    a, b, c, d, e, f, g, h, i = R.flatten(-2).unbind(-1)
    rows = torch.stack(
        [
            *(1 + a + e + i, h - f, c - g, d - b),
            *(h - f, 1 + a - e - i, b + d, c + g),
            *(c - g, b + d, 1 - a + e - i, f + h),
            *(d - b, c + g, f + h, 1 - a - e + i),
        ],
        -1,
    ).unflatten(-1, (4, 4))
    largest = torch.stack([a, e, i], -1).argmax(-1) + 1
    which = torch.where(a + e + i > 0, 0, largest)
    row = rows.gather(-2, which[..., None, None].expand(*which.shape, 1, 4)).squeeze(-2)
    square = row.gather(-1, which[..., None])  # at least 1
    return row / (2 * square.sqrt())


_quaternion = register_formula("rotation_matrix_to_quaternion", _quaternion_reference, lambda *args: (4,))


def rotation_matrix_to_axis_angle(rotation_matrix: Tensor, check_rotation: bool = False) -> Tensor:
    """Convert rotation matrices to axis-angle vectors.

    Args:
        rotation_matrix: rotation matrices of shape (*, 3, 3). Integers give float32.
        check_rotation: raise an error for matrices that are not rotations. This waits for the device.

    Returns:
        Axis-angle vectors of shape (*, 3), whose norm in radians is in [0, pi].

    Raises:
        TypeError: `rotation_matrix` is not a tensor of real numbers.
        ValueError: `rotation_matrix` is not of shape (*, 3, 3), or with `check_rotation` a matrix is not a rotation.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.rotation_matrix_to_axis_angle(torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
        tensor([0.0000, 0.0000, 1.5708])
    """
    matrix = _rotations("rotation_matrix_to_axis_angle", rotation_matrix, check_rotation)
    return of_rows(_axis_angle_of_matrix, matrix, 2)


_axis_angle_of_matrix = register_formula(
    "rotation_matrix_to_axis_angle",
    lambda R: _axis_angle_reference(_quaternion_reference(R)),
    lambda *args: (3,),
)


def vector_to_skew_symmetric_matrix(vec: Tensor) -> Tensor:
    """Convert vectors to their cross product matrices: [v] x = v cross x.

    Args:
        vec: vectors of shape (*, 3).

    Returns:
        Matrices of shape (*, 3, 3).

    Raises:
        TypeError: `vec` is not a tensor of real numbers.
        ValueError: `vec` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.vector_to_skew_symmetric_matrix(torch.tensor([1.0, 2.0, 3.0]))
        tensor([[ 0., -3.,  2.],
                [ 3.,  0., -1.],
                [-2.,  1.,  0.]])
    """
    _check.trailing_shape("vector_to_skew_symmetric_matrix", "vec", vec, 3)
    _check.subtractable("vector_to_skew_symmetric_matrix", vec=vec)
    return of_rows(cross_matrix, vec, 1)


def _cross_matrix_reference(vec: Tensor) -> Tensor:
    x, y, z = vec.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).unflatten(-1, (3, 3))


cross_matrix = register_formula("cross_matrix", _cross_matrix_reference, lambda *args: (3, 3))


# --- quaternions ----------------------------------------------------------------------------------------------------


def normalize_quaternion(quaternion: Tensor, eps: float = 1e-12) -> Tensor:
    """Divide quaternions by their norm, or by `eps` where the norm is smaller.

    Args:
        quaternion: quaternions (w, x, y, z) of shape (*, 4). Integers give float32.
        eps: lower bound of the divisor.

    Returns:
        Quaternions of shape (*, 4).

    Raises:
        TypeError: `quaternion` is not a tensor of real numbers, or `eps` is not a number.
        ValueError: `quaternion` is not of shape (*, 4), or `eps` is negative.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.normalize_quaternion(torch.tensor([3.0, 0.0, 4.0, 0.0]))
        tensor([0.6000, 0.0000, 0.8000, 0.0000])
    """
    _check.trailing_shape("normalize_quaternion", "quaternion", quaternion, 4)
    return of_rows(_unit, floats(quaternion), 1, _check.number("normalize_quaternion", "eps", eps, 0))


def _unit_reference(q: Tensor, eps: float) -> Tensor:
    square = squared(q)
    short = square <= eps * eps
    return q / torch.where(short, eps, torch.where(short, 1, square).sqrt())


_unit = register_formula("normalize_quaternion", _unit_reference, lambda *args: (4,))


def quaternion_log_to_exp(quaternion: Tensor, eps: float = 1e-8) -> Tensor:
    """The exponential map: convert logarithms of unit quaternions to unit quaternions.

    Args:
        quaternion: rotation axes scaled by half the angle in radians, of shape (*, 3). Integers give float32.
        eps: not used; accepted for compatibility.

    Returns:
        Quaternions (w, x, y, z) of shape (*, 4).

    Raises:
        TypeError: `quaternion` is not a tensor of real numbers.
        ValueError: `quaternion` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.quaternion_log_to_exp(torch.tensor([0.0, 0.0, torch.pi / 4]))
        tensor([0.7071, 0.0000, 0.0000, 0.7071])
    """
    _check.trailing_shape("quaternion_log_to_exp", "quaternion", quaternion, 3)
    return of_rows(_exponential, floats(quaternion), 1, 1.0)


def quaternion_exp_to_log(quaternion: Tensor, eps: float = 1e-8) -> Tensor:
    """The logarithm of quaternions.

    Args:
        quaternion: quaternions (w, x, y, z) of shape (*, 4), of any norm. Integers give float32.
        eps: not used; accepted for compatibility.

    Returns:
        Rotation axes scaled by half the angle in radians, of shape (*, 3). Their norm is in [0, pi], and above pi / 2 for a
        negative w. (w, 0, 0, 0) of either sign gives 0.

    Raises:
        TypeError: `quaternion` is not a tensor of real numbers.
        ValueError: `quaternion` is not of shape (*, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.quaternion_exp_to_log(torch.tensor([0.0, 0.0, 0.0, 1.0]))
        tensor([0.0000, 0.0000, 1.5708])
    """
    _check.trailing_shape("quaternion_exp_to_log", "quaternion", quaternion, 4)
    return of_rows(_logarithm, floats(quaternion), 1)


def _logarithm_reference(q: Tensor) -> Tensor:
    w, v = q[..., :1], q[..., 1:]
    return v * angle_per_sine(squared(v), w)


_logarithm = register_formula("quaternion_logarithm", _logarithm_reference, lambda *args: (3,))


# Aliases with the names of Kornia 0.4.
angle_axis_to_quaternion = axis_angle_to_quaternion
angle_axis_to_rotation_matrix = axis_angle_to_rotation_matrix
quaternion_to_angle_axis = quaternion_to_axis_angle
rotation_matrix_to_angle_axis = rotation_matrix_to_axis_angle
