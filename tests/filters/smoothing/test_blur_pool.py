"""Blur pools against Kornia and plain convolutions."""

import kornia
import pytest
import torch

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close

F, KF = K.filters, kornia.filters


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 9])
@pytest.mark.parametrize("stride", [1, 2, 3])
def test_against_kornia(size, stride, device):
    for shape in ((2, 3, 11, 9), (1, 1, 1, 8), (1, 2, 2, 2)):
        x = torch.rand(shape, dtype=torch.float64, device=device)
        assert_close(F.blur_pool2d(x, size, stride), KF.blur_pool2d(x, size, stride))
        assert_close(F.BlurPool2D(size, stride)(x), F.blur_pool2d(x, size, stride))
        for pool in range(1, min(4, *shape[2:])):
            actual = F.max_blur_pool2d(x, size, stride, pool)
            assert_close(actual, KF.max_blur_pool2d(x, size, stride, pool))
            assert_close(F.MaxBlurPool2D(size, stride, pool)(x), actual)


def test_sizes_differ_by_axis(device):
    x = torch.rand(2, 3, 11, 9, dtype=torch.float64, device=device)
    expected = F.filter2d_separable(
        x,
        torch.tensor([[0.5, 0.5]], dtype=torch.float64, device=device),
        torch.tensor([[0.25, 0.5, 0.25]], dtype=torch.float64, device=device),
        "constant",
    )
    assert_close(F.blur_pool2d(x, (3, 2), 2), expected[..., ::2, ::2])


@pytest.mark.parametrize("size", [1, 2, 3, 5, 7])
@pytest.mark.parametrize(("threshold", "dilation"), [(1.05, 1), (1.25, 3), (2.0, 3), (1.25, 5)])
def test_edge_aware_against_kornia(size, threshold, dilation, device):
    x = torch.rand(2, 3, 25, 22, dtype=torch.float64, device=device)
    actual = F.edge_aware_blur_pool2d(x, size, threshold, dilation)
    assert_close(actual, KF.edge_aware_blur_pool2d(x, size, threshold, dilation))
    assert_close(F.EdgeAwareBlurPool2D(size, threshold, dilation)(x), actual)


def test_edge_aware_blurs_texture_and_keeps_edges(device):
    x = torch.full((1, 1, 16, 16), 0.5, device=device)
    x[..., ::2, ::2] = 0.52
    x[..., 8:] *= 4
    y = F.edge_aware_blur_pool2d(x, 3)
    assert torch.equal(y[..., 7:9], x[..., 7:9])
    assert y[..., 1:-1, 1:4].std() < 0.2 * x[..., 1:-1, 1:4].std()


@pytest.mark.parametrize("pool", [F.blur_pool2d, F.max_blur_pool2d, F.edge_aware_blur_pool2d])
def test_half_types_compute_in_float32(pool, device):
    x = torch.rand(2, 3, 12, 13, device=device)
    for dtype in (torch.float16, torch.bfloat16):
        assert_close(pool(x.to(dtype), 5), pool(x.to(dtype).float(), 5).to(dtype))


def test_ceil_mode_is_deprecated(device):
    with pytest.warns(DeprecationWarning, match="ceil_mode"):
        F.max_blur_pool2d(torch.rand(1, 1, 4, 4, device=device), 3, ceil_mode=True)


@pytest.mark.parametrize("name", ["blur_pool2d", "max_blur_pool2d", "edge_aware_blur_pool2d"])
def test_bad_input(name):
    pool = getattr(F, name)
    x = torch.rand(1, 1, 6, 6)
    for arguments, error, message in [
        ((None, 3), TypeCheckError, "expected input to be a Tensor"),
        ((x[0], 3), ShapeError, r"expected input of shape \(B, C, H, W\)"),
        ((x, 0), ValueCheckError, "expected kernel_size"),
        ((x, 2.0), TypeCheckError, "expected kernel_size"),
    ]:
        with pytest.raises(error, match=f"^{name}: .*{message}"):
            pool(*arguments)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda x: F.blur_pool2d(x, 3, 0), ValueCheckError, "blur_pool2d: expected stride"),
        (lambda x: F.max_blur_pool2d(x, 3, 2, 7), ValueCheckError, "max_pool_size no larger than the input, got 7"),
        (lambda x: F.edge_aware_blur_pool2d(x, 3, 1.0), ValueCheckError, "edge_threshold above 1, got 1.0"),
        (
            lambda x: F.edge_aware_blur_pool2d(x, 3, float("nan")),
            ValueCheckError,
            "edge_threshold to be a float32 number, got nan",
        ),
        (lambda x: F.edge_aware_blur_pool2d(x, 3, 1.25, 2), ValueCheckError, "edge_dilation_kernel_size to be odd"),
        (
            lambda x: F.edge_aware_blur_pool2d(x[..., :2], 3),
            ShapeError,
            "edge_aware_blur_pool2d: .* 'reflect' border of 2",
        ),
    ],
)
def test_bad_options(call, error, message):
    with pytest.raises(error, match=message):
        call(torch.rand(1, 1, 6, 6))


def test_advice_of_edge_aware_blurring_can_be_followed():
    """Edges need two pixels around an image whatever the kernel; only what the kernel needs is cured by a smaller one."""
    with pytest.raises(ShapeError, match="'reflect' border of 2 pixels, got .*; pad to 3 x 3 pixels"):
        F.edge_aware_blur_pool2d(torch.rand(1, 1, 2, 9), 1)
    with pytest.raises(ShapeError, match="'reflect' border of 4 pixels, got .*; use a smaller kernel_size"):
        F.edge_aware_blur_pool2d(torch.rand(1, 1, 3, 9), 9)
    assert F.edge_aware_blur_pool2d(torch.rand(1, 1, 3, 9), 5).shape == (1, 1, 3, 9)


@pytest.mark.parametrize("name", ["blur_pool2d", "max_blur_pool2d", "edge_aware_blur_pool2d"])
def test_integers_compute_in_float32(name, device):
    x, pool = torch.randint(0, 256, (1, 2, 8, 9), device=device), getattr(K.filters, name)
    for dtype in (torch.uint8, torch.int64):
        assert_close(pool(x.to(dtype), 3), pool(x.float(), 3))
