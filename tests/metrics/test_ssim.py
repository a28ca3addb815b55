"""Structural similarity: the kernel's tests."""

from __future__ import annotations

import itertools

import pytest
import torch

import kvision as K
from op_tests import OpTests, assert_close, pairwise


def other(x: torch.Tensor) -> torch.Tensor:
    """Another image, partly equal."""
    noise = torch.rand(x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).to(x.device)
    return (x.double() * 0.6 + 0.4 * noise).to(torch.float64 if x.dtype == torch.float64 else torch.float32)


class TestSSIM(OpTests):
    function = staticmethod(K.metrics.ssim)
    module = K.metrics.SSIM
    operators = ("ssim", "ssim_backward", "ssim_backward_both")
    variants = [
        {"img2": other, "window_size": 5},
        {"img2": other, "window_size": 7, "padding": "valid", "max_val": 2.0},
    ]
    errors = [
        ({"window_size": 4}, ValueError, "expected window_size to be odd"),
        ({"padding": "full"}, ValueError, "padding must be one of"),
        ({"eps": -1.0}, ValueError, "expected eps to be"),
        ({"img2": None}, TypeError, "expected img2 to be a Tensor"),
    ]
    forward_arguments = ("img2",)
    shape = (2, 3, 13, 18)
    small = (1, 1, 8, 9)
    max_size = 17
    # Variances are differences of means of squares, and the similarity divides by them.
    tolerances = {torch.float32: (2e-4, 2e-5)}

    @pytest.mark.tracing
    def test_opcheck(self, device, backend):
        if torch.__version__.startswith("2.11"):
            pytest.skip("torch 2.11: the second derivative of a convolution takes no symbolic sizes")
        super().test_opcheck(device, backend)


class Losses(TestSSIM):
    module = None
    errors = TestSSIM.errors[:1] + TestSSIM.errors[2:]
    forward_arguments = ()

    def test_empty(self, variant, device):
        """The mean of nothing."""
        x = torch.rand(0, 3, 13, 18, device=device)
        assert self.function(x, x, 5).isnan()


class TestLoss(Losses):
    function = staticmethod(K.losses.ssim_loss)
    operators = ("ssim_loss", "ssim_loss_backward", "ssim_loss_backward_both")
    variants = [{"img2": other, "window_size": 7, "padding": "valid", "max_val": 2.0}]


class TestL1Loss(Losses):
    function = staticmethod(K.losses.l1_ssim_loss)
    operators = ("ssim_loss", "ssim_loss_backward", "ssim_loss_backward_both")
    variants = [{"img2": other, "window_size": 5, "ssim_weight": 0.4}]


def MS_SSIMLoss(img1, img2, **options):
    return K.losses.MS_SSIMLoss(compensation=1.0, **options)(img1, img2)


class TestScales(TestSSIM):
    function = staticmethod(MS_SSIMLoss)
    module = None
    operators = ("ms_ssim", "ms_ssim_backward", "ms_ssim_backward_both")
    variants = [
        {"img2": other, "sigmas": (0.5, 1.0), "alpha": 0.4, "reduction": "none"},
        {"img2": other, "sigmas": (1.2, 0.6, 3.0), "alpha": 0.7, "data_range": 2.0},
    ]
    errors = [
        ({"sigmas": (0.0, 1.0)}, ValueError, "expected sigmas and data_range above 0"),
        ({"img2": None}, TypeError, "expected img2 to be a Tensor"),
    ]
    forward_arguments = ()

    def test_empty(self, device):
        """The mean of nothing."""
        for shape in ((0, 3, 13, 18), (2, 0, 13, 18)):
            x = torch.rand(shape, device=device)
            assert self.function(x, x).isnan()


