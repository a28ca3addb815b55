"""Antialiased resizing of windows: kernels against their definition, and both against torch and `resize`."""

from __future__ import annotations

from itertools import product

import pytest
import torch
import torch.nn.functional as F

import kvision as K
from kvision._constants import constant
from kvision._dtype import compute_dtype, pixels
from kvision._modes import INTERPOLATION
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry.transform.resize_windows import resized_windows
from op_tests import OpTests, assert_close, pairwise


def matrices(boxes, flips, size, align_corners, dtype=torch.float32):
    """From pixels of the images to those of the results, for boxes x, y, width, height and flips (x, y) of each sample."""
    boxes, signs = torch.as_tensor(boxes).double(), 1.0 - 2 * torch.as_tensor(flips).double()
    first, extent, result = boxes[:, :2], boxes[:, 2:], constant((size[1], size[0]), boxes)
    if align_corners:
        half, scale = 0.0, (result - 1).clamp(min=2**-20) / (extent - 1).clamp(min=2**-20)
    else:
        half, scale = 0.5, result / extent
    offset = (half - first) * scale - half
    offset = torch.where(signs < 0, result - 1 - offset, offset)
    last_row = constant(((0.0, 0.0, 1.0),), boxes).expand(len(boxes), 1, 3)
    matrix = torch.cat([torch.diag_embed(signs * scale), offset[..., None]], 2)
    return torch.cat([matrix, last_row], 1).to(dtype)


