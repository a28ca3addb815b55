"""What the four Lie groups have in common, and the functions of an angle that their maps are made of.

The maps are smooth functions of the squared angle. Below an angle of 1 they are series, which have derivatives of any order
at 0 and lose no digits; the ninth term is below the rounding of float64.
"""

from __future__ import annotations

from abc import abstractmethod
from math import factorial
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import StatefulModule, as_operands
from kvision.core.exceptions import TypeCheckError

Self = TypeVar("Self", bound="LieGroup")
Motion = TypeVar("Motion", bound="RigidMotion[Any]")
Rotation = TypeVar("Rotation", bound="LieGroup")


class LieGroup(StatefulModule):
    """A batch of group elements with any leading axes.

    Tensors that an element is made of become an nn.Parameter, so that an optimizer finds them. A tensor that already requires
    a gradient stays part of its graph. What operations return needs a gradient where their operands do.
    """

    tangent_axes = 1  # of a tangent vector; 0 where it is a number

    @abstractmethod
    def log(self) -> Tensor: ...

    @abstractmethod
    def inverse(self: Self) -> Self: ...

    @staticmethod
    @abstractmethod
    def exp(v: Tensor) -> Any: ...

    def retract(self: Self, v: Tensor) -> Self:
        """Move the elements along a tangent vector at the identity: `self * exp(v)`.

        Args:
            v: tangent vectors (*, n), as :meth:`log` returns them.

        Returns:
            The moved elements. Gauss-Newton and other solvers on the group update an element this way.
        """
        step = self.exp(v)  # made here, and no more to learn than v is
        moved: Self = self * (step if v.requires_grad else step.requires_grad_(False))
        return moved

    def interpolate(self: Self, other: Self, t: Tensor | float) -> Self:
        """The elements on the geodesic to `other`: `self * exp(t * log(self^-1 * other))`.

        Args:
            other: the elements at t = 1.
            t: a number or (*). 0 gives `self`, 1 gives `other`.

        Returns:
            The elements at t.

        Raises:
            TypeError: `other` is of another group.
        """
        if type(other) is not type(self):
            name = type(self).__name__
            raise TypeCheckError(f"{name}.interpolate: expected other to be a {name}, got {type(other).__name__}")
        tangent = (self.inverse() * other).log()
        if isinstance(t, Tensor) and t.dim() > 0:
            t = t.reshape(*t.shape, *(1,) * self.tangent_axes)
        return self.retract(t * tangent)

    @abstractmethod
    def __mul__(self, right: Any) -> Any: ...


class RigidMotion(LieGroup, Generic[Rotation]):
    """A rotation and a translation of n coordinates."""

    _rotation: Rotation

    def __repr__(self) -> str:
        return f"rotation: {self.r}\ntranslation: {self.t}"

    def __getitem__(self: Motion, idx: Any) -> Motion:
        return type(self)(self.r[idx], as_operands(self.t[idx], self.t))

    @property
    def r(self) -> Rotation:
        """The rotations."""
        return self._rotation

    @property
    def rotation(self) -> Rotation:
        """The rotations."""
        return self._rotation

    @property
    def t(self) -> Tensor:
        """The translations (*, n)."""
        return self._translation  # type: ignore[return-value]  # a tensor by construction

    @property
    def translation(self) -> Tensor:
        """The translations (*, n)."""
        return self.t


def check_translation(group: str, translation: Any, n: int) -> None:
    """Raise unless `translation` is a floating-point tensor (*, n)."""
    _check.floating_trailing_shape(group, "translation", translation, n)


def shape_of(batch_size: int | None) -> tuple[int, ...]:
    """The leading axes of an element or of a batch of them."""
    return () if batch_size is None else (batch_size,)


# --- functions of the squared angle ----------------------------------------------------------------------------------
#
# a = sin(x) / x, b = (1 - cos(x)) / x^2 are in conversions/series.py; these are the ones of higher order.

_SINE_REST = [(-1) ** k / factorial(2 * k + 3) for k in range(9)]
_COSINE_REST = [(-1) ** k / factorial(2 * k + 4) for k in range(9)]
_TRANSLATION_REST = [(-1) ** k * (k + 1) / factorial(2 * k + 5) for k in range(9)]
# |B_2n| / (2n)! of the Bernoulli numbers.
_COTANGENT_REST = [
    *(1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600),
    *(3617 / 10670622842880000, 43867 / 5109094217170944000, 174611 / 802857662698291200000),
    *(77683 / 14101100039391805440000, 236364091 / 1693824136731743669452800000),
]


def _series(square: Tensor, coefficients: list[float]) -> Tensor:
    total = torch.full_like(square, coefficients[-1])
    for c in reversed(coefficients[:-1]):
        total = total * square + c
    return total


def _by_angle(square: Tensor, coefficients: list[float], closed_form: Any) -> Tensor:
    """The series where x^2 < 1, the closed form elsewhere. Neither has infinite derivatives where the other is used."""
    small = square < 1
    x2 = torch.where(small, 2, square)
    return torch.where(small, _series(torch.where(small, square, 0), coefficients), closed_form(x2, x2.sqrt()))


def sine_rest(square: Tensor) -> Tensor:
    """(x - sin x) / x^3 of x squared."""
    return _by_angle(square, _SINE_REST, lambda x2, x: (1 - x.sin() / x) / x2)


def cosine_rest(square: Tensor) -> Tensor:
    """(x^2 / 2 - 1 + cos x) / x^4 of x squared."""
    return _by_angle(square, _COSINE_REST, lambda x2, x: (0.5 - (1 - x.cos()) / x2) / x2)


def translation_rest(square: Tensor) -> Tensor:
    """(2 x - 3 sin x + x cos x) / (2 x^5) of x squared."""
    return _by_angle(square, _TRANSLATION_REST, lambda x2, x: (1 - 1.5 * x.sin() / x + 0.5 * x.cos()) / x2.square())


def cotangent_rest(square: Tensor) -> Tensor:
    """(1 - (x / 2) cot(x / 2)) / x^2 of x squared; infinite at 2 pi."""
    return _by_angle(square, _COTANGENT_REST, lambda x2, x: (1 - x / 2 * (x / 2).cos() / (x / 2).sin()) / x2)
