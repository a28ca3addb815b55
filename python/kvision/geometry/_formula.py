"""Operators that compute a small matrix or vector for each sample: one kernel launch each, and one for the gradient.

csrc/geometry/formulas.h lists the formulas of the kernels, from which their gradients are derived. This file has the
references.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import as_dtype
from kvision._leading import broadcast_shapes, expand_to_batch
from kvision._ops import Operator, register

FORMULAS: set[str] = set()  # the operators of formulas


def register_formula(name: str, reference: Callable[..., Tensor], result: Callable[..., tuple[int, ...]]) -> Operator:
    """The operator of a formula of tensors (B, ...) or (1, ...); `result` gives the axes behind the batch from all arguments.

    Its gradient comes as one tensor (B, n): the gradients of all tensor arguments, concatenated.
    """

    def backward(needs: Any, grad: Tensor, *args: Any) -> list[Tensor | None]:
        joint = backward_op(grad, *args)
        shapes = [x.shape for x in args if isinstance(x, Tensor)]
        widths = [shape[1] if len(shape) == 2 else math.prod(shape[1:]) for shape in shapes]
        parts = joint.split_with_sizes(widths, 1) if len(widths) > 1 else (joint,)
        of_tensors = iter(
            part if part.shape == shape else part.reshape(part.shape[0], *shape[1:]).sum_to_size(shape)
            for part, shape in zip(parts, shapes)
        )
        grads = [next(of_tensors) if isinstance(x, Tensor) else None for x in args]
        return [g if need else None for need, g in zip(needs, grads)]

    def jvp(tangents: Sequence[Tensor | None], *args: Any) -> Tensor:
        batch, sizes = batch_of(*args), result(*args)
        count = math.prod(sizes)
        repeated = [x.repeat_interleave(count, 0) if isinstance(x, Tensor) and len(x) != 1 else x for x in args]
        first = next(x for x in args if isinstance(x, Tensor))
        rows = torch.eye(count, dtype=first.dtype, device=first.device).repeat(batch, 1)
        jacobian = backward_op(rows.reshape(-1, *sizes), *repeated).unflatten(0, (batch, count))
        widths = [math.prod(x.shape[1:]) for x in args if isinstance(x, Tensor)]
        each = zip(
            [t for t, x in zip(tangents, args) if isinstance(x, Tensor)], jacobian.split_with_sizes(widths, 2), widths
        )
        parts = [part @ t.reshape(t.shape[0], n, 1) for t, part, n in each if t is not None]
        return sum(parts[1:], parts[0]).reshape(batch, *sizes)

    def backward_reference(grad: Tensor, *args: Any) -> Tensor:
        where = [i for i, x in enumerate(args) if isinstance(x, Tensor)]

        def of_tensors(*tensors: Tensor) -> Tensor:
            full = list(args)
            for i, x in zip(where, tensors):
                full[i] = x
            return reference(*full)

        each = [args[i].expand(grad.shape[0], *args[i].shape[1:]) for i in where]
        vjp_fn = torch.func.vjp(of_tensors, *each)[1]
        return torch.cat([g.reshape(grad.shape[0], math.prod(g.shape[1:])) for g in vjp_fn(grad)], 1)

    backward_op = register(
        f"{name}_backward",
        backward_reference,
        fake=lambda grad, *args: (grad.shape[0], sum(math.prod(x.shape[1:]) for x in args if isinstance(x, Tensor))),
    )
    FORMULAS.add(name)
    return register(name, reference, fake=lambda *args: (batch_of(*args), *result(*args)), backward=backward, jvp=jvp)


def batch_of(*args: Any) -> int:
    """The common batch size of tensors, of which those of one row broadcast."""
    return next((x.shape[0] for x in args if isinstance(x, Tensor) and x.shape[0] != 1), 1)


def of_rows(operator: Operator, x: Tensor, axes: int, *plain: Any) -> Tensor:
    """A formula of one tensor (*, ...) whose last `axes` axes are a sample's."""
    if x.dim() == axes + 1:
        output: Tensor = operator(x, *plain)
        return output
    first = x.dim() - axes
    output = operator(x.reshape(math.prod(x.shape[:first]), *x.shape[first:]), *plain)
    return output.reshape(*x.shape[:first], *output.shape[1:])


def of_all(operator: Operator, axes: int, first: Tensor, *others: Tensor) -> Tensor:
    """A formula of tensors (*, ...) whose leading axes broadcast, `axes` others being a sample's, in the first one's type."""
    tensors = [first, *(as_dtype(x, first.dtype) for x in others)]
    if all(x.dim() == axes + 1 for x in tensors):
        output: Tensor = operator(*tensors)
        return output
    shape = broadcast_shapes(*(x.shape[:-axes] for x in tensors))
    output = operator(*(expand_to_batch(x, shape, axes) for x in tensors))
    return output.reshape(*shape, *output.shape[1:])
