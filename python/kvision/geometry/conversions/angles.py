"""Angles: degrees and radians, polar coordinates, rotations of the plane."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import wants_derivative
from kvision._torch_compat import hypot
from kvision.geometry._formula import of_rows, register_formula

__all__ = ["angle_to_rotation_matrix", "cart2pol", "deg2rad", "pol2cart", "rad2deg"]


def rad2deg(tensor: Tensor) -> Tensor:
    """Convert radians to degrees.

    Args:
        tensor: angles in radians, of any shape. Integers give float32.

    Returns:
        The angles in degrees, of the shape of `tensor`.

    Raises:
        TypeError: `tensor` is not a tensor of real numbers.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.rad2deg(torch.tensor(torch.pi))
        tensor(180.)
    """
    _check.numbers("rad2deg", "tensor", tensor)
    return floats(tensor) * (180 / math.pi)


def deg2rad(tensor: Tensor) -> Tensor:
    """Convert degrees to radians.

    Args:
        tensor: angles in degrees, of any shape. Integers give float32.

    Returns:
        The angles in radians, of the shape of `tensor`.

    Raises:
        TypeError: `tensor` is not a tensor of real numbers.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.deg2rad(torch.tensor(180))
        tensor(3.1416)
    """
    _check.numbers("deg2rad", "tensor", tensor)
    return floats(tensor) * (math.pi / 180)


def pol2cart(rho: Tensor, phi: Tensor) -> tuple[Tensor, Tensor]:
    """Convert polar to Cartesian coordinates.

    Args:
        rho: distances from the origin, of any shape.
        phi: angles in radians, of a shape that broadcasts with that of `rho`.

    Returns:
        x and y, of the common shape.

    Raises:
        TypeError: `rho` or `phi` is not a tensor of real numbers.
        ValueError: the shapes do not broadcast.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.pol2cart(torch.tensor(2.0), torch.tensor(0.0))
        (tensor(2.), tensor(0.))
    """
    _check_pair("pol2cart", rho=rho, phi=phi)
    rho, phi = floats(rho), floats(phi)
    return rho * phi.cos(), rho * phi.sin()


def cart2pol(x: Tensor, y: Tensor, eps: float = 1e-8) -> tuple[Tensor, Tensor]:
    """Convert Cartesian to polar coordinates. The gradient at the origin is 0.

    Args:
        x: horizontal coordinates, of any shape.
        y: vertical coordinates, of a shape that broadcasts with that of `x`.
        eps: not used; accepted for compatibility, as the result is exact without it.

    Returns:
        Distances from the origin and angles in radians, from -pi to pi.

    Raises:
        TypeError: `x` or `y` is not a tensor of real numbers.
        ValueError: the shapes do not broadcast.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.cart2pol(torch.tensor(3.0), torch.tensor(4.0))
        (tensor(5.), tensor(0.9273))
    """
    _check_pair("cart2pol", x=x, y=y)
    x, y = floats(x), floats(y)
    if not wants_derivative(x, y):
        return hypot(x, y), torch.atan2(y, x + 0)  # not pi for -0
    rho = hypot(x, y)
    if _check.values_are_readable(rho) and rho.numel() and rho.detach().amin() > 0:
        return rho, torch.atan2(y, x + 0)
    origin = (x == 0) & (y == 0)
    x = torch.where(origin, 1, x)  # hypot and atan2 have no derivative at the origin
    return hypot(x, y).masked_fill(origin, 0), torch.atan2(y, x).masked_fill(origin, 0)


def _check_pair(op: str, **tensors: Tensor) -> None:
    for name, x in tensors.items():
        _check.numbers(op, name, x)
    _check.same_device(op, **tensors)
    _check.broadcastable(op, **{name: x.shape for name, x in tensors.items()})


def angle_to_rotation_matrix(angle: Tensor) -> Tensor:
    """Rotation matrices of the plane from angles.

    A positive angle rotates counter-clockwise in an image, whose y axis points down. Multiples of 90 degrees are exact.

    Args:
        angle: angles in degrees, of any shape (*). Integers give float32.

    Returns:
        Matrices [[cos, sin], [-sin, cos]] of shape (*, 2, 2).

    Raises:
        TypeError: `angle` is not a tensor of real numbers.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.angle_to_rotation_matrix(torch.tensor(90.0))
        tensor([[ 0.,  1.],
                [-1.,  0.]])
    """
    _check.numbers("angle_to_rotation_matrix", "angle", angle)
    return of_rows(_rotation2d, floats(angle), 0)


def _rotation2d_reference(angle: Tensor) -> Tensor:
    c, s = cos_sin(angle)
    return torch.stack([c, s, -s + 0, c], -1).unflatten(-1, (2, 2))  # no negative zeros


_rotation2d = register_formula("angle_to_rotation_matrix", _rotation2d_reference, lambda *args: (2, 2))


def cos_sin(degrees: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine, exact at multiples of 90 degrees."""
    quarters = (degrees.detach() / 90).round()
    rest = torch.deg2rad(degrees - 90 * quarters)
    c, s = rest.cos(), rest.sin()
    quadrant = quarters.remainder(4)
    cosine = torch.where(quadrant == 0, c, torch.where(quadrant == 1, -s, torch.where(quadrant == 2, -c, s)))
    sine = torch.where(quadrant == 0, s, torch.where(quadrant == 1, c, torch.where(quadrant == 2, -s, -c)))
    return cosine + 0, sine + 0  # no negative zeros
