"""Antialiased resizing of a window of each image of a list: the operator `resize_windows` for one image after the other."""

from __future__ import annotations

from kvision._list_ops import ListOperator
from kvision.geometry.transform import resize_windows
from kvision.geometry.transform.lists import arguments as lists

# Arguments: images (C, H, W), one for each sample; a matrix of each; height and width of the results, which are then one tensor
# (B, C, h, w), or of each result; the options of `resize_windows`. The results are a sequence in both cases.

_backward_of_batch = resize_windows.resized_windows_backward


def _reference(images, matrix, size, *options):
    sizes = lists.sizes_of(size, len(images))
    results = [
        resize_windows.resized_windows.reference(x[None], lists.row(matrix, b), next(sizes), *options)
        for b, x in enumerate(images)
    ]
    return lists.collected(results, images[0][None], size)


def _backward(needs, grads, images, matrix, size, *options):
    of_images = resize_windows_list_backward(grads, matrix, lists.sizes(images), *options) if needs[0] else None
    return of_images, None  # windows are whole pixels


def _image_backward_reference(grads, matrix, size, *options):
    sizes = lists.sizes_of(size, len(size) // 2)
    return [
        _backward_of_batch.reference(grad, lists.row(matrix, b), next(sizes), *options)[0]
        for b, grad in enumerate(lists.samples(grads))
    ]


def _image_backward_backward(needs, grad_grads, grads, matrix, size, *options):
    of_grads = resize_windows_list(grad_grads, matrix, lists.shape_of(grads), *options) if needs[0] else None
    return of_grads, None


resize_windows_list = ListOperator(
    "resize_windows_list",
    resize_windows.resized_windows,
    _reference,
    fake=lambda images, matrix, size, *options: lists.fake_results(images, size),
    backward=_backward,
)
resize_windows_list_backward = ListOperator(
    "resize_windows_list_backward",
    _backward_of_batch,
    _image_backward_reference,
    fake=lambda grads, matrix, size, *options: [
        grads[0].new_empty(grads[0].shape[-3], *s) for s in lists.sizes_of(size, len(size) // 2)
    ],
    backward=_image_backward_backward,
)