@pytest.mark.native
@pytest.mark.parametrize("sigmas", [(0.5, 1.0, 2.0, 4.0, 8.0), (5.0,), (20.0, 3.0, 6.5), (1.0,) * 17], ids=len)
@pytest.mark.parametrize("size", [(1, 2), (40, 67), pytest.param((19, 330), marks=pytest.mark.gpu)], ids=str)
def test_scales_of_large_images(sigmas, size, device):
    """Tiles, both gradients, one of the images for all others; more scales than the kernels take."""
    x = torch.rand(2, 2, *size, device=device)
    for y in (other(x), other(x[:1])):
        results = []
        for name, dtype in (("auto", torch.float32), ("reference", torch.float64)):
            with K.backend(name):
                leaves = x.to(dtype).requires_grad_(), y.to(dtype).requires_grad_()
                loss = K.losses.MS_SSIMLoss(sigmas, alpha=0.5, reduction="none")(*leaves)
                both = torch.autograd.grad((loss**2).sum(), leaves)
                swapped = K.losses.MS_SSIMLoss(sigmas, alpha=0.5)(leaves[1], leaves[0])
                alone = torch.autograd.grad(swapped, leaves[1])
                results.append([loss.detach(), *both, swapped.detach(), *alone])
        for actual, expected in zip(*results):
            assert_close(actual, expected.float(), 1e-3, 1e-4 * float(expected.abs().max()))


@pytest.mark.native
@pytest.mark.parametrize("window", [3, 5, 7, 9, 11, 13, 31])
@pytest.mark.parametrize(
    "size",
    [(11, 12), (40, 67), *(pytest.param(size, marks=pytest.mark.gpu) for size in ((33, 300), (90, 530)))],
    ids=str,
)
@pytest.mark.parametrize("padding", ["same", "valid"])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=["planar", "last"])
def test_blocks_and_strips(window, size, padding, layout, device):
    """Images that one block does not hold, both gradients, and the loss against the mean of its map."""
    if min(size) < window:
        pytest.skip("the window is larger than the images")
    x = torch.rand(1, 2, *size, device=device).contiguous(memory_format=layout)
    y = other(x)
    weight = torch.rand(K.metrics.ssim(x, y, window, padding=padding).shape, device=device)
    results = []
    for name, dtype in (("auto", torch.float32), ("reference", torch.float64)):
        with K.backend(name):
            leaves = x.to(dtype).requires_grad_(), y.to(dtype).requires_grad_()
            similar = K.metrics.ssim(*leaves, window, padding=padding)
            gradients = torch.autograd.grad((similar * weight).sum(), leaves)
            loss = K.losses.ssim_loss(*leaves, window, padding=padding)
            of_loss = torch.autograd.grad(loss * 1e4, leaves)
            mixed = K.losses.l1_ssim_loss(*leaves, window)
            of_mixed = torch.autograd.grad(mixed * 1e4, leaves[0])
            results.append([similar.detach(), *gradients, loss.detach(), *of_loss, mixed.detach(), *of_mixed])
    for actual, expected in zip(*results):
        assert_close(actual, expected.float(), 1e-3, 2e-4 * float(expected.abs().max()))


@pytest.mark.native
@pytest.mark.parametrize(
    ("window_and_padding", "size", "dtype"),
    pairwise(
        list(itertools.product([1, 3, 7, 11, 23], ["same", "valid"])),
        [(7, 8, 9), (12, 20, 40), (25, 12, 33)],
        [torch.float32, torch.float64],
    ),
    ids=str,
)
def test_volumes(window_and_padding, size, dtype, device):
    """Map and loss of volumes with both gradients."""
    window, padding = window_and_padding
    if min(size) < window if padding == "valid" else min(size) <= window // 2:
        pytest.skip("the window is larger than the volumes")
    x = torch.rand(2, 2, *size, device=device, dtype=dtype)
    y = other(x).to(dtype)
    weight = torch.rand(K.metrics.ssim3d(x, y, window, padding=padding).shape, device=device, dtype=torch.float64)
    results = []
    for name, computed in (("auto", dtype), ("reference", torch.float64)):
        with K.backend(name):
            leaves = x.to(computed).requires_grad_(), y.to(computed).requires_grad_()
            similar = K.metrics.ssim3d(*leaves, window, padding=padding)
            gradients = torch.autograd.grad((similar * weight).sum(), leaves)
            loss = K.losses.ssim3d_loss(*leaves, window, padding=padding)
            of_loss = torch.autograd.grad(loss * 1e4, leaves)
            results.append([similar.detach(), *gradients, loss.detach(), *of_loss])
    for actual, expected in zip(*results):
        small = 2e-4 if dtype == torch.float32 else 1e-9
        assert_close(actual, expected.to(dtype), 5 * small, small * float(expected.abs().max()))


