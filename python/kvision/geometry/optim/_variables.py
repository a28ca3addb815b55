"""Unknowns of a least-squares problem: vectors and group elements, by name, with their tangents.

A variable without an index is one element of each problem. One with an index has many elements (B, K, ...), of which a block of
residuals sees one or a few.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import as_operands
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.liegroup import Se3, Sim3, So3
from kvision.geometry.quaternion import Quaternion

Value = Any  # a Tensor, So3, Se3 or Sim3
Variables = dict[str, Any]
_SIZES: dict[type, int] = {So3: 3, Se3: 6, Sim3: 7}


def tensors_of(x: Value) -> tuple[Tensor, ...]:
    """The tensors that a variable is made of."""
    if isinstance(x, Tensor):
        return (x,)
    if isinstance(x, So3):
        return (x.q.data,)
    rest = (x.t, x.scale) if isinstance(x, Sim3) else (x.t,)
    return (x.quaternion.data, *rest)


def value_like(x: Value, tensors: tuple[Tensor, ...]) -> Value:
    """A variable of the kind of `x` that is made of `tensors`, which need no gradient unless they are part of a graph."""
    if isinstance(x, Tensor):
        return tensors[0]
    first, *rest = (as_operands(t) for t in tensors)
    rotation = So3(Quaternion(first))
    return rotation if isinstance(x, So3) else type(x)(rotation, *rest)


def retracted(x: Value, step: Tensor) -> Value:
    """exp(step) x, or x + step; `step` (*, n) has the leading axes of `x` or one axis for all of its numbers."""
    if isinstance(x, Tensor):
        return x + step.reshape(x.shape)
    shape = tensors_of(x)[0].shape[:-1]
    moved: Value = type(x).exp(step.reshape(*shape, _SIZES[type(x)])) * x
    return moved


class _Turning(So3):
    """Rotations that are differentiated: their matrices are given, because a derivative of the conversion takes long."""

    def __init__(self, q: Tensor, matrix: Tensor) -> None:
        super().__init__(Quaternion(q))
        self._matrix = matrix

    def matrix(self) -> Tensor:
        return self._matrix

    def __getitem__(self, idx: Any) -> So3:
        return _Turning(self.q.data[idx], self._matrix[idx])


def moving_tensors(x: Value) -> tuple[Tensor, ...]:
    """The tensors of a variable that move with it, of which `moving_value` makes one."""
    return tensors_of(x) if isinstance(x, Tensor) else (*tensors_of(x), (x if isinstance(x, So3) else x.r).matrix())


def moving_value(x: Value, tensors: tuple[Tensor, ...]) -> Value:
    """A variable of the kind of `x` of its moving tensors."""
    if isinstance(x, Tensor):
        return tensors[0]
    q, *rest, matrix = tensors
    rotation = _Turning(q, matrix)
    return rotation if isinstance(x, So3) else type(x)(rotation, *rest)


def velocities(x: Value, tensors: tuple[Tensor, ...], step: Tensor) -> tuple[Tensor, ...]:
    """How the moving tensors of exp(s step) x change with s at s = 0, for steps (T, *, n) of all of its numbers."""
    if isinstance(x, Tensor):
        return (step.reshape(len(step), *x.shape),)
    q, matrix = tensors[0], tensors[-1]
    step = step.reshape(len(step), *q.shape[:-1], _SIZES[type(x)])
    w = step if isinstance(x, So3) else step[..., 3:6]
    real, imaginary = q.split([1, 3], -1)
    of_real, of_imaginary = -(w * imaginary).sum(-1, keepdim=True), real * w + torch.linalg.cross(w, imaginary[None])
    of_q = 0.5 * torch.cat([of_real, of_imaginary], -1)  # half the product of (0, w) and q
    of_matrix = torch.linalg.cross(w[..., None].expand(*w.shape, 3), matrix[None], dim=-2)
    if isinstance(x, So3):
        return of_q, of_matrix
    of_t = step[..., :3] + torch.linalg.cross(w, tensors[1][None])
    if not isinstance(x, Sim3):
        return of_q, of_t, of_matrix
    return of_q, of_t + step[..., 6:] * tensors[1], step[..., 6] * tensors[2], of_matrix


def normalized(x: Value) -> Value:
    """`x` with quaternions of length 1, from which products drift by rounding."""
    if isinstance(x, Tensor):
        return x
    q, *rest = tensors_of(x)
    return value_like(x, (q / torch.linalg.vector_norm(q, dim=-1, keepdim=True), *rest))


def detached(variables: Variables) -> Variables:
    return {name: value_like(x, tuple(t.detach() for t in tensors_of(x))) for name, x in variables.items()}


def chosen(condition: Tensor, a: Variables, b: Variables | float) -> Variables:
    """The elements of `a` in problems where `condition` (B,) holds, those of `b` elsewhere."""

    def choose(x: Tensor, y: Tensor | float) -> Tensor:
        return torch.where(condition.reshape(-1, *(1,) * (x.dim() - 1)), x, y)

    result = {}
    for name, x in a.items():
        tensors = tensors_of(x)
        others = tensors_of(b[name]) if isinstance(b, dict) else (b,) * len(tensors)
        result[name] = value_like(x, tuple(map(choose, tensors, others)))
    return result


@dataclass(frozen=True, eq=False)
class Reference:
    """How residuals see a variable: the element `index[n]` of `count` in block n, or the only one for None.

    `columns` are its derivatives in the Jacobian of a block, and `within` those in the part of the variable; its unknowns begin
    at `offset` among all.
    """

    name: str
    size: int
    count: int
    offset: int
    index: Tensor | None
    columns: slice
    within: slice


class Layout:
    """The unknowns of variables in one vector (B, D), in the order of the dictionary, and the references to them.

    Args:
        op: the function that checks its arguments here.
        variables: tensors (B, *) and groups (B, *) by name.
        index: for variables (B, K, *), the elements (N,) or (N, m) that each block of residuals sees.
    """

    def __init__(self, op: str, variables: Mapping[str, Value], index: Mapping[str, Tensor] | None) -> None:
        if not isinstance(variables, Mapping) or not variables:
            raise TypeCheckError(
                f"{op}: expected variables to be a dictionary of one variable or more, got {variables!r}"
            )
        self.index = dict(index or {})
        for name in self.index:
            _check.choice(op, "names in index", name, tuple(variables))
        self.references: list[Reference] = []
        self.slices: dict[str, slice] = {}
        self.shapes: dict[str, tuple[int, ...]] = {}  # of the steps that residuals see, after the batch
        offset = column = 0
        first: Tensor | None = None
        for name, x in variables.items():
            shape, size = self._sizes(op, name, x)
            q = tensors_of(x)[0]
            first = q if first is None else first
            _check.same_device(op, **{next(iter(variables)): first, name: q})
            if shape[0] != self._batch(variables) or q.dtype != first.dtype:
                raise ShapeError(
                    f"{op}: expected variables of one batch size and type, got {name} {tuple(q.shape)} of {q.dtype}"
                )
            if name not in self.index:
                width = size * _product(shape[1:])
                every = slice(column, column + width)
                self.references.append(Reference(name, width, 1, offset, None, every, slice(0, width)))
                self.shapes[name] = (width,)
                count, column = 1, column + width
            else:
                i, count, width = self.index[name], shape[1], size * _product(shape[2:])
                if i.numel() and _check.values_are_readable(i) and not (0 <= i.min() and i.max() < count):
                    raise ValueCheckError(
                        f"{op}: expected index[{name!r}] from 0 to {count - 1}, got {i}", actual_value=i
                    )
                rows = i.shape[1:]
                for k, each in enumerate(i[:, None].unbind(1) if i.dim() == 1 else i.unbind(1)):
                    within = slice(k * width, (k + 1) * width)
                    columns = slice(column + within.start, column + within.stop)
                    self.references.append(Reference(name, width, count, offset, each, columns, within))
                self.shapes[name] = (i.shape[0], _product(rows) * width)
                column += _product(rows) * width
            self.slices[name] = slice(offset, offset + count * width)
            offset += count * width
        self.size, self.width = offset, column

    def _sizes(self, op: str, name: str, x: Any) -> tuple[tuple[int, ...], int]:
        """The leading axes of a variable and the size of its tangents."""
        if not isinstance(x, (Tensor, *_SIZES)):
            kinds = "a Tensor, So3, Se3 or Sim3"
            raise TypeCheckError(f"{op}: expected the variable {name!r} to be {kinds}, got {type(x).__name__}")
        for t in tensors_of(x):
            if t.dtype not in (torch.float32, torch.float64):
                raise TypeCheckError(
                    f"{op}: expected {name} to be float32 or float64, got {t.dtype}", actual_type=t.dtype
                )
        shape = tuple(tensors_of(x)[0].shape)
        if not isinstance(x, Tensor):
            shape = shape[:-1]
        i = self.index.get(name)
        if len(shape) < (1 if i is None else 2):
            expected = "(B, *)" if i is None else "(B, K, *)"
            raise ShapeError(f"{op}: expected {name} of shape {expected}, got {shape}", actual_shape=shape)
        if i is not None:
            _check.is_tensor(op, f"index[{name!r}]", i)
            if i.dtype != torch.int64:
                raise TypeCheckError(f"{op}: expected index[{name!r}] to be int64, got {i.dtype}", actual_type=i.dtype)
            if i.dim() not in (1, 2):
                raise ShapeError(f"{op}: expected index[{name!r}] of shape (N,) or (N, m), got {tuple(i.shape)}")
        return shape, 1 if isinstance(x, Tensor) else _SIZES[type(x)]

    @staticmethod
    def _batch(variables: Mapping[str, Value]) -> int:
        return tensors_of(next(iter(variables.values())))[0].shape[0]

    def retracted(self, variables: Variables, step: Tensor) -> Variables:
        """All variables moved along steps (B, D)."""
        return {
            name: normalized(retracted(x, step[:, part]))
            for (name, part), x in zip(self.slices.items(), variables.values())
        }

    def seen(self, variables: Variables) -> Variables:
        """The variables as residuals see them: (B, N, *) or (B, N, m, *) where they have an index."""
        return {name: x[:, self.index[name]] if name in self.index else x for name, x in variables.items()}

    def moved(self, seen: Variables, steps: Mapping[str, Tensor]) -> Variables:
        return {name: retracted(x, steps[name]) for name, x in seen.items()}

    def zeros(self, seen: Variables) -> dict[str, Tensor]:
        """Steps of the variables that residuals see, of length 0."""
        return {
            name: tensors_of(x)[0].new_zeros(tensors_of(x)[0].shape[0], *self.shapes[name]) for name, x in seen.items()
        }

    def directions(self, seen: Variables) -> dict[str, Tensor]:
        """The unit steps (T, ...) along every column of the Jacobian, for all elements at once."""
        like = tensors_of(next(iter(seen.values())))[0]
        eye = torch.eye(self.width, dtype=like.dtype, device=like.device)
        parts = eye.split([shape[-1] for shape in self.shapes.values()], 1)
        return dict(zip(self.shapes, parts))

    def velocities(self, seen: Variables, moving: Mapping[str, tuple[Tensor, ...]]) -> dict[str, tuple[Tensor, ...]]:
        """How the moving tensors (T, ...) of the variables that residuals see change along every column of the Jacobian."""
        directions, zeros = self.directions(seen), self.zeros(seen)
        steps = {
            name: d.reshape(self.width, *(1,) * (zeros[name].dim() - 1), -1).expand(self.width, *zeros[name].shape)
            for name, d in directions.items()
        }
        return {name: velocities(x, moving[name], steps[name]) for name, x in seen.items()}


def _product(shape: tuple[int, ...] | torch.Size) -> int:
    return torch.Size(shape).numel()


def one_of(op: str, name: str, value: Any, index: Mapping[str, Tensor] | None) -> None:
    """Raise unless `value` names a variable of which each block sees one element."""
    if not index or value not in index or index[value].dim() != 1:
        raise ValueCheckError(
            f"{op}: expected {name} to be a variable with an index of shape (N,), got {value!r}", actual_value=value
        )
