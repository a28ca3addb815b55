"""Large images whose rows are no vectors of 16 bytes: odd widths, and slices of larger images.

Of rows that are vectors, kernels have a form of their own. Where both read the same pixels they give the same bits.
"""

import pytest
import torch

import kvision as kv
from benchmarks.sample_calls.windows import WINDOWS, Window
from kvision import filters, losses
from op_tests import pairwise

pytestmark = [pytest.mark.native, pytest.mark.large]

LARGE = [window for window in WINDOWS if window.large and any(window.reach)]
HALVES = (torch.float16, torch.bfloat16)


def on_images(window: Window):
    """The call on images, which are the planes of one volume where it takes volumes."""
    return (lambda x: window(x[None])[0]) if len(window.reach) == 3 else window


def result_and_gradient(call, x, upstream):
    """The gradient's upstream is as aligned as the image."""
    x = x.detach().requires_grad_()
    result = call(x)
    g = upstream.expand(result.shape) if upstream.dim() == 0 else upstream
    return result.detach(), *torch.autograd.grad(result, x, g)


def sliced(x, before, after):
    """The same values, as a slice of a larger image, whose rows begin `before` pixels late and are longer."""
    *batch, height, width = x.shape
    larger = x.new_full((*batch, height + 1, width + before + after), torch.nan)
    view = larger[..., 1:, before : before + width]
    return view.copy_(x)


@pytest.mark.parametrize(
    ("window", "ends", "dtype"),
    pairwise(LARGE, [(1, 0), (2, 3), (3, 4), (5, 2)], [torch.float32, *HALVES]),
    ids=str,
)
def test_slices_give_the_same_bits(window, ends, dtype, device):
    call = on_images(window)
    x = torch.rand(2, 3, 43, 272, device=device).to(dtype)
    g = torch.rand_like(call(x))
    result, gradient = result_and_gradient(call, x, g)
    of_slice, gradient_of_slice = result_and_gradient(call, sliced(x, *ends), sliced(g, *ends))
    assert torch.equal(of_slice, result)
    assert torch.equal(gradient_of_slice, gradient)


@pytest.mark.parametrize(
    ("window", "width", "dtype"),
    [
        *pairwise(LARGE, [129, 257, 513], [torch.float32, torch.float16]),
        *(
            pytest.param(*case, marks=pytest.mark.gpu)
            for case in pairwise(LARGE, [142, 270, 299, 481, 514, 517], [torch.float32, torch.float16])
        ),
    ],
    ids=str,
)
def test_odd_widths(window, width, dtype, device):
    """Far from the right border they agree with a wider image, near it with the reference."""
    call, reach, name = on_images(window), window.reach[-1], str(window)
    wider = torch.rand(1, 3, 37, (width + 15) // 16 * 16, device=device).to(dtype)
    x = wider[..., :width].contiguous()
    g = torch.rand_like(call(wider))
    wrapped = 2 * reach if "circular" in name else 0
    result, gradient = result_and_gradient(call, x, g[..., :width].contiguous())
    of_wider, gradient_of_wider = result_and_gradient(call, wider, g)
    assert torch.equal(result[..., wrapped : width - reach], of_wider[..., wrapped : width - reach])
    far, far_of_wider = (v[..., wrapped : width - 2 * reach] for v in (gradient, gradient_of_wider))
    # Sums of up to 49 gradients, none negative, in an order that depends on how blocks divide a width.
    tolerance = (
        max(48 * torch.finfo(torch.float32).eps, torch.finfo(dtype).eps) if name == "dilation kernel=7 7" else 0.0
    )
    torch.testing.assert_close(far, far_of_wider, rtol=tolerance, atol=0.0)
    with kv.backend("reference"):
        expected, expected_gradient = result_and_gradient(call, x.float(), g[..., :width].float())
    atol = 2e-4 if dtype == torch.float32 else 2e-2
    torch.testing.assert_close(result.float(), expected, atol=atol, rtol=atol)
    if "median" not in name and "dilation" not in name and "erosion" not in name:  # ties depend on rounding
        torch.testing.assert_close(gradient.float(), expected_gradient, atol=5 * atol, rtol=5 * atol)


@pytest.mark.parametrize("width", [257, pytest.param(513, marks=pytest.mark.gpu)])
@pytest.mark.parametrize("before", [0, 1, 2, 3])
@pytest.mark.parametrize("kernel_size", [3, 5, 11, 31])
def test_bytes(kernel_size, before, width, device):
    x = torch.randint(0, 256, (2, 3, 37, width), dtype=torch.uint8, device=device)
    larger = torch.full((2, 3, 37, width + 6), 255, dtype=torch.uint8, device=device)
    view = larger[..., before : before + width]
    view.copy_(x)
    calls = [lambda x: filters.gaussian_blur2d(x, kernel_size, (2.0, 2.0)), lambda x: filters.box_blur(x, kernel_size)]
    if kernel_size <= 5:
        calls.append(lambda x: filters.median_blur(x, kernel_size))
    for call in calls:
        assert torch.equal(call(view), call(x))
        with kv.backend("reference"):
            expected = call(x)
        assert (call(x).int() - expected.int()).abs().max() <= 1


@pytest.mark.parametrize("width", [256, 257])
def test_losses_of_slices(width, device):
    x, y = torch.rand(2, 2, 3, 40, width, device=device).unbind()
    expected, gradient = result_and_gradient(lambda x: losses.ssim_loss(x, y, 11), x, torch.ones((), device=device))
    of_slice, gradient_of_slice = result_and_gradient(
        lambda x: losses.ssim_loss(x, sliced(y, 1, 4), 11), sliced(x, 3, 2), torch.ones((), device=device)
    )
    assert torch.equal(of_slice, expected)
    assert torch.equal(gradient_of_slice, gradient)
