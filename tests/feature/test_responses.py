"""Responses of corners and blobs."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import LAYOUTS, OpTests, assert_close, with_layout

F = K.feature
SMALL = torch.rand(2, 2, 9, 11, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
SIGMAS = torch.tensor([0.7, 1.5], dtype=torch.float64)
OF_IMAGES = ("harris_response", "gftt_response", "hessian_response")


def sigmas(x):
    return 0.5 + torch.rand(x.shape[0])


class TestHarris(OpTests):
    function = staticmethod(F.harris_response)
    operators = ("corner_response", "corner_response_backward")
    compiler = "inductor"
    variants = [
        {"k": 0.04},
        {"k": 0.06, "grads_mode": "diff", "sigmas": sigmas},
        {"k": lambda x: torch.tensor(0.05), "sigmas": sigmas},
    ]
    errors = [
        ({"grads_mode": "scharr"}, ValueError, "grads_mode must be one of"),
        ({"k": "a"}, TypeError, "expected k to be a number"),
        ({"k": lambda x: torch.ones(2)}, ValueError, "expected k to be one number"),
        ({"sigmas": lambda x: torch.ones(3)}, ValueError, r"sigmas of shape \(2,\)"),
        ({"sigmas": 1.0}, TypeError, "sigmas to be a Tensor"),
    ]


class TestGFTT(OpTests):
    function = staticmethod(F.gftt_response)
    module = F.CornerGFTT
    operators = ("corner_response", "corner_response_backward")
    forward_arguments = ("sigmas",)
    variants = [{}, {"grads_mode": "diff", "sigmas": sigmas}]
    errors = [({"grads_mode": "scharr"}, ValueError, "grads_mode must be one of")]


class TestHessian(OpTests):
    function = staticmethod(F.hessian_response)
    module = F.BlobHessian
    operators = ("hessian_response", "hessian_response_backward")
    forward_arguments = ("sigmas",)
    variants = [{}, {"grads_mode": "diff"}, {"sigmas": sigmas}]
    errors = [
        ({"grads_mode": "scharr"}, ValueError, "grads_mode must be one of"),
        ({"sigmas": lambda x: torch.ones(3)}, ValueError, r"sigmas of shape \(2,\)"),
    ]


class TestDifferenceOfGaussians(OpTests):
    """The operator serves sigmas whose windows have 9 and 13 pixels."""

    function = staticmethod(F.dog_response_single)
    module = F.BlobDoGSingle
    operators = ("difference_of_gaussians", "difference_of_gaussians_backward")
    small = (1, 2, 7, 8)
    variants = [{}, {"sigma1": 1.1, "sigma2": 1.5}]
    errors = [
        ({"sigma1": -1.0}, ValueError, "expected sigma1 above 0"),
        ({"sigma1": 0.0}, ValueError, "expected sigma1 above 0"),
        ({"sigma2": float("inf")}, ValueError, "expected sigma2 above 0"),
        ({"sigma2": "1"}, TypeError, "expected sigma2 to be a number"),
    ]


@pytest.mark.parametrize("mode", ["sobel", "diff"])
@pytest.mark.parametrize("name", OF_IMAGES)
def test_values_are_those_of_kornia(name, mode, device):
    theirs = pytest.importorskip("kornia").feature
    x = torch.rand(2, 3, 17, 24, dtype=torch.float64)
    for sigmas in (None, SIGMAS):
        moved = None if sigmas is None else sigmas.to(device)
        ours = getattr(F, name)(x.to(device), grads_mode=mode, sigmas=moved)
        assert_close(ours.cpu(), getattr(theirs, name)(x, grads_mode=mode, sigmas=sigmas), 1e-9, 1e-12)


def test_harris_has_a_constant_that_learns(device):
    theirs = pytest.importorskip("kornia").feature
    x, k = SMALL.to(device), torch.tensor(0.06, dtype=torch.float64, device=device, requires_grad=True)
    assert_close(F.harris_response(x, k), F.harris_response(x, 0.06))
    assert_close(F.harris_response(x, k).cpu(), theirs.harris_response(SMALL, k.detach().cpu()), 1e-9, 1e-12)
    (grad,) = torch.autograd.grad(F.harris_response(x, k).sum(), k)
    assert_close(grad, F.harris_response(x, 1.0).sum() - F.harris_response(x, 0.0).sum(), 1e-9, 1e-9)


def test_differences_of_gaussians(device):
    theirs = pytest.importorskip("kornia").feature
    x = torch.rand(2, 3, 20, 24, dtype=torch.float64)
    assert_close(F.dog_response_single(x.to(device)).cpu(), theirs.dog_response_single(x), 1e-9, 1e-12)
    for height, width in ((14, 8), (9, 30)):  # smaller than kernels, larger than half of them
        small = x[..., :height, :width]
        assert_close(F.dog_response_single(small.to(device)).cpu(), theirs.dog_response_single(small), 1e-9, 1e-12)
    assert F.dog_response_single(x[..., :3, :1].to(device)).isfinite().all()
    levels = x.unflatten(1, (1, 3))
    assert_close(F.dog_response(levels.to(device)).cpu(), theirs.dog_response(levels), 0, 0)


def dog_and_gradient(x, weights):
    x = x.detach().requires_grad_()
    y = F.dog_response_single(x)
    return y, *torch.autograd.grad(y, x, weights)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.float64], ids=str)
@pytest.mark.parametrize("width", [129, 132, 251, 257, 513])
def test_differences_of_gaussians_of_wide_rows(width, dtype, device):
    """Rows of several warps and blocks, which begin anywhere."""
    x, weights = (torch.rand(1, 2, 37, width, dtype=torch.float64).to(device, dtype) for _ in range(2))
    with K.backend("reference"):
        expected = [value.to(dtype) for value in dog_and_gradient(x.double(), weights.double())]
    for layout in LAYOUTS:
        assert_close(dog_and_gradient(with_layout(x, layout), with_layout(weights, layout)), expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16], ids=str)
def test_differences_of_gaussians_do_not_depend_on_alignment(dtype, device):
    x, weights = (torch.rand(3, 2, 70, 264, device=device).to(dtype) for _ in range(2))
    expected = dog_and_gradient(x, weights)
    unaligned = [torch.nn.functional.pad(value, (1, 0))[..., 1:] for value in (x, weights)]
    exact = (0, 0) if device.type == "cuda" else (None, None)
    assert_close(dog_and_gradient(*unaligned), expected, *exact)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.float64], ids=str)
@pytest.mark.parametrize("width", [129, 130, 251, 377, 517])
@pytest.mark.parametrize("name", ["harris_response", "gftt_response"])
def test_corners_of_wide_rows(name, width, dtype, device):
    """Rows whose ends are columns of one warp or of two."""
    x, weights = (torch.rand(1, 2, 9, width, dtype=torch.float64).to(device, dtype) for _ in range(2))

    def response_and_gradient(x, weights):
        x = x.detach().requires_grad_()
        y = getattr(F, name)(x)
        return y, *torch.autograd.grad(y, x, weights)

    with K.backend("reference"):
        expected = [value.to(dtype) for value in response_and_gradient(x.double(), weights.double())]
    for layout in LAYOUTS:
        assert_close(response_and_gradient(with_layout(x, layout), with_layout(weights, layout)), expected)


@pytest.mark.parametrize("name", OF_IMAGES)
def test_flat_images_have_zero_responses_and_gradients(name, device):
    x = torch.full((1, 1, 12, 12), 0.3, device=device, dtype=torch.float64, requires_grad=True)
    y = getattr(F, name)(x)
    (grad,) = torch.autograd.grad(y.sum(), x)
    assert y.abs().max() < 1e-12 and grad.abs().max() < 1e-12


def test_modules_without_a_suite():
    x = SMALL
    for module, value in [
        (F.CornerHarris(0.05), F.harris_response(x, 0.05, sigmas=SIGMAS)),
        (F.CornerHarris(torch.tensor(0.05), "diff"), F.harris_response(x, torch.tensor(0.05), "diff", SIGMAS)),
    ]:
        assert_close(module(x, SIGMAS), value, 1e-6, 1e-9)
    assert list(F.CornerHarris(0.05).state_dict()) == ["k"]
    levels = SMALL[:, None]
    assert_close(F.BlobDoG()(levels, SIGMAS), F.dog_response(levels))


def test_dog_response_takes_levels():
    with pytest.raises(ValueError, match=r"dog_response: expected input of shape \(B, C, D, H, W\)"):
        F.dog_response(SMALL)
