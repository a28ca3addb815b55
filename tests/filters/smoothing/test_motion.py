"""Motion kernels and blurs against Kornia and against drawn lines."""

import itertools

import kornia
import pytest
import torch

import kvision as K
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close
from point_op_tests import Call, PointOpTests, vector

F, KF = K.filters, kornia.filters
ANGLES = (0.0, 30.0, 45.0, 90.0, 135.0, 200.0, -77.3, 360.0)
DIRECTIONS = (-1.0, -0.3, 0.0, 0.5, 1.0, 2.0)
ANGLES_3D = ((0.0, 0.0, 0.0), (30.0, 0.0, 0.0), (0.0, 90.0, 0.0), (0.0, 0.0, 45.0), (10.0, 20.0, -77.3), (0, 1e-9, 0))


class TestMotionKernelOperator(PointOpTests):
    calls = {
        "motion_kernel": [
            Call((vector(1, scale=100), vector(1)), (5, 1), accepted=("taps 0",)),
            Call((vector(1, scale=100), vector(1)), (5, 2), accepted=("taps 0",)),
            Call((vector(3, scale=100), vector(1)), (3, 1), accepted=("taps 0",)),
            Call((vector(3, scale=100), vector(1)), (3, 0), differentiable=False, accepted=("taps 0",)),
        ]
    }


@pytest.mark.parametrize("mode", ["nearest", "bilinear", "bicubic"])
@pytest.mark.parametrize("size", [3, 5, 9])
def test_kernel2d_against_kornia(size, mode, device):
    angle, direction = torch.tensor(list(itertools.product(ANGLES, DIRECTIONS)), dtype=torch.float64).t()
    actual = F.get_motion_kernel2d(size, angle.to(device), direction.to(device), mode)
    assert_close(actual.cpu(), KF.get_motion_kernel2d(size, angle, direction, mode))
    assert_close(F.get_motion_kernel2d(size, 33.0, 0.4, mode), KF.get_motion_kernel2d(size, 33.0, 0.4, mode))


@pytest.mark.parametrize("mode", ["nearest", "bilinear"])
@pytest.mark.parametrize("size", [3, 5, 9])
def test_kernel3d_against_kornia(size, mode, device):
    angle = torch.tensor(ANGLES_3D, dtype=torch.float64)
    for d in DIRECTIONS:
        direction = torch.full((len(angle),), d, dtype=torch.float64)
        actual = F.get_motion_kernel3d(size, angle.to(device), direction.to(device), mode)
        assert_close(actual.cpu(), KF.get_motion_kernel3d(size, angle, direction, mode), atol=1e-7)


def test_kernel_is_the_line_one_would_draw(device):
    diagonal = F.get_motion_kernel2d(3, torch.tensor([45.0], device=device), 0.0)[0]
    assert_close(diagonal, torch.eye(3, device=device).flip(0) / 3)  # counter-clockwise: up to the right
    left = F.get_motion_kernel2d(5, torch.tensor([0.0], device=device), 1.0)[0, 2]
    assert_close(left, torch.tensor([0.4, 0.3, 0.2, 0.1, 0.0], device=device))
    up = F.get_motion_kernel2d(5, torch.tensor([90.0], device=device), -1.0)[0, :, 2]
    assert_close(up, torch.tensor([0.4, 0.3, 0.2, 0.1, 0.0], device=device))  # the right end turned upwards


def test_numbers_and_tensors_mix(device):
    angle = torch.tensor([10.0, 80.0], device=device)
    both = F.get_motion_kernel2d(5, angle, torch.tensor([0.5, 0.5], device=device))
    assert_close(F.get_motion_kernel2d(5, angle, 0.5), both)
    assert_close(F.get_motion_kernel2d(5, angle, torch.tensor(0.5, device=device)), both)
    assert_close(F.get_motion_kernel2d(5, angle[1], 0.5), both[1:])
    spatial = F.get_motion_kernel3d(5, torch.tensor([0.0, 0.0, 10.0], device=device), 0.5)
    assert_close(spatial[:, 2], both[:1])
    assert F.get_motion_kernel2d(5, angle.half()).dtype == torch.float16
    assert F.get_motion_kernel2d(5, angle.long()).dtype == torch.float32


@pytest.mark.parametrize("border", ["constant", "reflect", "replicate", "circular"])
@pytest.mark.parametrize("mode", ["nearest", "bilinear"])
def test_blur_against_kornia(border, mode, device):
    x = torch.rand(2, 3, 12, 11, dtype=torch.float64, device=device)
    angle = torch.tensor([15.0, 100.0], dtype=torch.float64, device=device)
    direction = torch.tensor([0.2, -0.7], dtype=torch.float64, device=device)
    for a, d in ((33.0, 0.4), (angle, direction)):
        actual = F.motion_blur(x, 5, a, d, border, mode)
        assert_close(actual, KF.motion_blur(x, 5, a, d, border, mode))
        assert_close(F.MotionBlur(5, a, d, border, mode)(x), actual)


