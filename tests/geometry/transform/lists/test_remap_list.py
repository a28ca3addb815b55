"""Maps of lists of images: the bits of each image alone, and gradients to images, maps and fills."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from geometry.transform.lists.test_warp_list import TYPES, pictures
from kvision._dtype import compute_dtype
from kvision._modes import INTERPOLATION, PADDING
from kvision.geometry.transform import sampling
from kvision.geometry.transform.lists.remap_list import packed, packed_size, remap_list, remap_list_backward, unpacked
from op_tests import assert_close

SMALL = ((3, 4), (5, 2), (2, 2))


def displacements(images, by_channel=False):
    """A map of each image, or of each of its channels."""
    like = images[0]
    counts = [x.shape[0] if by_channel else 1 for x in images]
    sizes = [x.shape[1:] for x, n in zip(images, counts) for _ in range(n)]
    return [2 * torch.randn(2, *size, device=like.device).to(compute_dtype(like)) for size in sizes]


def alone(images, moved, fill, by_channel, *options):
    each = images[0].shape[0] if by_channel else 1
    results = []
    for b, x in enumerate(images):
        maps = torch.stack(moved[each * b : each * (b + 1)])
        own = fill if fill is None or len(fill) == 1 else fill[b : b + 1]
        own = own if own is None or not by_channel else own.expand(1, each).mT.contiguous()
        image = x[:, None] if by_channel else x[None]
        y = sampling.remap(image, maps[:, 0], maps[:, 1], own, None, *options, False, True)
        results.append(y[:, 0] if by_channel else y[0])
    return results


LAYOUTS = {
    "planes": lambda b, x: x.contiguous(),
    "pixels": lambda b, x: x.permute(1, 2, 0).contiguous().permute(2, 0, 1),
    "mixed": lambda b, x: x,
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("by_channel", [False, True])
@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("mode", ["bilinear", "nearest", "bicubic"])
def test_samples_are_those_of_single_images(mode, dtype, by_channel, layout, device):
    images = [LAYOUTS[layout](b, x) for b, x in enumerate(pictures(device, dtype))]
    moved = displacements(images, by_channel)
    fills = [None, torch.rand(1, 3, device=device), torch.rand(len(images), 1, device=device)]
    level = int(
        dtype == torch.uint8 and layout == "mixed"
    )  # results have the layout of the first image, and its rounding
    for padding, align_corners in (("fill", True), ("border", True), ("reflection", True), ("reflection", False)):
        for fill in fills if padding == "fill" else fills[:1]:
            fill = fill if fill is None else fill.to(moved[0].dtype)
            options = (INTERPOLATION[mode], PADDING[padding], align_corners)
            results = remap_list(images, packed(moved), fill, [], *options, by_channel)
            for y, expected in zip(results, alone(images, moved, fill, by_channel, *options)):
                assert_close(y, expected, 0, level)
            with K.backend("reference"):
                for y, expected in zip(results, remap_list(images, packed(moved), fill, [], *options, by_channel)):
                    assert_close(y, expected, atol=1 if dtype == torch.uint8 else 2e-2)


@pytest.mark.parametrize("by_channel", [False, True])
@pytest.mark.parametrize("padding", ["fill", "border"])
@pytest.mark.parametrize("dtype", TYPES[:4], ids=str)
def test_gradients_are_those_of_single_images(dtype, padding, by_channel, device):
    images = [x.requires_grad_() for x in pictures(device, dtype)]
    moved = [x.requires_grad_() for x in displacements(images, by_channel)]
    fill = torch.rand(1, 3, device=device, dtype=moved[0].dtype, requires_grad=True) if padding == "fill" else None
    tensors = [*images, *moved, *(() if fill is None else (fill,))]
    options = (INTERPOLATION["bilinear"], PADDING[padding], True)
    results = remap_list(images, packed(moved), fill, [], *options, by_channel)
    weights = [torch.rand_like(y) for y in results]
    gradients = torch.autograd.grad(sum((y * w).sum() for y, w in zip(results, weights)), tensors)
    expected = alone(images, moved, fill, by_channel, *options)
    own = torch.autograd.grad(sum((y * w).sum() for y, w in zip(expected, weights)), tensors)
    tolerance = 1e-4 if dtype in (torch.float32, torch.float64) else 3e-2
    for a, b in zip(gradients, own):
        assert_close(a, b, tolerance, tolerance)


def coordinates(images, sizes):
    """Those of results of these sizes, some beyond the images."""
    dtype = compute_dtype(images[0])
    each = []
    for x, size in zip(images, sizes):
        last = torch.tensor(x.shape[:0:-1], dtype=dtype, device=x.device).view(2, 1, 1)
        each.append((1.2 * torch.rand(2, *size, dtype=dtype, device=x.device) - 0.1) * last)
    return each


RESULTS = ((7, 40), (20, 9), (33, 33), (3, 2), (1, 1))


@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("mode", ["bilinear", "nearest", "bicubic"])
def test_results_of_other_sizes_read_coordinates(mode, dtype, device):
    images = [x.requires_grad_(dtype.is_floating_point) for x in pictures(device, dtype)]
    read = coordinates(images, RESULTS)
    sizes, options = [n for size in RESULTS for n in size], (INTERPOLATION[mode], PADDING["fill"], True)
    fill = torch.rand(len(images), 1, device=device).to(read[0].dtype)
    results = remap_list(images, packed(read), fill, sizes, *options, False)
    level = int(dtype == torch.uint8)
    expected = [
        sampling.remap(x[None], *own[:, None], fill[b : b + 1], None, *options, False, False)[0]
        for b, (x, own) in enumerate(zip(images, read))
    ]
    for y, alone in zip(results, expected, strict=True):
        assert_close(y, alone, 0, level)
    with K.backend("reference"):
        for y, alone in zip(remap_list(images, packed(read), fill, sizes, *options, False), expected):
            assert_close(y, alone, atol=1 if dtype == torch.uint8 else 2e-2)
    if dtype.is_floating_point and mode != "nearest":
        own, alone = (torch.autograd.grad(sum(y.square().sum() for y in ys), images) for ys in (results, expected))
        tolerance = 1e-4 if dtype in (torch.float32, torch.float64) else 3e-2
        for a, b in zip(own, alone):
            assert_close(a, b, tolerance, tolerance)


@pytest.mark.derivatives
def test_derivatives_of_coordinates(device):
    images = [x.detach().requires_grad_() for x in pictures(device, torch.float64, SMALL, 2)]
    sizes = ((2, 3), (3, 1), (4, 2))
    read = [x.requires_grad_() for x in coordinates(images, sizes)]
    options = ([n for size in sizes for n in size], INTERPOLATION["bicubic"], PADDING["border"], True, False)

    def mapped(*tensors):
        return tuple(remap_list(list(tensors[:3]), packed(tensors[3:]), None, *options))

    assert torch.autograd.gradcheck(mapped, (*images, *read))
    assert torch.autograd.gradgradcheck(mapped, (*images, *read), atol=1e-4)


@pytest.mark.derivatives
@pytest.mark.parametrize("by_channel", [False, True])
def test_derivatives(by_channel, device):
    images = [x.detach().requires_grad_() for x in pictures(device, torch.float64, SMALL, 2)]
    moved = [x.requires_grad_() for x in displacements(images, by_channel)]
    fill = torch.tensor([[0.3, 0.7]], dtype=torch.float64, device=device, requires_grad=True)
    options = (INTERPOLATION["bicubic"], PADDING["fill"], True)

    def mapped(fill, *tensors):
        return tuple(remap_list(list(tensors[:3]), packed(tensors[3:]), fill, [], *options, by_channel))

    assert torch.autograd.gradcheck(mapped, (fill, *images, *moved))
    assert torch.autograd.gradgradcheck(mapped, (fill, *images, *moved), atol=1e-4)


def test_long_lists_are_those_of_their_parts(device):
    images = pictures(device, sizes=[(4 + i % 7, 5 + i % 3) for i in range(520)])
    for by_channel in (False, True):
        moved, each = displacements(images, by_channel), 3 if by_channel else 1
        options = (INTERPOLATION["bilinear"], PADDING["border"], True, by_channel)
        results = remap_list(images, packed(moved), None, [], *options)
        last = remap_list(images[510:], packed(moved[510 * each :]), None, [], *options)
        assert all(map(torch.equal, results[510:], last))
        grads = remap_list_backward(images, packed(moved), [], *options)
        for a, b in zip(grads[510:], remap_list_backward(images[510:], packed(moved[510 * each :]), [], *options)):
            assert_close(a, b, 1e-5, 1e-5)


def test_packed_maps():
    maps = [torch.rand(2, 3, 5), torch.rand(2, 1, 1), torch.rand(2, 4, 4)]
    assert all(map(torch.equal, unpacked(packed(maps), [3, 5, 1, 1, 4, 4]), maps))


def test_arguments(device):
    images = pictures(device)
    moved = packed(displacements(images))
    with pytest.raises(RuntimeError, match="expected maps of shape"):
        torch.ops.kvision.remap_list(images, moved[1:], None, [], INTERPOLATION["bilinear"], 0, True, False)
    with pytest.raises(RuntimeError, match="expected images"):
        torch.ops.kvision.remap_list(
            [images[0], images[1].half()], moved, None, [], INTERPOLATION["bilinear"], 0, True, False
        )


def test_maps_of_a_list_are_one_tensor(device):
    sizes = [(3, 4), (5, 2), (16, 8), (1, 1)]
    maps = [torch.rand(2, *size, device=device) for size in sizes]
    sides = [n for size in sizes for n in size]
    assert len(packed(maps)) == packed_size(sides)
    assert all(map(torch.equal, unpacked(packed(maps), sides), maps))
