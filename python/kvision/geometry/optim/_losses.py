"""Robust kernels: rho(s) of s, the squared norm of a block of residuals, with rho(s) = s + O(s^2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ValueCheckError

RobustLoss: TypeAlias = Literal["linear", "huber", "soft_l1", "cauchy", "arctan", "geman_mcclure", "welsch", "tukey"]
Loss = Callable[[Tensor], Tensor]


def _huber(s: Tensor) -> Tensor:
    return torch.where(s <= 1, s, 2 * s.clamp(min=1).sqrt() - 1)


def _tukey(s: Tensor) -> Tensor:
    return (1 - (1 - s).clamp(min=0) ** 3) / 3


LOSSES: dict[RobustLoss, Loss] = {
    "linear": lambda s: s,
    "huber": _huber,
    "soft_l1": lambda s: 2 * ((1 + s).sqrt() - 1),
    "cauchy": torch.log1p,
    "arctan": torch.atan,
    "geman_mcclure": lambda s: s / (1 + s),
    "welsch": lambda s: -torch.expm1(-s),
    "tukey": _tukey,
}


def loss_of(op: str, loss: RobustLoss | Loss, scale: float) -> Loss | None:
    """The kernel C^2 rho(s / C^2) of a name or function; None for the squared norm itself."""
    scale = _check.number(op, "f_scale", scale)
    if not scale > 0:
        raise ValueCheckError(f"{op}: expected f_scale above 0, got {scale!r}", actual_value=scale)
    if isinstance(loss, str):
        _check.choice(op, "loss", loss, tuple(LOSSES))
        if loss == "linear":
            return None
        loss = LOSSES[loss]
    _check.function(op, "loss", loss)
    rho, square = loss, scale * scale
    return lambda s: square * rho(s / square)


def with_derivatives(rho: Loss, s: Tensor) -> tuple[Tensor, Tensor]:
    """The first and second derivative of an elementwise function."""
    one = torch.ones_like(s)

    def slope(s: Tensor) -> Tensor:
        derivative: Tensor = torch.func.jvp(rho, (s,), (one,))[1]
        return derivative

    derivatives: tuple[Tensor, Tensor] = torch.func.jvp(slope, (s,), (one,))  # type: ignore[assignment]  # no has_aux
    return derivatives
