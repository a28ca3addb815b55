"""Operators on batches as operators on lists of images, whose results keep their sizes; and what augmentations call by them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._list_ops import ListOperator
from kvision._ops import Operator
from kvision.geometry.transform.lists import arguments as lists

Arguments = tuple[Any, ...]
_OF_LISTS: dict[Operator, ListOperator] = {}


def runs_on_lists(operator: Operator) -> bool:
    """Whether an operator on batches has a kernel for lists."""
    return operator in _OF_LISTS


class Operation(NamedTuple):
    """An operator that has a kernel for lists, and its arguments behind the images."""

    operator: Operator
    arguments: Arguments

    def __call__(self, images: Tensor) -> Tensor:
        y: Tensor = self.operator(images, *self.arguments)
        return y

    def on_list(self, images: Sequence[Tensor]) -> list[Tensor]:
        """The results of images (C, H, W) of different sizes."""
        if self.operator.non_differentiable:
            images = [x.detach() for x in images]
        return list(_OF_LISTS[self.operator](images, *self.arguments))


def register_list(
    name: str,
    of: Operator,
    of_sample: Callable[..., Arguments],
    backward: Callable[..., Sequence[Tensor | None]] | None = None,
) -> ListOperator:
    """The operator on lists of images (C, H, W) that an operator on images (B, C, H, W) has a kernel for.

    Args:
        name: name of the operator, `torch.ops.kvision.<name>`.
        of: the operator on batches.
        of_sample: the arguments behind the images of sample b, for its number and those of all.
        backward: the gradients of the first tensors of a batch, for which of them are wanted, the gradient and the arguments;
            default: those of the reference.
    """

    def of_reference(needs: Sequence[bool], grad: Tensor, *args: Any) -> Sequence[Tensor | None]:
        wanted = [*needs, *(False,) * (len(args) - len(needs))]
        return of.differentiate_reference(wanted, grad, *args)

    of_batch = backward or of_reference

    def reference(images: Sequence[Tensor], *args: Any) -> list[Tensor]:
        return [of.reference(x[None], *of_sample(b, *args))[0] for b, x in enumerate(images)]

    def gradients(needs: Sequence[bool], grads: Any, images: Sequence[Tensor], *args: Any) -> list[Any]:
        each = [
            of_batch(needs, torch.zeros_like(x)[None] if g is None else g[None], x[None], *of_sample(b, *args))
            for b, (g, x) in enumerate(zip(grads, images))
        ]
        of_images, *others = zip(*each)
        found = [None if own[0] is None else _of_all(own, x) for own, x in zip(others, args)]
        return [[g[0] for g in of_images] if needs[0] else None, *found, *(None,) * (len(needs) - 1 - len(found))]

    _OF_LISTS[of] = ListOperator(
        name,
        of,
        reference,
        fake=lambda images, *args: lists.fake_results(images, [n for x in images for n in x.shape[-2:]]),
        backward=gradients,
    )
    return _OF_LISTS[of]


def _of_all(each: Sequence[Tensor], like: Tensor) -> Tensor:
    """The gradient of a tensor with a row of each sample, or one row for all."""
    return torch.stack(list(each)).sum(0) if like.shape[0] == 1 else torch.cat(list(each))
