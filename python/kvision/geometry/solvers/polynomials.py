"""Products of polynomials in three unknowns, and a determinant with one unknown: the algebra of the five-point method.

Monomials of degree two have the order x^2, xy, xz, x, y^2, yz, y, z^2, z, 1; those of degree three in the order x^3,
y^3, x^2 y, x y^2, x^2 z, x^2, y^2 z, y^2, xyz, xy, x z^2, xz, x, y z^2, yz, y, z^3, z^2, z, 1.

Source: D. Nister, "An Efficient Solution to the Five-Point Relative Pose Problem" (2004).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision.geometry._precision import in_full_precision

__all__ = ["determinant_to_polynomial", "multiply_deg_one_poly", "multiply_deg_two_one_poly"]

_NUMPY_TYPES = {torch.float32: np.float32, torch.float64: np.float64}
_LINEAR = ("x", "y", "z", "")
_QUADRATIC = ("xx", "xy", "xz", "x", "yy", "yz", "y", "zz", "z", "")
_CUBIC = (
    *("xxx", "yyy", "xxy", "xyy", "xxz", "xx", "yyz", "yy", "xyz", "xy"),
    *("xzz", "xz", "x", "yzz", "yz", "y", "zzz", "zz", "z", ""),
)


class Terms:
    """The pairs of factors' coefficients that contribute to each monomial of a product, as lists and as matrices.

    Two matrices repeat the coefficients of the factors, so that each pair is one product of their elements, and the third
    adds these up: three products of matrices take less time than an outer product, which has more axes.
    """

    def __init__(self, left: Sequence[str], right: Sequence[str], product: Sequence[str]) -> None:
        factors = [(i, k, "".join(sorted(a + b))) for i, a in enumerate(left) for k, b in enumerate(right)]
        self.sizes = len(left), len(right)
        self.pairs = [[(i, k) for i, k, term in factors if term == monomial] for monomial in product]
        of_left = np.array([[i == row for i, _, _ in factors] for row in range(len(left))])
        of_right = np.array([[k == row for _, k, _ in factors] for row in range(len(right))])
        sums = np.array([[term == monomial for monomial in product] for _, _, term in factors])
        self.matrices = {t: [m.astype(n) for m in (of_left, of_right, sums)] for t, n in _NUMPY_TYPES.items()}
        self._kept: dict[torch.dtype, list[Tensor]] = {}

    def tensors(self, x: Tensor) -> list[Tensor]:
        """The matrices in the type of `x`; they are kept, unless `x` belongs to a tracer."""
        if type(x) is not Tensor:
            return [torch.from_numpy(m) for m in self.matrices[x.dtype]]
        if x.dtype not in self._kept:
            with torch.inference_mode(False):
                self._kept[x.dtype] = [torch.from_numpy(m) for m in self.matrices[x.dtype]]
        return self._kept[x.dtype]

    def takes(self, a: Tensor, b: Tensor) -> bool:
        """Whether `a` and `b` are rows of coefficients that need no conversion: the usual case, which pays for few checks."""
        return (
            type(a) is type(b) is Tensor
            and (a.dtype is b.dtype and a.dtype in _NUMPY_TYPES)
            and (a.is_cpu and b.is_cpu and a.layout is b.layout is torch.strided)
            and (a.dim() == b.dim() == 2 and (a.shape[1], b.shape[1]) == self.sizes)
            and not (torch.is_autocast_enabled("cpu") or is_compiling())
        )


def _powers(count: int) -> list[str]:
    return ["z" * n for n in range(count)]


_TO_QUADRATIC = Terms(_LINEAR, _LINEAR, _QUADRATIC)
_TO_CUBIC = Terms(_QUADRATIC, _LINEAR, _CUBIC)


class _Determinant:
    """The determinant as sums of products u v w of entries (3, 13), of its first, second and third columns.

    Of each row, u and v are the pairs of the minor of the other two rows. `to_minors` adds them up to coefficients of
    minors, each as often as there are coefficients w to multiply it by, and `to_powers` adds up these products.
    """

    def __init__(self) -> None:
        u: list[int] = []
        v: list[int] = []
        w: list[int] = []
        to_minors, to_powers = np.zeros((96, 105)), np.zeros((105, 11))
        for row in range(3):
            one, two = (row + 1) % 3, (row + 2) % 3
            products = [(7 * row + power, k) for power in range(7) for k in range(5)]
            for first, second, sign in ((one, two, 1), (two, one, -1)):
                for i, j in np.ndindex(4, 4):
                    minor = 7 * row + 6 - i - j
                    to_minors[len(u), 5 * minor : 5 * minor + 5] = sign
                    u.append(13 * first + i)
                    v.append(13 * second + 4 + j)
            for minor, k in products:
                to_powers[5 * minor + k, minor % 7 + 4 - k] = 1
                w.append(13 * row + 8 + k)
        self.sizes = len(u), len(v), len(w)
        self.entries = np.array([*u, *v, *w])
        self.matrices = {t: (to_minors.astype(n), to_powers.astype(n)) for t, n in _NUMPY_TYPES.items()}

    def of(self, A: Tensor) -> Tensor:
        to_minors, to_powers = map(torch.from_numpy, self.matrices[A.dtype])
        entries = A.flatten(-2).index_select(-1, torch.from_numpy(self.entries))
        u, v, w = entries.split(self.sizes, -1)
        return ((u * v) @ to_minors * w) @ to_powers


_DETERMINANT = _Determinant()
_TO_SIXTH_POWER = Terms(_powers(4)[::-1], _powers(4)[::-1], _powers(7))
_TO_TENTH_POWER = Terms(_powers(7), _powers(5)[::-1], _powers(11))


def product(a: Tensor, b: Tensor, terms: Terms) -> Tensor:
    """The coefficients of a product, from those of its factors along the last axes."""
    if a.is_cpu and not is_compiling():
        of_left, of_right, sums = terms.tensors(a)
        return (a @ of_left * (b @ of_right)) @ sums
    p, q = a.unbind(-1), b.unbind(-1)  # elsewhere matrices would be copied from the host, and products rounded to TF32
    return torch.stack([torch.stack([p[i] * q[k] for i, k in pairs]).sum(0) for pairs in terms.pairs], -1)


_precise_product = in_full_precision(product)


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
    return _multiply("multiply_deg_one_poly", a, b, _TO_QUADRATIC)


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
    return _multiply("multiply_deg_two_one_poly", a, b, _TO_CUBIC)


def _multiply(op: str, a: Tensor, b: Tensor, terms: Terms) -> Tensor:
    if terms.takes(a, b):
        of_left, of_right, sums = terms.tensors(a)
        return torch.mm(torch.mm(a, of_left) * torch.mm(b, of_right), sums)
    _check.floating_trailing_shape(op, "a", a, terms.sizes[0])
    _check.floating_trailing_shape(op, "b", b, terms.sizes[1])
    _check.same_device(op, a=a, b=b)
    return _precise_product(a, b, terms)


@in_full_precision
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
    if A.is_cpu and not is_compiling():
        return _DETERMINANT.of(A)
    first, second, third = A.split([4, 4, 5], -1)
    next_first, next_second, _ = A.roll(-1, -2).split([4, 4, 5], -1)
    # Of rows i and i + 1 each, to be multiplied by row i + 2.
    minors = product(first, next_second, _TO_SIXTH_POWER) - product(next_first, second, _TO_SIXTH_POWER)
    return product(minors, third.roll(1, -2), _TO_TENTH_POWER).sum(-2)
