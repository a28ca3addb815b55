"""Operators on batches that warp images by a matrix each, as operators on lists of images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._list_ops import ListOperator
from kvision._ops import Operator
from kvision.geometry.transform import sampling
from kvision.geometry.transform.lists import arguments as lists
from kvision.geometry.transform.lists.kept_sizes import register_list_backward


def register_warp(
    name: str, of: Operator, image_gradient: Operator, matrix_gradient: Operator, nondeterministic: Callable[..., bool]
) -> tuple[ListOperator, ListOperator, ListOperator]:
    """An operator on lists, and those that give its gradients: `<name>_backward` of the images, `<name>_matrix_backward`.

    The arguments of `name` are images (C, H, W), one for each sample; matrices and fills, as those of `warp`; height and width of
    the results, which are then one tensor (B, C, h, w), or of each result; options. The results are a sequence in both cases.

    Args:
        name: name of the operator, `torch.ops.kvision.<name>`.
        of: the operator on batches.
        image_gradient: the operator on batches that gives the gradients of images.
        matrix_gradient: and of matrices.
        nondeterministic: whether the gradients of images may have other bits on a second run, from the arguments.
    """

    def reference(images, matrix, fill, size, *options):
        sizes = lists.sizes_of(size, len(images))
        results = [
            of.reference(x[None], lists.row(matrix, b), lists.row(fill, b), None, next(sizes), *options)
            for b, x in enumerate(images)
        ]
        return lists.collected(results, images[0][None], size)

    def backward(needs, grads, images, matrix, fill, size, *options):
        of_images = of_matrix = of_fill = None
        if needs[0]:
            of_images = image_backward(grads, matrix, lists.sizes(images), *options)
        if needs[1]:
            (each,) = matrix_backward([*images, *grads], matrix, fill, *options)
            of_matrix = each.sum_to_size(matrix.shape)
        if needs[2]:
            inside = warp([sampling._ones(x[None])[0] for x in images], matrix, None, size, *options)
            if grads[0].dim() == 4:
                of_fill = sampling._grad_fill(grads[0], inside[0], fill)
            else:
                own = [
                    sampling._grad_fill(grad[None], y[None], lists.row(fill, b))
                    for b, (grad, y) in enumerate(zip(grads, inside))
                ]
                of_fill = torch.cat(own).sum_to_size(fill.shape)
        return of_images, of_matrix, of_fill

    warp = ListOperator(
        name,
        of,
        reference,
        fake=lambda images, matrix, fill, size, *options: lists.fake_results(images, size),
        backward=backward,
    )

    # Arguments: gradients, one tensor (B, C, h, w) or one of each result; matrices; height and width of each image; options.
    def image_reference(grads, matrix, size, *options):
        sizes = lists.sizes_of(size, len(size) // 2)
        return [
            image_gradient.reference(grad, lists.row(matrix, b), None, [1, *next(sizes)], *options)[0]
            for b, grad in enumerate(lists.samples(grads))
        ]

    def image_vjp(needs, grad_grads, grads, matrix, size, *options):
        of_grads = of_matrix = None
        if needs[0]:
            of_grads = warp(grad_grads, matrix, None, lists.shape_of(grads), *options)
        if needs[1]:
            sizes, each = lists.sizes_of(size, len(size) // 2), []
            for b, (grad_grad, grad) in enumerate(zip(grad_grads, lists.samples(grads))):
                args = (grad, lists.row(matrix, b), None, [1, *next(sizes)], *options)
                needed = (False, True, *[False] * (len(args) - 2))
                each.append(image_gradient.differentiate_reference(needed, grad_grad[None], *args)[1])
            of_matrix = torch.cat(each).sum_to_size(matrix.shape)
        return of_grads, of_matrix

    image_backward = ListOperator(
        f"{name}_backward",
        image_gradient,
        image_reference,
        fake=lambda grads, matrix, size, *options: [
            grads[0].new_empty(grads[0].shape[-3], *s) for s in lists.sizes_of(size, len(size) // 2)
        ],
        backward=image_vjp,
        nondeterministic=nondeterministic,
    )

    # Arguments: images, and behind them the gradients, as above; matrices; fills; options. The result is that of all matrices.
    def matrix_reference(images_and_grads, matrix, fill, *options):
        images, grads = lists.halves(images_and_grads)
        each = [
            matrix_gradient.reference(grad, x[None], lists.row(matrix, b), lists.row(fill, b), None, *options)
            for b, (grad, x) in enumerate(zip(lists.samples(grads), images))
        ]
        return [torch.cat(each)]

    def matrix_fake(images_and_grads: Sequence[Tensor], matrix: Tensor, *args: Any) -> list[Tensor]:
        images, _ = lists.halves(images_and_grads)
        return [matrix.new_empty(len(images), *matrix.shape[1:])]

    matrix_backward = register_list_backward(
        f"{name}_matrix_backward", matrix_gradient, matrix_reference, fake=matrix_fake
    )
    return warp, image_backward, matrix_backward
