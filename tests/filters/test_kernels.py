"""Kernels against SciPy, closed forms and Kornia."""

import kornia
import numpy as np
import pytest
import scipy.ndimage
import scipy.signal
import scipy.special
import torch

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close

F, KF = K.filters, kornia.filters
SIGMAS = (1e-3, 0.2, 0.5, 1.0, 2.5, 10.0, 300.0)


# --- Gaussian ---


@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("size", [1, 2, 3, 4, 7, 12, 31])
@pytest.mark.parametrize("name", ["get_gaussian_kernel1d", "get_gaussian_erf_kernel1d"])
def test_gaussian_against_kornia(name, size, sigma, device):
    ours = getattr(F, name)(size, sigma, force_even=True, device=device, dtype=torch.float64)
    assert ours.device.type == device.type
    assert_close(ours.cpu(), getattr(KF, name)(size, sigma, force_even=True, dtype=torch.float64), atol=1e-8)


@pytest.mark.parametrize("sigma", (0.2, 1.0, 2.5, 10.0))
def test_gaussian_against_scipy(sigma, device):
    impulse = np.zeros(41)
    impulse[20] = 1
    expected = scipy.ndimage.gaussian_filter1d(impulse, sigma, radius=20)
    assert_close(F.gaussian(41, sigma, device=device, dtype=torch.float64)[0].cpu(), torch.from_numpy(expected))


@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("size", [1, 3, 7, 31, 101])
def test_discrete_gaussian_is_made_of_bessel_functions(size, sigma, device):
    weights = scipy.special.ive(np.abs(np.arange(size) - size // 2), sigma**2)
    expected = torch.from_numpy(weights / weights.sum())
    ours = F.get_gaussian_discrete_kernel1d(size, sigma, device=device, dtype=torch.float64)
    assert_close(ours[0].cpu(), expected, 1e-12, 1e-14)


def test_discrete_gaussians_compose(device):
    a, b, both = (
        F.get_gaussian_discrete_kernel1d(61, s, device=device, dtype=torch.float64)[0].cpu().numpy()
        for s in (0.6, 0.8, 1.0)
    )
    assert_close(torch.from_numpy(np.convolve(a, b, "same")), torch.from_numpy(both), atol=1e-14)


def test_gaussian_erf_is_the_integral(device):
    edges = scipy.special.ndtr((np.arange(8) - 3.5) / 1.7)
    expected = torch.from_numpy(np.diff(edges) / np.diff(edges).sum())
    assert_close(F.get_gaussian_erf_kernel1d(7, 1.7, device=device, dtype=torch.float64)[0].cpu(), expected)


def test_gaussian_mean(device):
    mean = torch.tensor([[2.2], [4.0]], device=device, dtype=torch.float64)
    sigma = torch.tensor([[1.3], [0.6]], device=device, dtype=torch.float64)
    for size in (6, 7):
        assert_close(F.gaussian(size, sigma, mean=mean), KF.gaussian(size, sigma, mean=mean))
        assert_close(F.gaussian(size, 1.3, mean=2.2), KF.gaussian(size, 1.3, mean=2.2))


def test_sigma_zero_is_an_impulse(device):
    sigma = torch.zeros(1, 1, device=device, requires_grad=True)
    for kernel in (F.gaussian(5, 0.0, device=device), F.gaussian(5, sigma), F.get_gaussian_discrete_kernel1d(5, sigma)):
        assert_close(kernel.detach(), torch.tensor([[0.0, 0, 1, 0, 0]], device=device))
    F.gaussian(5, sigma)[0, 1].backward()
    assert torch.equal(sigma.grad, torch.zeros_like(sigma))


def test_products(device):
    sigma = torch.rand(4, 3, device=device, dtype=torch.float64) + 0.3
    assert_close(F.get_gaussian_kernel3d((3, 5, 7), sigma), KF.get_gaussian_kernel3d((3, 5, 7), sigma))
    assert_close(
        F.get_gaussian_kernel2d((3, 4), sigma[:, :2], True), KF.get_gaussian_kernel2d((3, 4), sigma[:, :2], True)
    )
    assert_close(F.get_gaussian_kernel2d(5, (1.0, 2.0)), KF.get_gaussian_kernel2d(5, (1.0, 2.0)))
    assert_close(F.get_gaussian_kernel2d(5, 1.5), KF.get_gaussian_kernel2d(5, (1.5, 1.5)))


@pytest.mark.parametrize(
    "make", [F.get_gaussian_kernel1d, F.get_gaussian_discrete_kernel1d, F.get_gaussian_erf_kernel1d]
)
def test_gaussian_dtypes_and_gradients(make, device):
    assert make(5, 1.0, device=device).dtype == torch.float32
    assert make(5, torch.ones(2, 1, device=device, dtype=torch.float16)).dtype == torch.float16
    assert make(5, torch.ones(2, 1, device=device, dtype=torch.int64)).dtype == torch.float32
    assert_close(make(9, 2.0, dtype=torch.bfloat16), make(9, 2.0).bfloat16())
    sigma = torch.tensor([[0.7], [2.0]], device=device, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda s: make(5, s), sigma)
    assert torch.autograd.gradgradcheck(lambda s: make(5, s), sigma)


# --- box, Laplacian, derivatives, windows ---


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("get_box_kernel1d", (4,)),
        ("get_box_kernel2d", ((2, 3),)),
        ("laplacian_1d", (4,)),
        ("get_laplacian_kernel1d", (5,)),
        ("get_laplacian_kernel2d", ((3, 5),)),
        ("get_laplacian_kernel2d", (3,)),
        ("get_binary_kernel2d", ((2, 3),)),
        ("get_sobel_kernel2d", ()),
        ("get_diff_kernel2d", ()),
        *[("get_spatial_gradient_kernel2d", (mode, order)) for mode in ("sobel", "diff") for order in (1, 2)],
        *[("get_spatial_gradient_kernel3d", ("diff", order)) for order in (1, 2)],
    ],
)
def test_against_kornia(name, arguments, device):
    for dtype in (torch.float32, torch.float64):
        ours = getattr(F, name)(*arguments, device=device, dtype=dtype)
        assert_close(ours.cpu(), getattr(KF, name)(*arguments, dtype=dtype))
    assert getattr(F, name)(*arguments).dtype == torch.float32


