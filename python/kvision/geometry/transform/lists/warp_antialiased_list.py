"""Antialiased warps of lists of images by a matrix each: the operator `warp_antialiased` for one image after the other."""

from __future__ import annotations

import torch

from kvision._list_ops import ListOperator
from kvision.geometry.transform.antialiased import warp_antialiased as batches
from kvision.geometry.transform.lists import arguments as lists

# Arguments: those of `warp_list` without an interpolation.


def _reference(images, matrix, fill, size, *options):
    sizes = lists.sizes_of(size, len(images))
    results = [
        batches.warp_antialiased.reference(
            x[None], lists.row(matrix, b), lists.row(fill, b), None, next(sizes), *options
        )
        for b, x in enumerate(images)
    ]
    return lists.collected(results, images[0][None], size)


def _backward(needs, grads, images, matrix, fill, size, *options):
    """Image by image."""
    each = [
        batches.warp_antialiased.backward(
            needs, grad, x[None], lists.row(matrix, b), lists.row(fill, b), None, list(grad.shape[2:]), *options
        )
        for b, (grad, x) in enumerate(zip(lists.samples(grads), images))
    ]
    of_images, of_matrix, of_fill, _ = zip(*each)
    return (
        [own[0] for own in of_images] if needs[0] else None,
        torch.cat(of_matrix).sum_to_size(matrix.shape) if needs[1] else None,
        torch.cat(of_fill).sum_to_size(fill.shape) if needs[2] else None,
    )


warp_antialiased_list = ListOperator(
    "warp_antialiased_list",
    batches.warp_antialiased,
    _reference,
    fake=lambda images, matrix, fill, size, *options: lists.fake_results(images, size),
    backward=_backward,
)
