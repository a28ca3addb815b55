"""Real roots of polynomials."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision._ops import register
from kvision.geometry._precision import in_full_precision
from kvision.geometry.linalg import root

__all__ = ["solve_cubic", "solve_quadratic", "solve_quartic"]


@in_full_precision
def solve_quadratic(coeffs: Tensor) -> Tensor:
    """Find the real roots of a x^2 + b x + c.

    Args:
        coeffs: (*, B, 3) as (a, b, c), floating point.

    Returns:
        (*, B, 2): (-b + sqrt(b^2 - 4 a c)) / (2 a), then the one with the other sign, in a form that does not cancel. A
        double root stands there twice, zeros where there are none; the one root of b x + c comes first. Gradients are
        those of the roots, 0 for what is missing and at double roots that of -b / (2 a).

    Raises:
        TypeCheckError: `coeffs` is not a floating-point tensor.
        ShapeError: `coeffs` is not (*, B, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.solve_quadratic(torch.tensor([[1.0, -3.0, 2.0]]))
        tensor([[2., 1.]])
    """
    _check.floating_trailing_shape("solve_quadratic", "coeffs", coeffs, "B", 3)
    a, b, c = _scaled(coeffs).unbind(-1)
    discriminant = b * b - 4 * a * c
    distance = root(discriminant.clamp(min=0))
    negative, linear = b < 0, a == 0
    q = -0.5 * (b + torch.where(negative, -distance, distance))
    none = q == 0
    other = torch.where(none, 0, c / torch.where(none, 1, q))  # also the root of the linear equation
    leading = torch.where(linear, 1, a)
    one = q / leading
    first, second = torch.where(negative, one, other), torch.where(negative, other, one)
    double = -b / (2 * leading)
    flat = discriminant == 0
    first, second = torch.where(flat, double, first), torch.where(flat, double, second)
    first, second = torch.where(linear, other, first), torch.where(linear, 0, second)
    return torch.where((discriminant < 0)[..., None], 0, torch.stack([first, second], -1))


@in_full_precision
def solve_cubic(coeffs: Tensor) -> Tensor:
    """Find the real roots of a x^3 + b x^2 + c x + d.

    Args:
        coeffs: (*, B, 4) as (a, b, c, d), floating point; with leading zeros of a lower degree.

    Returns:
        (*, B, 3), in ascending order, repeated ones repeated, followed by zeros for those that are missing. Gradients are
        those of the roots, 0 for what is missing and for repeated ones, which have none.

    Raises:
        TypeCheckError: `coeffs` is not a floating-point tensor.
        ShapeError: `coeffs` is not (*, B, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.solve_cubic(torch.tensor([[1.0, 0.0, 0.0, -8.0]]))
        tensor([[2., 0., 0.]])
    """
    _check.floating_trailing_shape("solve_cubic", "coeffs", coeffs, "B", 4)
    return _roots_or_zeros(coeffs)


@in_full_precision
def solve_quartic(coeffs: Tensor) -> Tensor:
    """Find the real roots of a x^4 + b x^3 + c x^2 + d x + e.

    Args:
        coeffs: (*, B, 5) as (a, b, c, d, e), floating point; with leading zeros of a lower degree.

    Returns:
        (*, B, 4), in ascending order, repeated ones repeated, followed by zeros for those that are missing. Gradients are
        those of the roots, 0 for what is missing and for repeated ones, which have none.

    Raises:
        TypeCheckError: `coeffs` is not a floating-point tensor.
        ShapeError: `coeffs` is not (*, B, 5).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.solve_quartic(torch.tensor([[1.0, 0.0, -5.0, 0.0, 4.0]]))
        tensor([[-2., -1.,  1.,  2.]])
    """
    _check.floating_trailing_shape("solve_quartic", "coeffs", coeffs, "B", 5)
    return _roots_or_zeros(coeffs)


def _roots_or_zeros(coeffs: Tensor) -> Tensor:
    """Real roots (*, n) of polynomials (*, n + 1), and 0 for those that are missing."""
    if coeffs.dim() == 2:
        return real_roots(coeffs).nan_to_num(0.0)
    roots = real_roots(coeffs.flatten(0, -2)).nan_to_num(0.0)
    return roots.reshape(*coeffs.shape[:-1], coeffs.shape[-1] - 1)


def _scaled(coeffs: Tensor) -> Tensor:
    """Scale by a power of two, so that products neither overflow nor underflow. A zero polynomial stays 0."""
    largest = coeffs.detach().abs().amax(-1, keepdim=True)
    return coeffs / 2.0 ** torch.frexp(largest).exponent.to(coeffs.dtype)


# --- any degree -----------------------------------------------------------------------------------------------------


def _reference(coeffs: Tensor) -> Tensor:
    roots = _isolated(_scaled(promoted(coeffs)))
    return torch.where((coeffs == 0).all(-1, keepdim=True), torch.nan, roots).to(
        coeffs.dtype
    )  # every number is a root of the zero polynomial


_real_roots = register(
    "real_roots", _reference, fake=lambda coeffs: (coeffs.shape[0], coeffs.shape[1] - 1), non_differentiable=(0,)
)


def real_roots(coeffs: Tensor) -> Tensor:
    """Real roots (B, n) of polynomials (B, n + 1), highest power first, ascending; NaN for those that are missing.

    Two steps of Newton's method from the roots change nothing but add the first and the second derivative.
    """
    p = _scaled(promoted(coeffs))
    roots = _real_roots(p.detach())
    missing = roots.isnan()
    x = torch.where(missing, 0, roots)
    steep = value_and_derivative(p.detach().abs(), x.abs())[1]
    for _ in range(2):
        value, derivative = value_and_derivative(p, x)
        simple = derivative.detach().abs() > 1e-7 * steep
        x = x - torch.where(simple, value / torch.where(simple, derivative, 1), 0)
    return torch.where(missing, torch.nan, x).to(coeffs.dtype)


def value_and_derivative(p: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
    """Polynomials (B, n + 1), highest power first, and their derivatives at x (B, m)."""
    value = torch.zeros_like(x)
    derivative = torch.zeros_like(x)
    for c in p.unbind(-1):
        derivative = derivative * x + value
        value = value * x + c[..., None]
    return value, derivative


# A value below this fraction of the sum of the absolute terms counts as 0. Whether the curve crosses, touches or
# misses 0 there is rounding.
_TOUCH = 1e-14
_STEPS = 40


def _isolated(p: Tensor) -> Tensor:
    """`real_roots`, to the last bits where roots are simple. Outside of [-1, 1] they are inverse roots of the reversed one."""
    small, inverted = _in_unit(p), 1 / _in_unit(p.flip(-1))
    large = torch.where((inverted.abs() > 1) & inverted.isfinite(), inverted, torch.nan)
    return torch.cat([small, large], -1).sort(-1).values[..., : p.shape[-1] - 1]  # NaN at the end


def _in_unit(p: Tensor) -> Tensor:
    """Roots in [-1, 1]: between two adjacent roots of its derivative a polynomial has one root or none."""
    n = p.shape[-1] - 1
    powers = torch.arange(n, -1, -1, device=p.device, dtype=p.dtype)
    roots = p.new_zeros(*p.shape[:-1], 0)
    for degree in range(1, n + 1):
        derivative = p[..., : degree + 1]
        for i in range(n - degree):
            derivative = derivative * (powers[: degree + 1] - i)
        roots = _between(_scaled(derivative), roots)
    return roots


def _between(p: Tensor, critical: Tensor) -> Tensor:
    """Roots of p in [-1, 1] from those of its derivative. Both are ascending, with NaN at the end."""
    one = p.new_ones(*p.shape[:-1], 1)
    bounds = torch.cat([-one, critical.nan_to_num(1.0), one], -1)
    value = value_and_derivative(p, bounds)[0]
    flat = value.abs() <= _TOUCH * value_and_derivative(p.abs(), bounds.abs())[0]
    sign = torch.where(flat, 0.0, value.sign())
    low, high = bounds[..., :-1], bounds[..., 1:]
    crosses = sign[..., :-1] * sign[..., 1:] < 0
    rising = sign[..., 1:] > 0
    x = (low + high) / 2
    for _ in range(_STEPS):  # Newton's method, with bisection where a step leaves [low, high]
        at, derivative = value_and_derivative(p, x)
        right = (at < 0) == rising
        low, high = torch.where(right, x, low), torch.where(right, high, x)
        step = x - at / torch.where(derivative == 0, 1, derivative)
        x = torch.where((step >= low) & (step <= high) & (derivative != 0), step, (low + high) / 2)
    simple = torch.where(crosses, x, torch.nan)
    # A root of the derivative that is also a root of p has a multiplicity one higher in p.
    touches = flat[..., 1:-1] & critical.isfinite()
    repeated = torch.where(touches, critical, torch.nan)
    again = torch.where(touches & (critical != bounds[..., :-2]), critical, torch.nan)
    at_bounds = torch.where(flat & (bounds.abs() == 1), bounds, torch.nan)[..., [0, -1]]
    return torch.cat([simple, repeated, again, at_bounds], -1).sort(-1).values[..., : p.shape[-1] - 1]


# --- the first positive one -----------------------------------------------------------------------------------------

_FARTHEST = 1e4


def _first_root_reference(p: Tensor) -> Tensor:
    """x starts left of all roots and never passes one: csrc/geometry/solvers/first_root.h tells how."""
    degree = p.shape[-1] - 1
    powers = torch.arange(degree + 1, device=p.device, dtype=p.dtype)
    binomials = p.new_tensor([[math.comb(j, i) for i in range(degree + 1)] for j in range(degree + 1)])
    x = p[..., 0] / p.abs().sum(-1)
    for _ in range(_FIRST_ROOT_STEPS):
        t = ((p * x[..., None] ** powers)[..., None] * binomials).sum(-2)  # p(x + x h) = t[0] + t[1] h + ...
        falls = (-t[..., 1:]).clamp(min=0)
        left, right, at_left = torch.zeros_like(x), torch.ones_like(x), t[..., 0].clamp(min=0)
        for _ in range(4):
            at_right = t[..., 0] - (falls * right[..., None] ** powers[1:]).sum(-1)
            slope = (falls * powers[1:] * right[..., None] ** powers[:-1]).sum(-1)
            is_left = at_right >= 0
            chord = left + (right - left) * at_left / torch.where(is_left, 1, at_left - at_right)
            left = torch.where(is_left, right, chord)
            right = torch.where(is_left, right, right + at_right / torch.where(is_left, 1, slope))
            at_left = (t[..., 0] - (falls * left[..., None] ** powers[1:]).sum(-1)).clamp(min=0)
        x = (x * (1 + left)).clamp(max=_FARTHEST)
    return torch.where(x < _FARTHEST, x, torch.inf)


_FIRST_ROOT_STEPS = 28

# The smallest x > 0 (B,) with p[0] + p[1] x + ... = 0 of polynomials p (B, n + 1) that are positive at 0; inf for none.
first_root = register("first_root", _first_root_reference, fake=lambda p: (p.shape[0],), non_differentiable=(0,))
