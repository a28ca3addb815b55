"""Large images whose rows and planes are not aligned: odd sizes, slices, channels_last. Pointwise functions give the same
bits as for the same pixels in an aligned image; reductions agree with the reference.

Small sizes of every operator are swept by its own suite. These cases reach what kernels do with many vectors, blocks
and planes: peeled ends, single elements of neighboring threads, planes of a pixel that are aligned differently.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import kvision
from benchmarks.sample_calls.windows import WINDOWS
from kvision import contrib, enhance, geometry, losses, metrics
from kvision.geometry import transform
from op_tests import named, pairwise

pytestmark = [pytest.mark.native, pytest.mark.large]

SHAPES = [(2, 3, 335, 513), (5, 3, 67, 299), (3, 3, 64, 126)]
DTYPES = [torch.float32, torch.float16, torch.bfloat16]


def camera(x: Tensor) -> Tensor:
    return torch.tensor([[[400.0, 0, 250], [0, 410, 160], [0, 0, 1]]], device=x.device).expand(len(x), 3, 3)


POINTWISE = [window for window in WINDOWS if window.large and not any(window.reach)]


def pixels(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    return (torch.rand(shape, dtype=torch.float64) * 0.9 + 0.05).to(device=device, dtype=dtype)


def from_element_one(x: Tensor) -> Tensor:
    """The same pixels, one element after the begin of their memory."""
    storage = torch.empty(x.numel() + 1, dtype=x.dtype, device=x.device)[1:]
    return storage.view_as(x).copy_(x)


def in_wider_rows(x: Tensor) -> Tensor:
    """The same pixels in rows that are one pixel longer."""
    wide = torch.empty((*x.shape[:-1], x.shape[-1] + 1), dtype=x.dtype, device=x.device)
    return wide[..., 1:].copy_(x)


LAYOUTS: dict[str, Callable[[Tensor], Tensor]] = {
    "contiguous": lambda x: x.contiguous(),
    "element one": from_element_one,
    "slice": in_wider_rows,
    "channels_last": lambda x: x.contiguous(memory_format=torch.channels_last),
}


def value_and_gradient(call: Callable[[Tensor], Tensor], x: Tensor, grad: Tensor) -> tuple[Tensor, Tensor]:
    x = x.detach().requires_grad_()
    y = call(x)
    return y.detach(), torch.autograd.grad(y, x, grad[:, : y.shape[1]].to(y.dtype))[0]


@pytest.mark.parametrize(("window", "dtype", "shape"), pairwise(POINTWISE, DTYPES, SHAPES), ids=str)
def test_pointwise_functions_give_the_bits_of_aligned_images(window, dtype, shape, device):
    batch, channels, height, width = shape
    aligned_shape = (batch, channels, height, -(-width // 16) * 16)
    x, grad = (pixels(aligned_shape, dtype, device) for _ in range(2))
    value, gradient = (result[..., :width] for result in value_and_gradient(window, x, grad))
    for layout, arrange in LAYOUTS.items():
        y, grad_x = value_and_gradient(window, arrange(x[..., :width]), grad[..., :width].contiguous())
        if device.type == "cuda":
            assert torch.equal(y, value) and torch.equal(grad_x, gradient), layout
        else:  # the ends of rows may be computed by other instructions
            torch.testing.assert_close(y, value, msg=layout)
            torch.testing.assert_close(grad_x, gradient, msg=layout)


@pytest.mark.parametrize("dtype", [*DTYPES, torch.uint8], ids=str)
@pytest.mark.parametrize("shape", [*SHAPES, (2, 3, 301, 37), (1, 3, 999, 1)], ids=str)
def test_flips_and_crops_are_copies(shape, dtype, device):
    pixels_of_all = torch.randint(0, 256, shape).to(device=device, dtype=dtype)
    height, width = shape[-2:]
    crop = torch.ops.kvision.crop
    top, left, h, w = height // 5, width // 3, height // 2, width // 2 + 1
    for layout, arrange in LAYOUTS.items():
        x = arrange(pixels_of_all)
        assert torch.equal(transform.hflip(x), x.flip(-1)), layout
        assert torch.equal(transform.vflip(x), x.flip(-2)), layout
        assert torch.equal(transform.rot180(x), x.flip(-2, -1)), layout
        assert torch.equal(crop(x, [top, left], [h, w]), x[..., top : top + h, left : left + w]), layout
        padded = crop(x, [-2, -3], [height + 5, width + 4])
        assert torch.equal(padded[..., 2 : height + 2, 3 : width + 3], x), layout
        assert padded.sum(dtype=torch.float64) == x.sum(dtype=torch.float64), layout


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("shape", [*SHAPES, (96, 1, 32, 33), (70, 3, 65, 255)], ids=str)
def test_equalize_agrees_with_the_reference(shape, dtype, device):
    x = pixels(shape, dtype, device)
    x[0, 0, 3, 5] = float("nan")
    x[-1, -1] = 0.5  # stays as it is
    with kvision.backend("reference"):
        expected = enhance.equalize(x)
    # On a GPU torch divides by 255 through a product: the last bit differs.
    atol = 0.0 if device.type == "cpu" else 6e-8
    for layout, arrange in LAYOUTS.items():
        with named(layout):
            torch.testing.assert_close(enhance.equalize(arrange(x)), expected, rtol=0, atol=atol, equal_nan=True)


REDUCTIONS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "psnr": lambda x, y: metrics.psnr(x, y, 1.0),
    "charbonnier": lambda x, y: losses.charbonnier_loss(x, y, reduction="none"),
    "total_variation": lambda x, y: losses.total_variation(x, reduction="mean"),
    "min_max": lambda x, y: enhance.normalize_min_max(x),
    "contrast": lambda x, y: enhance.adjust_contrast_with_mean_subtraction(x, 0.7),
}


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_reductions_agree_with_the_reference(shape, dtype, device):
    x, y = (pixels(shape, dtype, device) for _ in range(2))
    tolerance = {torch.float32: 2e-5, torch.float16: 4e-3, torch.bfloat16: 3e-2}[dtype]

    def results(call: Callable[[Tensor, Tensor], Tensor], x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        leaf = x.detach().requires_grad_()
        value = call(leaf, y)
        return value.detach(), torch.autograd.grad(value.float().square().sum(), leaf)[0]

    for name, call in REDUCTIONS.items():
        with kvision.backend("reference"):
            expected = results(call, x, y)
        for layout, arrange in LAYOUTS.items():
            for ours, theirs in zip(results(call, arrange(x), arrange(y)), expected):
                scale = float(theirs.float().abs().max()) + 1e-9
                error = float((ours.float() - theirs.float()).abs().max()) / scale
                assert error <= tolerance, (name, layout, error)


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_normals_have_the_bits_of_aligned_images(shape, dtype, device):
    height, width = shape[-2:]
    x = pixels((shape[0], 1, height, -(-width // 16) * 16), dtype, device) + 1
    expected = geometry.depth_to_normals(x, camera(x))[..., : width - 1]
    with kvision.backend("reference"):
        reference = geometry.depth_to_normals(x[..., :width].float(), camera(x))
    tolerance = {torch.float32: 1e-4, torch.float16: 2e-3, torch.bfloat16: 1.6e-2}[dtype]
    for layout, arrange in LAYOUTS.items():
        y = geometry.depth_to_normals(arrange(x[..., :width]), camera(x))
        assert device.type != "cuda" or torch.equal(y[..., : width - 1], expected), layout
        with named(layout):
            torch.testing.assert_close(y.float(), reference, rtol=0, atol=tolerance)


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("count", [8193, 171855, 8194, 5], ids=str)
def test_points_of_a_batch_have_the_bits_of_single_samples(count, dtype, device):
    """The points of every sample but the first begin at any address."""
    random = torch.Generator().manual_seed(count)
    points, depth, weights = ((torch.rand(5, count, n, generator=random) + 0.5).to(dtype).to(device) for n in (3, 1, 3))
    matrix = (torch.eye(4) + 0.1 * torch.rand(5, 4, 4, generator=random)).to(device)
    calls = {
        "transform": lambda p, d, m: geometry.transform_points(m, p),
        "transform, plane": lambda p, d, m: geometry.transform_points(m[:, :3, :3], p[..., :2]),
        "project": lambda p, d, m: geometry.project_points(p, m[:, :3, :3]),
        "unproject": lambda p, d, m: geometry.unproject_points(p[..., :2], d, m[:, :3, :3]),
    }
    for name, call in calls.items():

        def both(part: slice, call=call) -> tuple[Tensor, ...]:
            leaves = [x[part].clone().requires_grad_() for x in (points, depth, matrix)]
            y = call(*leaves)
            grads = torch.autograd.grad(y, leaves, weights[part, :, : y.shape[-1]], allow_unused=True)
            return (y, *(g for g in grads if g is not None))

        together, single = both(slice(None)), [both(slice(i, i + 1)) for i in range(5)]
        for i in range(len(together)):
            expected = torch.cat([results[i] for results in single])
            if together[i].shape == matrix.shape:  # sums over points, of which others are added to each other
                torch.testing.assert_close(together[i], expected, rtol=1e-4, atol=1e-4 * float(expected.abs().max()))
            else:
                assert torch.equal(together[i], expected), (name, i)


PATCHES = [(32, 32, 0), (16, 8, 3), (48, 16, 16), (30, 7, 0)]  # window, stride, padding


@pytest.mark.parametrize(("cut", "dtype", "shape"), pairwise(PATCHES, [*DTYPES, torch.uint8], SHAPES), ids=str)
def test_patches_are_copies(cut, dtype, shape, device):
    window, stride, padding = cut
    x = torch.randint(0, 256, shape).to(device=device, dtype=dtype)
    padded = torch.nn.functional.pad(x, [padding] * 4)
    expected = padded.unfold(2, window, stride).unfold(3, window, stride)  # (B, C, down, across, window, window)
    expected = expected.permute(0, 2, 3, 1, 4, 5).flatten(1, 2)
    for layout, arrange in LAYOUTS.items():
        assert torch.equal(contrib.extract_tensor_patches(arrange(x), *cut), expected), layout


@pytest.mark.parametrize(("cut", "dtype", "shape"), pairwise(PATCHES, DTYPES, SHAPES), ids=str)
def test_gradients_of_patches_are_sums(cut, dtype, shape, device):
    x = pixels(shape, dtype, device).requires_grad_()
    patches = contrib.extract_tensor_patches(x, *cut)
    weights = torch.randint(0, 8, patches.shape).to(patches)  # whose sums are exact in every type
    results = [torch.autograd.grad(patches, x, weights)[0]]
    with kvision.backend("reference"):
        again = contrib.extract_tensor_patches(x, *cut)
        results.append(torch.autograd.grad(again.float(), x, weights.float())[0])
    assert torch.equal(*results)
