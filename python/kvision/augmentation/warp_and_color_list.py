"""One pass over a list of images of different sizes: `warp_and_color`, whose warp makes them a batch, or whose results are a list.

The operators give what `warp_and_color` gives for each image alone. Their gradients are those of a warp of a list and of color
programs behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision._ops import match_layout
from kvision.augmentation import transforms
from kvision.augmentation import warp_and_color as batches
from kvision.geometry.transform.lists import arguments as lists
from kvision.geometry.transform.lists.kept_sizes import register_list_backward
from kvision.geometry.transform.lists.resize_windows_list import resize_windows_list, resize_windows_list_backward
from kvision.geometry.transform.lists.warp_list import warp_list, warp_list_backward, warp_list_matrix_backward

# Arguments: images (C, H, W), and those of `warp_and_color`; the size is not empty.


def _like(images: Sequence[Tensor]) -> Tensor:
    """(B, C, H, W) of the type, device and layout of a list."""
    return images[0][None].detach().expand(len(images), -1, -1, -1)


def _reference(
    images: Sequence[Tensor],
    columns: Tensor | None,
    fill: Tensor | None,
    size: Sequence[int],
    plan: Sequence[int],
    numbers: Sequence[float],
) -> tuple[Tensor, Tensor, Tensor]:
    each = [
        batches.warp_and_color.reference(x[None], lists.row(columns, b), lists.row(fill, b), size, plan, numbers)
        for b, x in enumerate(images)
    ]
    y, matrix, mean = (torch.cat(parts) for parts in zip(*each))
    return match_layout(y, each[0][0]), matrix, mean


def _fake(images, columns, fill, size, plan, numbers):
    return batches._fake(_like(images), columns, fill, size, plan, numbers)


def _backward(needs, grads, results, images, columns, fill, size, plan, numbers):
    grad, (y, matrix, mean), parts = grads[0], results, batches._parse(plan, numbers)
    if needs[2] or y.dtype == torch.uint8 or images[0].dtype == torch.uint8:
        return _differentiate_reference(needs, grad, images, columns, fill, size, plan, numbers)
    if grad is None:
        grad = torch.zeros_like(y)
    options, of_columns = (*parts.sampling, True, False), None
    if parts.steps or grad.dtype != images[0].dtype:
        if parts.antialias:
            (sampled,) = resize_windows_list(images, matrix, list(size), parts.sampling[0], parts.sampling[2])
        else:
            (sampled,) = warp_list(images, matrix, fill, list(size), *options)
        arguments = (columns, None, matrix[:, :0], mean, [], parts.plan_of_steps, parts.numbers)
        grad, of_columns, _ = batches._warp_and_color_backward(grad, sampled, *arguments, True, needs[1])
    of_images = None
    if needs[0] and parts.antialias:
        of_images = resize_windows_list_backward(
            [grad], matrix, lists.sizes(images), parts.sampling[0], parts.sampling[2]
        )
    elif needs[0]:
        of_images = warp_list_backward([grad], matrix, lists.sizes(images), *options)
    if not needs[1]:
        return of_images, None, None
    if parts.antialias:  # windows are whole pixels
        of_matrix = torch.zeros_like(matrix)
    else:
        (of_matrix,) = warp_list_matrix_backward([*images, grad], matrix, fill, *options)
    of_chain = transforms._transform_matrix_backward(of_matrix, columns, parts.transforms, parts.transform_numbers)
    return of_images, of_chain if of_columns is None or not of_columns.shape[1] else of_chain + of_columns, None


def _differentiate_reference(
    needs: Any, grad: Tensor | None, images: Any, columns: Tensor | None, fill: Tensor | None, *rest: Any
) -> tuple[Any, ...]:
    """The gradients where no kernel has them: of fill values, and of results rounded to bytes."""
    count, given = len(images), [x for x in (columns, fill) if x is not None]

    def result(*tensors: Tensor) -> Tensor:
        others = iter(tensors[count:])
        own = (None if x is None else next(others) for x in (columns, fill))
        return _reference(tensors[:count], next(own), next(own), *rest)[0]

    y, vjp_fn = torch.func.vjp(result, *images, *given)  # type: ignore[misc]
    of_all: Any = vjp_fn(torch.zeros_like(y) if grad is None else grad.to(y.dtype))
    others = iter(of_all[count:])
    return list(of_all[:count]), *(None if x is None else next(others) for x in (columns, fill))


warp_and_color_list = ListOperator(
    "warp_and_color_list",
    batches.warp_and_color,
    _reference,
    fake=_fake,
    backward=_backward,
    saves_results=True,
    non_differentiable=(1, 2),
    supports=lambda images, *args: batches._supports(_like(images), *args),
    nondeterministic=lambda images, columns, fill, size, plan, numbers: (
        images[0].is_cuda and plan[3] != batches.PADDING["fill"] and not plan[5] and images[0].is_floating_point()
    ),
)

# --- lists of results -----------------------------------------------------------------------------------------------

# Arguments: images (C, H, W), columns and fill of `warp_and_color`, whether there is a warp, height and width of each of its
# results, none for those of the images, plan and numbers. The matrices and the means follow the results.


def _sizes(images: Sequence[Tensor], warps: bool, sizes: Sequence[int]) -> list[list[int]]:
    """The argument `size` of `warp_and_color` of each image."""
    if not warps:
        return [[]] * len(images)
    return list(lists.sizes_of(sizes, len(images))) if sizes else [list(x.shape[-2:]) for x in images]


def _list_reference(
    images: Sequence[Tensor],
    columns: Tensor | None,
    fill: Tensor | None,
    warps: bool,
    sizes: Sequence[int],
    plan: Sequence[int],
    numbers: Sequence[float],
) -> list[Tensor]:
    each = [
        batches.warp_and_color.reference(x[None], lists.row(columns, b), lists.row(fill, b), size, plan, numbers)
        for b, (x, size) in enumerate(zip(images, _sizes(images, warps, sizes)))
    ]
    results, matrices, means = zip(*each)
    return [*(y[0] for y in results), torch.cat(matrices), torch.cat(means)]


def _list_fake(images, columns, fill, warps, sizes, plan, numbers):
    own = _sizes(images, warps, sizes)
    each = [batches._fake(x[None], None, fill, size, plan, numbers) for x, size in zip(images, own)]
    _, matrix, mean = batches._fake(_like(images), columns, fill, own[0], plan, numbers)
    return [*(y[0] for y, *_ in each), matrix, mean]


def _list_backward(needs, grads, results, images, columns, fill, warps, sizes, plan, numbers):
    *ys, matrix, mean = results
    parts, count = batches._parse(plan, numbers), len(images)
    grads = [torch.zeros_like(y) if g is None else g for g, y in zip(grads[:count], ys)]
    if needs[2] or ys[0].dtype == torch.uint8 or images[0].dtype == torch.uint8:
        return _differentiate_list_reference(needs, grads, images, columns, fill, warps, sizes, plan, numbers)
    options, of_columns = (*parts.sampling, True, False), None
    if parts.steps or grads[0].dtype != images[0].dtype:
        if warps and parts.antialias:
            sampled = resize_windows_list(images, matrix, lists.sizes(ys), parts.sampling[0], parts.sampling[2])
        else:
            sampled = warp_list(images, matrix, fill, lists.sizes(ys), *options) if warps else images
        sampled = lists.images_of(sampled)
        if needs[1]:
            none, of_each = matrix[:, :0], []
            for b, (g, x) in enumerate(zip(grads, sampled)):
                arguments = (lists.row(columns, b), None, none[b : b + 1], mean[b : b + 1], [])
                of_each.append(
                    batches._warp_and_color_backward(
                        g[None], x[None], *arguments, parts.plan_of_steps, parts.numbers, True, True
                    )
                )
            grads = [of_image[0] for of_image, *_ in of_each]
            of_columns = torch.cat([own for _, own, _ in of_each])
        else:
            means = mean if mean.shape[1] else None
            grads = color_list_backward([*sampled, *grads], columns, means, parts.plan_of_steps, parts.numbers)
    of_images = None
    if needs[0]:
        of_images = grads
        if warps and parts.antialias:
            of_images = resize_windows_list_backward(
                grads, matrix, lists.sizes(images), parts.sampling[0], parts.sampling[2]
            )
        elif warps:
            of_images = warp_list_backward(grads, matrix, lists.sizes(images), *options)
    if not needs[1]:
        return of_images, None, None
    if not warps or parts.antialias:  # windows are whole pixels
        return of_images, torch.zeros_like(columns) if of_columns is None else of_columns, None
    (of_matrix,) = warp_list_matrix_backward([*images, *grads], matrix, fill, *options)
    of_chain = transforms._transform_matrix_backward(of_matrix, columns, parts.transforms, parts.transform_numbers)
    return of_images, of_chain if of_columns is None or not of_columns.shape[1] else of_chain + of_columns, None


def _colors_of_each(
    images_and_grads: Sequence[Tensor], columns: Tensor | None, means: Tensor | None, plan: Any, numbers: Any
) -> Iterator[tuple[Any, ...]]:
    """The arguments of the gradient of a batch, for each image."""
    images, grads = lists.halves(images_and_grads)
    for b, (x, g) in enumerate(zip(images, grads)):
        mean = x.new_empty(1, 0, dtype=compute_dtype(x)) if means is None else lists.row(means, b)
        yield g[None], x[None], lists.row(columns, b), None, mean[:, :0], mean, [], plan, numbers, True, False


def _colors_reference(images_and_grads, *args):
    each = _colors_of_each(images_and_grads, *args)
    return [batches._warp_and_color_backward.reference(*own)[0][0] for own in each]


# The gradients of images of a program of color steps. Arguments: the images (C, H, W), then the gradients of the results; columns,
# means of contrast or None, plan and numbers, as those of `warp_and_color`.
color_list_backward = register_list_backward(
    "color_list_backward",
    batches._warp_and_color_backward,
    _colors_reference,
    lambda images_and_grads, columns, means, plan, numbers: batches._unsupported_channels(
        images_and_grads[0][None], plan
    ),
)


def _differentiate_list_reference(
    needs: Any, grads: Sequence[Tensor], images: Any, columns: Tensor | None, fill: Tensor | None, *rest: Any
) -> tuple[Any, ...]:
    count, given = len(images), [x for x in (columns, fill) if x is not None]

    def result(*tensors: Tensor) -> tuple[Tensor, ...]:
        others = iter(tensors[count:])
        own_columns, own_fill = (None if x is None else next(others) for x in (columns, fill))
        return tuple(_list_reference(tensors[:count], own_columns, own_fill, *rest)[:count])

    ys, vjp_fn = torch.func.vjp(result, *images, *given)  # type: ignore[misc]
    of_all: Any = vjp_fn(tuple(g.to(y.dtype) for g, y in zip(grads, ys)))
    others = iter(of_all[count:])
    return list(of_all[:count]), *(None if x is None else next(others) for x in (columns, fill))


def _list_supports(
    images: Sequence[Tensor], columns: Any, fill: Any, warps: bool, sizes: Any, plan: Any, numbers: Any
) -> str | None:
    size = images[0].shape[-2:] if warps else []
    return batches._supports(_like(images), columns, fill, size, plan, numbers)


warp_and_color_to_list = ListOperator(
    "warp_and_color_to_list",
    batches.warp_and_color,
    _list_reference,
    fake=_list_fake,
    backward=_list_backward,
    saves_results=True,
    non_differentiable=(-2, -1),
    supports=_list_supports,
    nondeterministic=lambda images, columns, fill, warps, sizes, plan, numbers: (
        images[0].is_cuda and bool(warps) and plan[3] != batches.PADDING["fill"] and images[0].is_floating_point()
    ),
)