def test_the_gradient_of_rows(device):
    """A plane with more derivatives than CUDA has memory for is taken in parts; what lies far from it changes nothing."""
    if device.type != "cuda":
        pytest.skip("the CPU keeps a few rows in any case")
    x = torch.rand(1, 1, 2300, 4000, device=device)
    y, part = other(x), slice(1000, 1400)
    for call in (K.losses.MS_SSIMLoss(reduction="none"), lambda x, y: K.metrics.ssim(x, y, 31)):
        whole, alone = x.clone().requires_grad_(), x[..., part, :].clone().requires_grad_()
        (expected,) = torch.autograd.grad(call(alone, y[..., part, :])[..., 100:300, :].sum(), alone)
        (actual,) = torch.autograd.grad(call(whole, y)[..., 1100:1300, :].sum(), whole)
        assert_close(actual[..., part, :], expected, 1e-4, 1e-4 * float(expected.abs().max()))
        assert actual[..., :1000, :].abs().max() == 0


def test_a_window_of_hundreds_of_pixels(device):
    """Larger than the kernels of other windows take."""
    x = torch.rand(1, 1, 205, 207, device=device)
    y = other(x)
    results = []
    for name, dtype in (("auto", torch.float32), ("reference", torch.float64)):
        with K.backend(name):
            leaves = x.to(dtype).requires_grad_(), y.to(dtype).requires_grad_()
            loss = K.losses.ssim_loss(*leaves, 403)
            results.append([loss.detach(), *torch.autograd.grad(loss * 1e4, leaves)])
    for actual, expected in zip(*results):
        assert_close(actual, expected.float(), 1e-3, 2e-4 * float(expected.abs().max()))


@pytest.mark.native
@pytest.mark.large
def test_gradient_of_many_planes_equals_that_of_each(device):
    """More of them than a launch takes that keeps to its memory."""
    x = torch.rand(36, 1, 300, 400, device=device, requires_grad=True)
    y = other(x.detach())
    for call in (
        lambda x, y: K.metrics.ssim(x, y, 13),
        lambda x, y: K.losses.MS_SSIMLoss((3.0, 0.8), reduction="sum")(x, y),
    ):
        (grad,) = torch.autograd.grad(call(x, y).sum(), x)
        (of_last,) = torch.autograd.grad(call(x[35:], y[35:]).sum(), x)
        assert torch.equal(grad[35:], of_last[35:])


@pytest.mark.parametrize("size", [(2, 9, 9), (1, 1, 1), (3, 2, 8)])
def test_thin_volumes(size, device):
    """Where a border of half a window cannot be reflected, it is replicated."""
    x, y = torch.rand(2, 1, 2, *size, dtype=torch.float64, device=device)
    border = (3,) * 6
    wide = [torch.nn.functional.pad(z, border, mode="replicate") for z in (x, y)]
    result = K.metrics.ssim3d(x, y, 7)
    assert_close(result, K.metrics.ssim3d(*wide, 7, padding="valid"))
    assert result.shape == x.shape and (K.metrics.ssim3d(x, x, 7) == 1).all()
    assert_close(K.losses.ssim3d_loss(x, y, 7), ((1 - result) / 2).clamp(0, 1).mean(), 1e-9, 1e-9)
    assert_close(K.losses.ssim3d_loss(x, y, 7, reduction="none"), (1 - result) / 2, 1e-9, 1e-9)


@pytest.mark.parametrize("function", [K.metrics.ssim, K.losses.ssim_loss])
def test_advice_for_small_images(function):
    x = torch.rand(1, 1, 3, 9)
    with pytest.raises(ValueError, match=r"got \(1, 1, 3, 9\); use a smaller window_size for images this small"):
        function(x, x, 11)