def test_hann_against_scipy(device):
    for size in (3, 6, 11):
        expected = torch.from_numpy(scipy.signal.windows.hann(size))
        assert_close(F.get_hanning_kernel1d(size, device, torch.float64).cpu(), expected)
    kernel = F.get_hanning_kernel2d((4, 7), device, torch.float64).cpu()
    assert_close(kernel, torch.from_numpy(np.outer(scipy.signal.windows.hann(4), scipy.signal.windows.hann(7))))


def test_no_negative_zeros():
    assert not any(torch.signbit(k[k == 0]).any() for k in (F.get_sobel_kernel2d(), F.get_diff_kernel2d()))


def test_integer_laplacian():
    assert F.get_laplacian_kernel2d(3, dtype=torch.int8)[1, 1] == -8
    for dtype in (torch.uint8, torch.bool):
        with pytest.raises(ValueCheckError, match="get_laplacian_kernel2d: expected a dtype that holds -8"):
            F.get_laplacian_kernel2d(3, dtype=dtype)
    with pytest.raises(ValueCheckError, match="holds -168"):
        F.get_laplacian_kernel2d(13, dtype=torch.int8)


# --- bad input ---


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: F.get_gaussian_kernel1d(4, 1.0),
            ValueCheckError,
            "get_gaussian_kernel1d: expected kernel_size to be odd",
        ),
        (lambda: F.get_gaussian_kernel1d(-3, 1.0), ValueCheckError, "at least 1"),
        (lambda: F.get_gaussian_kernel1d(3.0, 1.0), TypeCheckError, "get_gaussian_kernel1d: expected kernel_size"),
        (lambda: F.get_gaussian_kernel1d(3, -1.0), ValueCheckError, "expected sigma to be a non-negative number"),
        (lambda: F.get_gaussian_kernel1d(3, float("nan")), ValueCheckError, "got nan"),
        (lambda: F.get_gaussian_kernel1d(3, [[1.0]]), TypeCheckError, "get_gaussian_kernel1d: expected sigma"),
        (lambda: F.get_gaussian_kernel1d(3, torch.ones(3)), ShapeError, r"of shape \(B, 1\), got \(3,\)"),
        (lambda: F.get_gaussian_kernel1d(3, 1.0, dtype=torch.int32), TypeCheckError, "floating-point dtype"),
        (lambda: F.gaussian(0, 1.0), ValueCheckError, "gaussian: expected window_size"),
        (lambda: F.gaussian(3, torch.ones(2, 1), mean=torch.ones(2)), ShapeError, "gaussian: expected mean"),
        (lambda: F.get_gaussian_kernel2d(3, (1.0, 1.0, 1.0)), ValueCheckError, "2 non-negative numbers"),
        (
            lambda: F.get_gaussian_kernel2d((3, 3, 3), (1.0, 1.0)),
            ValueCheckError,
            "get_gaussian_kernel2d: expected kernel",
        ),
        (lambda: F.get_gaussian_kernel3d(3, torch.ones(1, 2)), ShapeError, "get_gaussian_kernel3d: expected sigma"),
        (lambda: F.get_gaussian_erf_kernel1d(3, 0.0), ValueCheckError, "a positive number"),
        (lambda: F.get_gaussian_discrete_kernel1d(4, 1.0, True), ValueCheckError, "to be odd"),
        (lambda: F.get_box_kernel1d(0), ValueCheckError, "get_box_kernel1d: expected kernel_size"),
        (lambda: F.get_box_kernel2d(3, dtype=torch.int32), TypeCheckError, "get_box_kernel2d"),
        (lambda: F.get_laplacian_kernel1d(1), ValueCheckError, "at least 3 along an axis"),
        (lambda: F.get_laplacian_kernel2d((1, 1)), ValueCheckError, "at least 3 along an axis"),
        (lambda: F.get_laplacian_kernel2d(4), ValueCheckError, "to be odd"),
        (lambda: F.get_hanning_kernel1d(2), ValueCheckError, "at least 3"),
        (lambda: F.get_hanning_kernel2d((3, 2)), ValueCheckError, "at least 3"),
        (lambda: F.get_binary_kernel2d("3"), TypeCheckError, "get_binary_kernel2d: expected window_size"),
        (lambda: F.get_spatial_gradient_kernel2d("prewitt", 1), ValueCheckError, "mode must be one of sobel, diff"),
        (lambda: F.get_spatial_gradient_kernel2d("sobel", 3), ValueCheckError, "order must be one of 1, 2; got 3"),
        (lambda: F.get_spatial_gradient_kernel3d("sobel", 1), NotImplementedError, "'sobel' is not implemented in 3-D"),
        (lambda: F.get_spatial_gradient_kernel3d("diff", 1, dtype=torch.int32), TypeCheckError, "floating-point"),
    ],
)
def test_bad_input(call, error, message):
    with pytest.raises(error, match=message):
        call()