@pytest.mark.parametrize("mode", ["nearest", "bilinear"])
def test_blur3d_against_kornia(mode, device):
    x = torch.rand(2, 2, 6, 7, 8, dtype=torch.float64, device=device)
    angle = torch.tensor([[15.0, 0.0, 100.0], [0.0, 30.0, 0.0]], dtype=torch.float64, device=device)
    direction = torch.tensor([0.2, -0.7], dtype=torch.float64, device=device)
    for a, d in (((10.0, 20.0, 30.0), 0.4), (angle, direction)):
        actual = F.motion_blur3d(x, 3, a, d, "replicate", mode)
        assert_close(actual, KF.motion_blur3d(x, 3, a, d, "replicate", mode), atol=1e-8)
        assert_close(F.MotionBlur3D(3, a, d, "replicate", mode)(x), actual)
    assert_close(F.MotionBlur3D(3, 10.0, 0.0)(x), KF.MotionBlur3D(3, 10.0, 0.0)(x))


def test_gradients_of_the_parameters(device):
    direction = torch.tensor([0.2, -0.7], dtype=torch.float64, device=device, requires_grad=True)
    angle = torch.tensor([15.0, 100.0], dtype=torch.float64, device=device, requires_grad=True)
    for mode in ("bilinear", "bicubic"):
        assert torch.autograd.gradcheck(
            lambda a, d, mode=mode: F.get_motion_kernel2d(5, a, d, mode), (angle, direction)
        )
    assert torch.autograd.gradcheck(lambda d: F.get_motion_kernel2d(5, 33.0, d), direction)
    turned = torch.tensor(
        [[15.0, 0.0, 100.0], [3.0, 30.0, 5.0]], dtype=torch.float64, device=device, requires_grad=True
    )
    assert torch.autograd.gradcheck(lambda a, d: F.get_motion_kernel3d(3, a, d, "bilinear"), (turned, direction))
    still = torch.zeros(1, 3, dtype=torch.float64, device=device, requires_grad=True)
    F.get_motion_kernel3d(3, still, 0.5, "bilinear").square().sum().backward()
    assert still.grad.isfinite().all()


def test_bytes_stay_bytes(device):
    x = torch.randint(0, 256, (1, 3, 9, 8), device=device, dtype=torch.uint8)
    assert torch.equal(F.motion_blur(x, 3, 0.0, 0.0), F.motion_blur(x.float(), 3, 0.0, 0.0).round().byte())


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: F.get_motion_kernel2d(4, 0.0), ValueCheckError, "get_motion_kernel2d: expected kernel_size to be odd"),
        (lambda: F.get_motion_kernel2d(1, 0.0), ValueCheckError, "at least 3"),
        (
            lambda: F.get_motion_kernel2d((3, 5), 0.0),
            TypeCheckError,
            "get_motion_kernel2d: expected kernel_size to be an int",
        ),
        (lambda: F.get_motion_kernel2d(3, float("nan")), ValueCheckError, "expected angle to be 1 finite"),
        (lambda: F.get_motion_kernel2d(3, "0"), TypeCheckError, "expected angle to be a Tensor or numbers, got '0'"),
        (lambda: F.get_motion_kernel2d(3, 0.0, None), TypeCheckError, "expected direction"),
        (lambda: F.get_motion_kernel2d(3, 0.0, 0.0, "cubic"), ValueCheckError, "mode must be one of"),
        (lambda: F.get_motion_kernel2d(3, torch.zeros(2), torch.zeros(3)), ShapeError, "of one length, got 2 and 3"),
        (lambda: F.get_motion_kernel2d(3, torch.zeros(2, 2)), ShapeError, "get_motion_kernel2d: expected angle"),
        (lambda: F.get_motion_kernel2d(3, torch.zeros(1), torch.zeros(1, device="meta")), DeviceError, "one device"),
        (lambda: F.get_motion_kernel3d(3, (0.0, 0.0)), ValueCheckError, "get_motion_kernel3d: expected angle"),
        (lambda: F.get_motion_kernel3d(3, torch.zeros(2, 2)), ShapeError, "get_motion_kernel3d: expected angle"),
        (lambda: F.get_motion_kernel3d(3, (0.0, 0.0, 0.0), mode="bicubic"), ValueCheckError, "mode must be one of"),
        (lambda: F.motion_blur([1.0], 3, 0.0, 0.0), TypeCheckError, "motion_blur: expected input to be a Tensor"),
        (lambda: F.motion_blur(torch.rand(4, 4), 3, 0.0, 0.0), ShapeError, "motion_blur: expected input of shape"),
        (lambda: F.motion_blur(torch.rand(1, 1, 4, 4), 3, 0.0, 0.0, "mirror"), ValueCheckError, "motion_blur: border"),
        (lambda: F.motion_blur(torch.rand(1, 1, 4, 4), 9, 0.0, 0.0), ShapeError, "motion_blur: expected input larger"),
        (lambda: F.motion_blur(torch.rand(3, 1, 4, 4), 3, torch.zeros(2), 0.0), ShapeError, "motion_blur: .* got 2"),
        (lambda: F.motion_blur3d(torch.rand(1, 1, 4, 4), 3, (0, 0, 0), 0), ShapeError, "motion_blur3d: expected input"),
    ],
)
def test_bad_input(call, error, message):
    with pytest.raises(error, match=message):
        call()
