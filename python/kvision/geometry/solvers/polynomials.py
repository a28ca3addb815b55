"""Products of polynomials in three unknowns, and a determinant with one unknown: the algebra of the five-point method.

Monomials of degree two have the order x^2, xy, xz, x, y^2, yz, y, z^2, z, 1; those of degree three in the order x^3,
y^3, x^2 y, x y^2, x^2 z, x^2, y^2 z, y^2, xyz, xy, x z^2, xz, x, y z^2, yz, y, z^3, z^2, z, 1.

Source: D. Nister, "An Efficient Solution to the Five-Point Relative Pose Problem" (2004).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import Operator
from kvision.geometry._formula import of_all, of_rows, register_formula

__all__ = ["determinant_to_polynomial", "multiply_deg_one_poly", "multiply_deg_two_one_poly"]

_LINEAR = ("x", "y", "z", "")
_QUADRATIC = ("xx", "xy", "xz", "x", "yy", "yz", "y", "zz", "z", "")
_CUBIC = (
    *("xxx", "yyy", "xxy", "xyy", "xxz", "xx", "yyz", "yy", "xyz", "xy"),
    *("xzz", "xz", "x", "yzz", "yz", "y", "zzz", "zz", "z", ""),
)


def _product(left: Sequence[str], right: Sequence[str], monomials: Sequence[str], a: Tensor, b: Tensor) -> Tensor:
    """The coefficients of a product along the last axis, from those of its factors."""
    p, q = a.unbind(-1), b.unbind(-1)
    terms: dict[str, list[Tensor]] = {monomial: [] for monomial in monomials}
    for x, of_left in zip(p, left):
        for y, of_right in zip(q, right):
            terms["".join(sorted(of_left + of_right))].append(x * y)
    return torch.stack([torch.stack(term).sum(0) for term in terms.values()], -1)


_product_of_linear = register_formula(
    "product_of_linear", functools.partial(_product, _LINEAR, _LINEAR, _QUADRATIC), lambda a, b: (10,)
)
_product_of_quadratic = register_formula(
    "product_of_quadratic", functools.partial(_product, _QUADRATIC, _LINEAR, _CUBIC), lambda a, b: (20,)
)


def _powers(count: int) -> list[str]:
    return ["z" * n for n in range(count)]


def _determinant_reference(A: Tensor) -> Tensor:
    first, second, third = A.split([4, 4, 5], -1)
    next_first, next_second, _ = A.roll(-1, -2).split([4, 4, 5], -1)
    cubic, quartic, minor = _powers(4)[::-1], _powers(5)[::-1], _powers(7)
    # Of rows i and i + 1 each, to be multiplied by row i + 2.
    minors = _product(cubic, cubic, minor, first, next_second) - _product(cubic, cubic, minor, next_first, second)
    return _product(minor, quartic, _powers(11), minors, third.roll(1, -2)).sum(-2)


_determinant = register_formula("determinant_to_polynomial", _determinant_reference, lambda A: (11,))


def multiply_deg_one_poly(a: Tensor, b: Tensor) -> Tensor:
    """Multiply two polynomials of degree one in x, y and z.

    Args:
        a: coefficients (*, 4) of x, y, z, 1, floating point.
        b: likewise; leading axes broadcast.

    Returns:
        (*, 10), of x^2, xy, xz, x, y^2, yz, y, z^2, z, 1.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> x_plus_1 = torch.tensor([[1.0, 0, 0, 1]])
        >>> K.geometry.multiply_deg_one_poly(x_plus_1, x_plus_1)
        tensor([[1., 0., 0., 2., 0., 0., 0., 0., 0., 1.]])
    """
    return _multiply("multiply_deg_one_poly", _product_of_linear, a, b, 4)


def multiply_deg_two_one_poly(a: Tensor, b: Tensor) -> Tensor:
    """Multiply a polynomial of degree two by one of degree one, both in x, y and z.

    Args:
        a: coefficients (*, 10) of x^2, xy, xz, x, y^2, yz, y, z^2, z, 1, floating point.
        b: coefficients (*, 4) of x, y, z, 1; leading axes broadcast.

    Returns:
        (*, 20), of x^3, y^3, x^2 y, x y^2, x^2 z, x^2, y^2 z, y^2, xyz, xy, x z^2, xz, x, y z^2, yz, y, z^3, z^2, z, 1.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> xy, z = torch.eye(10)[1:2], torch.eye(4)[2:3]
        >>> K.geometry.multiply_deg_two_one_poly(xy, z).argmax()  # xyz
        tensor(8)
    """
    return _multiply("multiply_deg_two_one_poly", _product_of_quadratic, a, b, 10)


def _multiply(op: str, product: Operator, a: Tensor, b: Tensor, size: int) -> Tensor:
    _check.floating_trailing_shape(op, "a", a, size)
    _check.floating_trailing_shape(op, "b", b, 4)
    _check.same_device(op, a=a, b=b)
    _check.leading_axes(op, 1, a=a, b=b)
    return of_all(product, 1, a, b)


def determinant_to_polynomial(A: Tensor) -> Tensor:
    """The determinant of a 3 x 3 matrix of polynomials in z.

    Args:
        A: (*, 3, 13), floating point: each row two polynomials of degree three and one of degree four, the highest
            power first.

    Returns:
        The coefficients of the determinant (*, 11), the lowest power first.

    Raises:
        TypeCheckError: `A` is not a floating-point tensor.
        ShapeError: `A` is not (*, 3, 13).

    Example:
        >>> import torch, kvision as K
        >>> A = torch.zeros(1, 3, 13)
        >>> A[0, 0, 3] = A[0, 1, 7] = A[0, 2, 11] = 1  # diag(1, 1, z)
        >>> K.geometry.determinant_to_polynomial(A)
        tensor([[0., 1., 0., 0., 0., 0., 0., 0., 0., 0., 0.]])
    """
    _check.floating_trailing_shape("determinant_to_polynomial", "A", A, 3, 13)
    return of_rows(_determinant, A, 2)
