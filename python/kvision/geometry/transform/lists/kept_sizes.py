"""Operators on batches as operators on lists of images, whose results keep their sizes; and what augmentations call by them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._constants import on_device
from kvision._list_ops import ListOperator
from kvision._ops import Operator
from kvision._torch_compat import in_function_transform
from kvision.geometry.transform.lists import arguments as lists
from kvision.geometry.transform.lists.arguments import row

Arguments = tuple[Any, ...]
_OF_LISTS: dict[Operator, ListOperator] = {}
_FILTERS: set[ListOperator] = set()
_KEPT: dict[ListOperator, Callable[..., Arguments]] = {}
_DIFFERENTIATES_BATCHES: set[Operator] = set()


def runs_on_lists(operator: Operator) -> bool:
    """Whether an operator on batches has a kernel for lists."""
    return operator in _OF_LISTS


def wants_gradients_of_list(images: Tensor, *others: Any) -> bool:
    """Whether a batch wants gradients, those of images alone, outside of graphs and transforms: those of the list of its images."""
    if not images.requires_grad or not torch.is_grad_enabled() or is_compiling() or in_function_transform():
        return False
    return images.numel() > 0 and not any(isinstance(x, Tensor) and x.requires_grad for x in others)


class Operation(NamedTuple):
    """An operator that has a kernel for lists, and its arguments behind the images. Of several results the first one counts."""

    operator: Operator
    arguments: Arguments

    def __call__(self, images: Tensor) -> Tensor:
        if self.operator in _DIFFERENTIATES_BATCHES and wants_gradients_of_list(images, *self.arguments):
            return torch.stack(self.on_list(list(images.unbind())))
        return _first(self.operator(images, *self.arguments))

    def on_list(self, images: Sequence[Tensor], chosen: Tensor | None = None) -> list[Tensor]:
        """The results of images (C, H, W) of different sizes.

        Images that are not `chosen`, (B,) float32, stay as they are, but for operators that draw; None for all.
        """
        if 0 in self.operator.non_differentiable and any(x.requires_grad for x in images):
            images = [x.detach() for x in images]
        operator = _OF_LISTS[self.operator]
        first, arguments = (chosen,) if operator in _FILTERS else (), self.arguments
        if chosen is not None and operator in _KEPT:
            arguments = _KEPT[operator](chosen, *arguments)
        return list(operator(images, *first, *arguments))[: len(images)]


class Operations(NamedTuple):
    """Operators that follow each other. Images of a batch that are not `chosen`, (B,), stay as they are; None for all."""

    each: Sequence[Operation]
    chosen: Tensor | None = None

    def __call__(self, images: Tensor) -> Tensor:
        y = images
        for operation in self.each:
            y = operation(y)
        return y if self.chosen is None else torch.where(self.chosen[:, None, None, None] != 0, y, images)

    def on_list(self, images: Sequence[Tensor], chosen: Tensor | None = None) -> list[Tensor]:
        """The results of images (C, H, W) of different sizes, as those of an operation."""
        for operation in self.each:
            images = operation.on_list(images, chosen)
        return list(images)


class OperationsOfSome(NamedTuple):
    """Operators on images of a list that are some of them each, by their numbers."""

    each: Sequence[tuple[Sequence[int], Operation]]

    def on_list(self, images: Sequence[Tensor], chosen: Tensor | None = None) -> list[Tensor]:
        """The results of images (C, H, W) of different sizes, as those of an operation."""
        results = list(images)
        for samples, operation in self.each:
            index = on_device(torch.tensor(samples, device="cpu"), images[0].device)
            own = None if chosen is None else chosen.index_select(0, index)
            for i, y in zip(samples, operation.on_list([images[i] for i in samples], own)):
                results[i] = y
        return results


def register_list(
    name: str,
    of: Operator,
    of_sample: Callable[..., Arguments],
    backward: Callable[..., Sequence[Tensor | None]] | None = None,
    kept: Callable[..., Arguments] | None = None,
    of_images: Callable[..., Sequence[Tensor]] | None = None,
    dtype: torch.dtype | None = None,
    by_image: Callable[..., Arguments] = lambda images, *args: args,
) -> ListOperator:
    """The operator on lists of images (C, H, W) that an operator on images (B, C, H, W) has a kernel for.

    Args:
        name: name of the operator, `torch.ops.kvision.<name>`.
        of: the operator on batches.
        of_sample: the arguments behind the images of sample b, for its number and those of all.
        backward: the gradients of the first tensors of a batch, for which of them are wanted, the gradient and the arguments;
            default: those of the reference.
        kept: the arguments behind the images with which those stay that are not chosen, for which are, (B,), and the arguments.
        of_images: the gradients of all images at once, for those of the results, the images and the arguments, where no others
            are wanted.
        dtype: the type of the results; default: that of the images.
        by_image: the arguments as `of_sample` takes them, for the images and those of the operator.
    """

    of_batch = backward or _of_reference(of)

    def reference(images: Sequence[Tensor], *args: Any) -> list[Tensor]:
        of_each = by_image(images, *args)
        return [of.reference(x[None], *of_sample(b, *of_each))[0] for b, x in enumerate(images)]

    def gradients(needs: Sequence[bool], grads: Any, images: Sequence[Tensor], *args: Any) -> list[Any]:
        grads = [torch.zeros_like(x) if g is None else g for g, x in zip(grads, images)]
        if of_images is not None and not any(needs[1:]):
            return [of_images(grads, images, *args), *(None,) * (len(needs) - 1)]
        of_each, pairs = by_image(images, *args), enumerate(zip(grads, images))
        each = [of_batch(needs, g[None], x[None], *of_sample(b, *of_each)) for b, (g, x) in pairs]
        own_images, *others = zip(*each)
        found = [None if own[0] is None else _of_all(own, x) for own, x in zip(others, args)]
        return [[g[0] for g in own_images] if needs[0] else None, *found, *(None,) * (len(needs) - 1 - len(found))]

    operator = _register(name, of, reference, gradients, dtype=dtype)
    if kept is not None:
        _KEPT[operator] = kept
    return operator


def _of_reference(of: Operator) -> Callable[..., Sequence[Tensor | None]]:
    """The gradients of the first tensors of a batch by the reference."""

    def gradients(needs: Sequence[bool], grad: Tensor, *args: Any) -> Sequence[Tensor | None]:
        wanted = [*needs, *(False,) * (len(args) - len(needs))]
        return of.differentiate_reference(wanted, grad, *args)

    return gradients


def _register(
    name: str,
    of: Operator,
    reference: Callable[..., list[Tensor]],
    gradients: Callable[..., list[Any]],
    supports: Callable[..., str | None] = lambda *args: None,
    dtype: torch.dtype | None = None,
    saves_results: bool = False,
    of_channels: Sequence[int] | None = None,
) -> ListOperator:
    """The operator on lists, whose results have the sizes of the images."""

    def fake(images: Sequence[Tensor], *args: Any) -> list[Tensor]:
        results = lists.fake_results(images, [n for x in images for n in x.shape[-2:]])
        results = results if dtype is None else [y.to(dtype) for y in results]
        more = [] if of_channels is None else [images[0].new_empty(len(images), images[0].shape[0], *of_channels)]
        return [*results, *more]

    _OF_LISTS[of] = ListOperator(
        name,
        of,
        reference,
        fake=fake,
        backward=gradients,
        supports=supports,
        saves_results=saves_results,
        non_differentiable=() if of_channels is None else (-1,),
    )
    return _OF_LISTS[of]


def register_list_backward(
    name: str,
    of: Operator,
    reference: Callable[..., Sequence[Tensor]],
    supports: Callable[..., str | None] = lambda *args: None,
    fake: Callable[..., list[Tensor]] | None = None,
) -> ListOperator:
    """The operator that gives gradients of the images of a list: it takes the images, and behind them the gradients of results.

    Args:
        name: name of the operator, `torch.ops.kvision.<name>`.
        of: the operator on batches that has kernels where this one has.
        reference: the definition, which is differentiated for second derivatives.
        supports: why the kernel does not serve a list and its arguments, or None.
        fake: empty tensors like the results, where these are no gradients of images.
    """

    def fake_images(both: Sequence[Tensor], *args: Any) -> list[Tensor]:
        images, _ = lists.halves(both)
        return lists.fake_results(images, [n for x in images for n in x.shape[-2:]])

    def gradients(needs: Sequence[bool], grad_grads: Sequence[Tensor], both: Sequence[Tensor], *args: Any) -> list[Any]:
        tensors, count = args[: len(needs) - 1], len(both)
        are_real = [x is not None and x.is_floating_point() for x in tensors]

        def result(*given: Tensor) -> tuple[Tensor, ...]:
            others = iter(given[count:])
            own = [next(others) if is_real else x for x, is_real in zip(tensors, are_real)]
            return tuple(reference(given[:count], *own, *args[len(tensors) :]))

        real = (x for x, is_real in zip(tensors, are_real) if is_real)
        of_all: Any = torch.func.vjp(result, *both, *real)[1](tuple(grad_grads))
        others = iter(of_all[count:])
        return [list(of_all[:count]), *(next(others) if is_real else None for is_real in are_real)]

    return ListOperator(name, of, reference, fake=fake or fake_images, backward=gradients, supports=supports)


def by_samples(of_sample: Callable[..., Tensor]) -> Callable[..., list[Tensor]]:
    """The reference of an operator that gives gradients of a list: its arguments are images and gradients, `chosen` and others.

    `of_sample(b, grad, image, *others)` are those of sample b, as batches.
    """

    def reference(images_and_grads: Sequence[Tensor], chosen: Tensor | None, *args: Any) -> list[Tensor]:
        images, grads = lists.halves(images_and_grads)
        each = [of_sample(b, g[None], x[None], *args)[0] for b, (x, g) in enumerate(zip(images, grads))]
        return each if chosen is None else where_chosen(chosen, each, grads)

    return reference


def where_chosen(chosen: Tensor, each: Sequence[Tensor], others: Sequence[Tensor]) -> list[Tensor]:
    """Images of a list, or others where `chosen`, (B,) or (1,), is 0."""
    return [torch.where(own != 0, y, x) for own, y, x in zip(chosen.expand(len(each)).unbind(), each, others)]


def register_filter(
    name: str,
    of: Operator,
    of_sample: Callable[..., Arguments],
    backward: Callable[..., Sequence[Tensor | None]] | None = None,
    transposed: Operator | None = None,
    supports: Callable[..., str | None] = lambda *args: None,
    of_images: Callable[..., Sequence[Tensor]] | None = None,
    by_image: Callable[..., Arguments] = lambda images, *args: args,
    saves_results: bool = False,
    of_channels: Sequence[int] | None = None,
    differentiates_batches: bool = False,
) -> ListOperator:
    """The operator on lists of a filter.

    Its arguments behind the images are `chosen`, (B,) float32, 0 for images that are copied, or None, and those of the operator
    on batches.

    Args:
        name: name of the operator, `torch.ops.kvision.<name>`.
        of: the operator on batches.
        of_sample: the arguments behind the images of sample b, for its number and those of all.
        backward: the gradients of the images of a batch and of the tensors behind them, for which of them are wanted, the
            gradient, the images and the arguments; default: those of the reference.
        transposed: the operator on lists of which gives the gradients of the images at once, instead of `backward`.
        supports: why the kernel does not serve a list and these arguments, or None.
        of_images: the gradients of all images at once, for those of the results, the images, which are chosen and the arguments,
            where no others are wanted.
        by_image: the arguments as `of_sample` takes them, for the images and those of the operator.
        saves_results: `of_images` takes the results between the gradients and the images.
        of_channels: sizes behind (B, C) of what the operators return of each channel behind the images; None if nothing.
        differentiates_batches: an operation on a batch whose images alone want gradients is one on the list of these, as `of` is
            differentiated by its reference.
    """

    of_batch = backward or _of_reference(of)

    def reference(images: Sequence[Tensor], chosen: Tensor | None, *args: Any) -> list[Tensor]:
        args = by_image(images, *args)
        of_each = [of.reference(x[None], *of_sample(b, *args)) for b, x in enumerate(images)]
        each = [_first(y)[0] for y in of_each]
        each = each if chosen is None else where_chosen(chosen, each, images)
        return each if of_channels is None else [*each, torch.cat([more for _, more in of_each])]

    def gradients(needs: Sequence[bool], grads: Any, *saved: Any) -> list[Any]:
        results, (images, chosen, *args) = (saved[:1], saved[1:]) if saves_results else ((), saved)
        needs = (needs[0], *needs[2:])  # but for `chosen`
        grads = [torch.zeros_like(x) if g is None else g for g, x in zip(grads, images)]
        own_images: Any = None
        if transposed is not None and needs[0]:
            own_images, needs = _OF_LISTS[transposed](grads, chosen, *args), (False, *needs[1:])
        elif of_images is not None and not any(needs[1:]):
            own_images, needs = of_images(grads, *results, images, chosen, *args), (False, *needs[1:])
        if not any(needs):
            return [own_images, None, *(None,) * (len(needs) - 1)]
        each, of_each = [], by_image(images, *args)
        for b, (g, x) in enumerate(zip(grads, images)):
            own, *others = of_batch(needs, g[None], x[None], *of_sample(b, *of_each))
            if chosen is not None:
                is_own = row(chosen, b) != 0
                own = None if own is None else torch.where(is_own, own, g[None])
                others = [None if t is None else torch.where(is_own, t, 0.0) for t in others]
            each.append((own, *others))
        found, *more = zip(*each)
        own_images = [g[0] for g in found] if needs[0] else own_images
        return [own_images, None, *(None if t[0] is None else _of_all(t, x) for t, x in zip(more, args))]

    operator = _register(name, of, reference, gradients, supports, saves_results=saves_results, of_channels=of_channels)
    _FILTERS.add(operator)
    if differentiates_batches:
        _DIFFERENTIATES_BATCHES.add(of)
    return operator


def _first(results: Any) -> Tensor:
    y: Tensor = results if isinstance(results, Tensor) else results[0]
    return y


def _of_all(each: Sequence[Tensor], like: Tensor) -> Tensor:
    """The gradient of a tensor with a row of each sample, or one row for all."""
    return torch.stack(list(each)).sum(0) if like.shape[0] == 1 else torch.cat(list(each))
