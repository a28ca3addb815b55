"""Large images whose rows are not aligned to vectors, as those of odd widths and of slices."""

import pytest
import torch

import kvision as K
from op_tests import assert_close

TYPES = [torch.float32, torch.float16, torch.bfloat16, torch.uint8]
BORDERS = ["constant", "replicate", "reflect"]


def images(dtype, device, width=540):
    """Images (2, 3, 37, width) at the end of their memory."""
    x = torch.rand(2, 3, 37, width, generator=torch.Generator().manual_seed(width))
    return ((255 * x).round() if dtype == torch.uint8 else x).to(dtype).to(device)


def filters(device):
    generator = torch.Generator().manual_seed(0)
    yield from (
        (f"gaussian {k}", lambda x, b, k=k: K.filters.gaussian_blur2d(x, (k, k), (2.0, 2.0), b))
        for k in (3, 5, 11, 13, 31)
    )
    for k in (3, 5, 7):
        weights = torch.rand(1, k, k, generator=generator).to(device) / k**2
        yield f"filter2d {k}", lambda x, b, weights=weights: K.filters.filter2d(x, weights, b)


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("dtype", TYPES, ids=str)
def test_unaligned_rows_have_the_bits_of_aligned_ones(dtype, border, device):
    if device.type == "cpu":
        pytest.skip("on the CPU the ends of rows are summed in another order")
    image = images(dtype, device)
    for name, f in filters(device):
        for first in (1, 2, 3, 7):
            part = image[..., first : first + 512]
            assert torch.equal(f(part, border), f(part.contiguous(), border)), (name, first)
        aligned = f(image[..., :528].contiguous(), border)
        for width in (270, 509, 513, 515, 522, 527):
            inner = width - 15  # windows of these pixels end before the narrower image
            assert torch.equal(f(image[..., :width].contiguous(), border)[..., :inner], aligned[..., :inner]), (
                name,
                width,
            )


@pytest.mark.parametrize("width", [125, 253, 381, 509, 513])
@pytest.mark.parametrize("size", [3, 5, 7])
def test_gradient_of_a_filter_without_padding(size, width, device):
    """At some of these widths the last strip of the transposed filter begins after the end of the rows of the gradient."""
    weights = torch.rand(1, size, size, device=device) / size**2
    x = images(torch.float32, device, width + size - 1)

    def gradient(dtype):
        image = x.to(dtype).requires_grad_()
        y = K.filters.filter2d(image, weights, padding="valid")
        return torch.autograd.grad(y, image, images(torch.float32, device, width)[..., : y.shape[-2], :].to(dtype))[0]

    assert_close(gradient(torch.float16).float(), gradient(torch.float32), 2e-3, 2e-3)
