"""Functions of a norm that are smooth in its square, and therefore differentiable where the norm is 0."""

from __future__ import annotations

import torch
from torch import Tensor


def sinc(square: Tensor) -> Tensor:
    """sin(x) / x as a function of x squared, differentiable at 0."""
    small = square < 1e-3
    x = torch.where(small, 1, square).sqrt()
    series = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
    return torch.where(small, series, x.sin() / x)


def cos(square: Tensor) -> Tensor:
    """cos(x) as a function of x squared, differentiable at 0: 1 - 2 sin(x / 2)^2."""
    return 1 - square / 2 * sinc(square / 4).square()


def angle_per_sine(sine: Tensor, cosine: Tensor) -> Tensor:
    """atan2(s, c) / s, where `sine` is s squared, differentiable at 0. It is 0 where s is 0 and c is not positive."""
    small = (cosine > 0) & (sine < 1e-4 * cosine.square())
    c = torch.where(small, cosine, 1)
    ratio = torch.where(small, sine, 0) / c.square()
    series = (1 - ratio * (1 / 3 - ratio * (1 / 5 - ratio / 7))) / c
    none = sine < torch.finfo(sine.dtype).tiny
    s = torch.where(small | none, 1, sine).sqrt()
    angle = torch.atan2(s, torch.where(none, 1, cosine))
    return torch.where(small, series, torch.where(none, 0, angle / s))


def angle_per_tangent(tangent: Tensor) -> Tensor:
    """atan(t) / t, where `tangent` is t squared, differentiable at 0."""
    small = tangent < 1e-4
    series = 1 - tangent * (1 / 3 - tangent * (1 / 5 - tangent / 7))
    t = tangent.clamp(min=1e-4).sqrt()
    return torch.where(small, series, t.atan() / t)


def angle_per_tangent_with_derivatives(tangent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`angle_per_tangent`, its derivative with respect to t squared, and that of atan(t) with respect to t."""
    grad_angle = 1 / (1 + tangent)
    square = tangent.clamp(min=1e-3)
    t = square.sqrt()
    series = tangent * (3 / 7 - tangent * (4 / 9 - tangent * (5 / 11)))
    series = torch.addcmul(tangent * (2 / 5) - 1 / 3, tangent, series, value=-1)
    derivative = torch.where(tangent < 1e-3, series, (grad_angle - t.atan() / t) / (2 * square))
    return torch.addcmul(grad_angle, tangent, derivative, value=-2), derivative, grad_angle


def squared(x: Tensor) -> Tensor:
    return x.square().sum(-1, keepdim=True)
