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
from kvision import color, enhance, losses, metrics
from kvision.geometry import transform

pytestmark = [pytest.mark.native, pytest.mark.large]

SHAPES = [(2, 3, 335, 513), (5, 3, 67, 299), (3, 3, 64, 126)]
DTYPES = [torch.float32, torch.float16, torch.bfloat16]


def weights(x: Tensor) -> Tensor:
    """A number for each image."""
    return torch.linspace(0.5, 1.5, len(x), device=x.device)


POINTWISE: dict[str, Callable[[Tensor], Tensor]] = {
    "rgb_to_hsv": color.rgb_to_hsv,
    "rgb_to_lab": color.rgb_to_lab,
    "rgb_to_ycbcr": color.rgb_to_ycbcr,
    "rgb_to_grayscale": color.rgb_to_grayscale,
    "adjust_saturation": lambda x: enhance.adjust_saturation(x, weights(x)),
    "adjust_hue": lambda x: enhance.adjust_hue(x, 0.5),
    "adjust_brightness": lambda x: enhance.adjust_brightness(x, weights(x)),
    "adjust_gamma": lambda x: enhance.adjust_gamma(x, 1.5),
    "normalize": lambda x: enhance.normalize(x, x.new_tensor([0.4, 0.5, 0.6]), x.new_tensor([0.2, 0.3, 0.4])),
    "add_weighted": lambda x: enhance.add_weighted(x, weights(x).view(-1, 1, 1, 1), 1 - x.detach(), 0.25, 0.125),
}


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


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("name", POINTWISE)
def test_pointwise_functions_give_the_bits_of_aligned_images(name, dtype, shape, device):
    call = POINTWISE[name]
    batch, channels, height, width = shape
    aligned_shape = (batch, channels, height, -(-width // 16) * 16)
    x, grad = (pixels(aligned_shape, dtype, device) for _ in range(2))
    value, gradient = (result[..., :width] for result in value_and_gradient(call, x, grad))
    for layout, arrange in LAYOUTS.items():
        y, grad_x = value_and_gradient(call, arrange(x[..., :width]), grad[..., :width].contiguous())
        if device.type == "cuda":
            assert torch.equal(y, value) and torch.equal(grad_x, gradient), layout
        else:  # the ends of rows may be computed by other instructions
            torch.testing.assert_close(y, value, msg=layout)
            torch.testing.assert_close(grad_x, gradient, msg=layout)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("dtype", [*DTYPES, torch.uint8], ids=str)
@pytest.mark.parametrize("shape", [*SHAPES, (2, 3, 301, 37), (1, 3, 999, 1)], ids=str)
def test_flips_and_crops_are_copies(shape, dtype, layout, device):
    x = LAYOUTS[layout](torch.randint(0, 256, shape).to(device=device, dtype=dtype))
    height, width = shape[-2:]
    assert torch.equal(transform.hflip(x), x.flip(-1))
    assert torch.equal(transform.vflip(x), x.flip(-2))
    assert torch.equal(transform.rot180(x), x.flip(-2, -1))
    crop = torch.ops.kvision.crop
    top, left, h, w = height // 5, width // 3, height // 2, width // 2 + 1
    assert torch.equal(crop(x, [top, left], [h, w]), x[..., top : top + h, left : left + w])
    padded = crop(x, [-2, -3], [height + 5, width + 4])
    assert torch.equal(padded[..., 2 : height + 2, 3 : width + 3], x)
    assert padded.sum(dtype=torch.float64) == x.sum(dtype=torch.float64)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("shape", [*SHAPES, (96, 1, 32, 33), (70, 3, 65, 255)], ids=str)
def test_equalize_agrees_with_the_reference(shape, dtype, layout, device):
    x = LAYOUTS[layout](pixels(shape, dtype, device))
    x[0, 0, 3, 5] = float("nan")
    x[-1, -1] = 0.5  # stays as it is
    with kvision.backend("reference"):
        expected = enhance.equalize(x)
    # On a GPU torch divides by 255 through a product: the last bit differs.
    atol = 0.0 if device.type == "cpu" else 6e-8
    torch.testing.assert_close(enhance.equalize(x), expected, rtol=0, atol=atol, equal_nan=True)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_reductions_agree_with_the_reference(shape, dtype, layout, device):
    x, y = (LAYOUTS[layout](pixels(shape, dtype, device)) for _ in range(2))
    calls = {
        "psnr": lambda x: metrics.psnr(x, y, 1.0),
        "charbonnier": lambda x: losses.charbonnier_loss(x, y, reduction="none"),
        "total_variation": lambda x: losses.total_variation(x, reduction="mean"),
        "min_max": enhance.normalize_min_max,
        "contrast": lambda x: enhance.adjust_contrast_with_mean_subtraction(x, 0.7),
    }
    for name, call in calls.items():
        results = []
        for backend in ("auto", "reference"):
            leaf = x.detach().requires_grad_()
            with kvision.backend(backend):
                value = call(leaf)
                gradient = torch.autograd.grad(value.float().square().sum(), leaf)[0]
            results.append((value.detach(), gradient))
        for ours, expected in zip(*results):
            tolerance = {torch.float32: 2e-5, torch.float16: 4e-3, torch.bfloat16: 3e-2}[dtype]
            scale = float(expected.float().abs().max()) + 1e-9
            error = float((ours.float() - expected.float()).abs().max()) / scale
            assert error <= tolerance, (name, error)