def boxes_within(height, width, count, seed=3):
    """Boxes of many sizes; the first one is the whole image, and the last one a pixel."""
    boxes = [(0, 0, width, height)]
    for i in range(1, count - 1):
        w, h = (1 + (i + seed) * factor % n for factor, n in ((7, width), (11, height)))
        boxes.append(((i + seed) * 5 % (width - w + 1), (i + seed) * 3 % (height - h + 1), w, h))
    return [*boxes, (width - 1, height // 2, 1, 1)][:count]


def boxes_and_flips(x):
    count = x.shape[0]
    flips = torch.tensor([(i % 2, i % 3 == 1) for i in range(count)], dtype=torch.int64).reshape(count, 2)
    return torch.cat([torch.tensor(boxes_within(*x.shape[-2:], count)).reshape(count, 4), flips], 1)


def resize_parts(input, boxes, size, filter="bilinear", align_corners=False):
    """The operator with the checks of its callers."""
    if not isinstance(input, torch.Tensor) or input.is_complex():
        raise TypeCheckError("resize_parts: expected images")
    if input.dim() != 4 or 0 in input.shape[2:]:
        raise ShapeError("resize_parts: expected images of shape (B, C, H, W)")
    x = pixels(input)
    matrix = matrices(boxes[:, :4], boxes[:, 4:], size, align_corners, compute_dtype(x))
    return resized_windows(x, matrix, list(size), INTERPOLATION[filter], align_corners)


class TestResizeWindows(OpTests):
    function = staticmethod(resize_parts)
    operators = ("resize_windows", "resize_windows_backward")
    bytes = True
    max_size = 9
    shape = (4, 3, 13, 18)
    small = (3, 2, 4, 5)
    # Weights are fractions of small integers, so many means are halfway between two bytes.
    tolerances = {torch.uint8: (0, 1)}
    # An image and its result may differ in size.
    accepted = ("image cut along axis -1", "image cut along axis -2")
    variants = [
        {"boxes": boxes_and_flips, "size": (7, 9)},
        {"boxes": boxes_and_flips, "size": (20, 5), "align_corners": True},
        {"boxes": boxes_and_flips, "size": (5, 27), "filter": "bicubic"},
        {"boxes": boxes_and_flips, "size": (3, 30), "filter": "lanczos", "align_corners": True},
        {"boxes": boxes_and_flips, "size": (1, 1), "filter": "bicubic", "align_corners": True},
    ]


@pytest.mark.parametrize(
    ("interpolation", "corners", "size"),
    pairwise(
        list(product([torch.float32, torch.float16, torch.uint8], ["bilinear", "bicubic", "lanczos"])),
        list(product([False, True], [(False, False), (True, False), (True, True)])),
        [(30, 36), (24, 22), (50, 70), (1, 7), (3, 1)],
    ),
    ids=str,
)
def test_equals_resize_of_each_window(interpolation, corners, size, device):
    """In one batch some windows shrink and others grow, in any layout; and so do the gradients."""
    (dtype, filter), (align_corners, flips) = interpolation, corners
    generator = torch.Generator().manual_seed(size[0])
    x = torch.rand(6, 3, 41, 53, generator=generator)
    x = ((255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)).to(device)
    boxes = boxes_within(41, 52, 6, size[0])
    matrix = matrices(boxes, [flips] * 6, size, align_corners).to(device)
    weights = torch.rand(6, 3, *size, generator=generator).to(device)
    axes = [3 - a for a in range(2) if flips[a]]
    for layout in (torch.contiguous_format, torch.channels_last):
        whole = x.contiguous(memory_format=layout)
        for images in (whole, whole[..., :52], whole[..., 1:]):
            images = images.detach().requires_grad_(dtype == torch.float32)
            y = resized_windows(images, matrix, list(size), INTERPOLATION[filter], align_corners)
            parts = [
                K.geometry.resize(image[None, :, b : b + h, a : a + w], size, filter, align_corners, antialias=True)
                for image, (a, b, w, h) in zip(images, boxes)
            ]
            expected = torch.cat(parts).flip(axes)
            tolerance = {torch.float32: 4e-6, torch.float16: 2e-3, torch.uint8: 1}[dtype]
            assert_close(y, expected, tolerance if dtype != torch.uint8 else 0, tolerance)
            if dtype == torch.float32:
                (grad,) = torch.autograd.grad((y * weights).sum(), images)
                (expected_grad,) = torch.autograd.grad((expected * weights).sum(), images)
                assert_close(grad, expected_grad, 2e-5, 2e-5)


@pytest.mark.parametrize("mode", ["bilinear", "bicubic"])
@pytest.mark.parametrize("size", [(12, 15), (45, 20), (224, 37)], ids=str)
def test_values_and_gradients_of_torch(mode, size, device):
    x = torch.rand(5, 2, 64, 100, dtype=torch.float64)
    boxes = boxes_within(64, 100, 5)
    matrix = matrices(boxes, [(False, False)] * 5, size, False, torch.float64)
    a, b = x.clone().requires_grad_(), x.to(device, copy=True).requires_grad_()
    crops = [image[None, :, y : y + h, x : x + w] for image, (x, y, w, h) in zip(a, boxes)]
    expected = torch.cat([F.interpolate(crop, size, mode=mode, antialias=True) for crop in crops])
    weights = torch.rand(expected.shape, dtype=torch.float64)
    (expected * weights).sum().backward()
    result = resized_windows(b, matrix.to(device), list(size), INTERPOLATION[mode], False)
    (result * weights.to(device)).sum().backward()
    assert_close(result.cpu(), expected, 1e-12, 1e-12)
    assert_close(b.grad.cpu(), a.grad, 1e-11, 1e-11)
    for dtype, tolerance in ((torch.float32, 4e-6), (torch.float16, 2e-3), (torch.bfloat16, 2e-2)):
        single = x.to(dtype)
        result = resized_windows(single.to(device), matrix.float().to(device), list(size), INTERPOLATION[mode], False)
        crops = [image[None, :, y : y + h, x : x + w].double() for image, (x, y, w, h) in zip(single, boxes)]
        expected = torch.cat([F.interpolate(crop, size, mode=mode, antialias=True) for crop in crops])
        assert_close(result.double().cpu(), expected, tolerance, tolerance)


# Wide images have narrow tiles; windows of few pixels have many weights backward; the last ones take no tiles.
@pytest.mark.native
@pytest.mark.parametrize(
    "shape, size",
    [
        ((3, 3, 256, 256), (224, 224)),
        ((2, 1, 300, 1300), (32, 50)),
        ((3, 9, 24, 20), (300, 260)),
        ((2, 2, 40, 5), (7, 700)),
        ((2, 70, 30, 33), (20, 25)),
        ((2, 1, 6, 9000), (4, 9000)),
    ],
    ids=str,
)
@pytest.mark.parametrize("filter", ["bilinear", "bicubic"])
def test_tiles(filter, shape, size, device):
    """Kernels equal the definition, forward and backward, for tiles of all kinds."""
    generator = torch.Generator().manual_seed(shape[3])
    boxes = boxes_within(*shape[2:], shape[0], shape[3])
    matrix = matrices(boxes, [(True, False), (False, True), (True, True)][: shape[0]], size, False).to(device)
    for layout in (torch.contiguous_format, torch.channels_last):
        x = torch.rand(shape, generator=generator).to(device).contiguous(memory_format=layout).requires_grad_()
        y = resized_windows(x, matrix, list(size), INTERPOLATION[filter], False)
        with K.backend("reference"):
            expected = resized_windows(x, matrix, list(size), INTERPOLATION[filter], False)
        assert_close(y, expected, 1e-5, 1e-5)
        grad = torch.rand(y.shape, generator=generator).to(device).contiguous(memory_format=layout)
        (result,) = torch.autograd.grad(y, x, grad, retain_graph=True)
        with K.backend("reference"):
            (expected,) = torch.autograd.grad(expected, x, grad)
        assert_close(result, expected, 1e-4, 1e-4)
        for number in (0.7, float("inf")):  # as the gradient of a sum
            same = torch.full((), number, device=device).expand(y.shape)
            of_number, of_all = (torch.autograd.grad(y, x, g, retain_graph=True)[0] for g in (same, same.contiguous()))
            assert_close(of_number, of_all, 0.0, 0.0)


@pytest.mark.parametrize("width, columns", [(70_000, 16_000), (400_000, 3_000)])
def test_products_of_long_sides_exceed_32_bits(width, columns, device):
    a = torch.rand(1, 1, 3, width, dtype=torch.float64, requires_grad=True)
    b = a.detach().to(device, torch.float32).requires_grad_()
    matrix = matrices([(0, 0, width, 3)], [(False, False)], (2, columns), False).to(device)
    expected = F.interpolate(a, (2, columns), mode="bilinear", antialias=True)
    result = resized_windows(b, matrix, [2, columns], INTERPOLATION["bilinear"], False)
    assert_close(result.double().cpu(), expected, 1e-5, 1e-5)
    grad = torch.rand(expected.shape, dtype=torch.float64)
    expected.backward(grad)
    result.backward(grad.to(device, torch.float32))
    assert_close(b.grad.double().cpu(), a.grad, 1e-5, 1e-5)


def test_numbers_out_of_a_window_are_harmless(device):
    """Also those next to it, which share its vectors."""
    x = torch.full((2, 1, 16, 16), float("nan"), device=device)
    x[0, :, 3:9, 5:12], x[1, :, 2:3, 7:8] = 0.5, 0.25
    matrix = matrices([(5, 3, 7, 6), (7, 2, 1, 1)], [(False, True), (True, False)], (8, 9), False).to(device)
    for filter in ("bilinear", "bicubic"):
        y = resized_windows(x, matrix, [8, 9], INTERPOLATION[filter], False)
        assert_close(y, torch.tensor([0.5, 0.25], device=device).reshape(2, 1, 1, 1).expand_as(y))


def test_a_window_of_the_size_of_the_result_is_copied(device):
    x = torch.rand(2, 3, 30, 40, device=device)
    x[0, 0, 4, 5] = float("inf")
    matrix = matrices([(3, 2, 20, 16), (11, 9, 20, 16)], [(False, False), (True, True)], (16, 20), True).to(device)
    y = resized_windows(x, matrix, [16, 20], INTERPOLATION["bilinear"], True)
    assert torch.equal(y[0], x[0, :, 2:18, 3:23]) and torch.equal(y[1], x[1, :, 9:25, 11:31].flip(1, 2))


@pytest.mark.parametrize("numbers", [(float("nan"), 0.0), (0.0, 0.0), (1e-30, 1e30), (-1e30, float("inf"))], ids=str)
def test_windows_stay_within_the_image(numbers, device):
    """Matrices that map nothing to the result read pixels all the same, and both definitions the same ones."""
    scale, offset = numbers
    x = torch.rand(1, 2, 9, 11, device=device)
    matrix = torch.tensor([[[scale, 0, offset], [0, 1, 0], [0, 0, 1]]], device=device)
    for align_corners in (False, True):
        y = resized_windows(x, matrix, [4, 5], INTERPOLATION["bilinear"], align_corners)
        assert y.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16])
def test_tiles_of_any_height_give_the_same_bits(dtype, device):
    """The more images, the more rows a tile has."""
    x = torch.rand(1, 3, 40, 36, generator=torch.Generator().manual_seed(0)).to(device, dtype)
    for size, box in (((96, 80), (3, 2, 31, 37)), ((17, 23), (0, 1, 36, 38))):
        matrix = matrices([box], [(1, 0)], size, False).to(device)
        one = resized_windows(x, matrix, list(size), INTERPOLATION["bilinear"], False)
        for count in (40, 400):
            many = resized_windows(x.expand(count, -1, -1, -1), matrix, list(size), INTERPOLATION["bilinear"], False)
            assert torch.equal(many, one.expand_as(many)), (size, count)
