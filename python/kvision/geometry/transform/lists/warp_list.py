"""Warps of lists of images by a matrix each: the operator `warp` for one image after the other, in one launch."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision._choices import Interpolation, PaddingOrFill
from kvision._list_ops import ListOperator
from kvision._modes import INTERPOLATION, PADDING
from kvision.geometry.transform import sampling
from kvision.geometry.transform.lists import arguments as lists
from kvision.geometry.transform.lists.warp_antialiased_list import warp_antialiased_list

# Arguments: images (C, H, W), one for each sample; matrices and fills, as those of `warp`; height and width of the results, which
# are then one tensor (B, C, h, w), or of each result; the options of `warp`. The results are a sequence in both cases.


def _reference(images, matrix, fill, size, *options):
    sizes = lists.sizes_of(size, len(images))
    results = [
        sampling.warp.reference(x[None], lists.row(matrix, b), lists.row(fill, b), None, next(sizes), *options)
        for b, x in enumerate(images)
    ]
    return lists.collected(results, images[0][None], size)


def _backward(needs, grads, images, matrix, fill, size, *options):
    of_images = of_matrix = of_fill = None
    if needs[0]:
        of_images = warp_list_backward(grads, matrix, lists.sizes(images), *options)
    if needs[1] or needs[2]:
        samples = [
            (g, x[None], lists.row(matrix, b), lists.row(fill, b))
            for b, (g, x) in enumerate(zip(lists.samples(grads), images))
        ]
    if needs[1]:
        each = [sampling._warp_matrix_backward(*sample, None, *options) for sample in samples]
        of_matrix = torch.cat(each).sum_to_size(matrix.shape)
    if needs[2]:
        each = []
        for grad, x, m, f in samples:
            inside = sampling.warp(sampling._ones(x), m, None, None, list(grad.shape[2:]), *options)
            each.append(sampling._grad_fill(grad, inside, f))
        of_fill = torch.cat(each).sum_to_size(fill.shape)
    return of_images, of_matrix, of_fill


def _image_backward_reference(grads, matrix, size, *options):
    sizes = lists.sizes_of(size, len(size) // 2)
    return [
        sampling.warp_image_backward.reference(grad, lists.row(matrix, b), None, [1, *next(sizes)], *options)[0]
        for b, grad in enumerate(lists.samples(grads))
    ]


def _image_backward_backward(needs, grad_grads, grads, matrix, size, *options):
    of_grads = of_matrix = None
    if needs[0]:
        of_grads = warp_list(grad_grads, matrix, None, lists.shape_of(grads), *options)
    if needs[1]:
        sizes, each = lists.sizes_of(size, len(size) // 2), []
        for b, (grad_grad, grad) in enumerate(zip(grad_grads, lists.samples(grads))):
            args = (grad, lists.row(matrix, b), None, [1, *next(sizes)], *options)
            needed = (False, True, *[False] * (len(args) - 2))
            each.append(sampling.warp_image_backward.differentiate_reference(needed, grad_grad[None], *args)[1])
        of_matrix = torch.cat(each).sum_to_size(matrix.shape)
    return of_grads, of_matrix


def _adds_by_atomics(grads, matrix, size, interpolation, padding, *options):
    return grads[0].is_cuda and padding != PADDING["fill"]


warp_list = ListOperator(
    "warp_list",
    sampling.warp,
    _reference,
    fake=lambda images, matrix, fill, size, *options: lists.fake_results(images, size),
    backward=_backward,
)
warp_list_backward = ListOperator(
    "warp_list_backward",
    sampling.warp_image_backward,
    _image_backward_reference,
    fake=lambda grads, matrix, size, *options: [
        grads[0].new_empty(grads[0].shape[-3], *s) for s in lists.sizes_of(size, len(size) // 2)
    ],
    backward=_image_backward_backward,
    nondeterministic=_adds_by_atomics,
)


def warped(
    op: str,
    images: list[Tensor],
    name: str,
    matrix: Tensor,
    size: list[int],
    mode: Interpolation,
    padding_mode: PaddingOrFill,
    align_corners: bool,
    fill_value: Any = None,
    inverse: bool = False,
    is_list: bool = False,
    antialias: bool = False,
) -> Any:
    """Images warped by matrices `name`, from pixels of the result unless `inverse`; `size` has that of all or of each."""
    like, values = lists.like_batch(images), lists.as_value_list(images, mode)
    matrix = sampling.cast_to_image(op, values[0][None], name, matrix, len(images))
    padding, fill = sampling.padding_and_fill(op, like, padding_mode, fill_value, None, mode)
    options = (padding, align_corners, inverse, False)
    if antialias:
        results = warp_antialiased_list(values, matrix, fill, size, *options)
    else:
        results = warp_list(values, matrix, fill, size, INTERPOLATION[mode], *options)
    return lists.of_value_list(results, like, mode, is_list)
