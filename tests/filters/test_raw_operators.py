"""torch.ops.kvision.* as C++ and exported programs see them: schemas to read, calls by name.

That they refuse bad arguments is tested with every operator: OpTests.test_operators_refuse_bad_arguments.
"""

from __future__ import annotations

import pytest
import torch

import kvision as K
from kvision import _backend
from kvision._modes import BORDER, COLOR_DISTANCE, DERIVATIVE_MODE
from op_tests import assert_close

SCHEMAS = {
    "sobel": "(Tensor input, bool normalized, float eps) -> Tensor",
    "box_blur": "(Tensor input, int ky, int kx, int border) -> Tensor",
    "gaussian_blur2d": "(Tensor input, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor",
    "median_blur_backward": "(Tensor grad, Tensor input, Tensor output, int ky, int kx, int border) -> Tensor",
    "spatial_gradient": "(Tensor input, int mode, int order, bool normalized) -> Tensor",
    "canny_suppress": "(Tensor input, float low, float high, float eps) -> (Tensor magnitude, Tensor edges)",
}


@pytest.fixture(autouse=True)
def needs_kernels(backend: str, device: torch.device) -> None:
    if backend == "reference" or device.type in _backend.unserved:
        pytest.skip("this test is about the kernels")


@pytest.mark.parametrize("name", SCHEMAS)
def test_schema(name: str) -> None:
    """An exported program holds the schema it was made with: a change here breaks it."""
    assert str(getattr(torch.ops.kvision, name).default._schema) == f"kvision::{name}{SCHEMAS[name]}"


def test_numbers_of_modes_are_stable() -> None:
    """Exported programs hold these numbers."""
    assert BORDER == {"constant": 0, "reflect": 1, "replicate": 2, "circular": 3}
    assert COLOR_DISTANCE == {"l1": 0, "l2": 1}
    assert DERIVATIVE_MODE == {"sobel": 0, "diff": 1}


@pytest.mark.parametrize("border", [-1, 4, 2**40])
def test_unknown_number_of_a_mode(border: int, device: torch.device) -> None:
    x = torch.rand(1, 1, 4, 4, device=device)
    message = r"box_blur: border must be 0 \(constant\), 1 \(reflect\), 2 \(replicate\) or 3 \(circular\), got"
    with pytest.raises(RuntimeError, match=message):
        torch.ops.kvision.box_blur(x, 3, 3, border)
    with pytest.raises(RuntimeError, match=r"spatial_gradient: mode must be 0 \(sobel\) or 1 \(diff\), got"):
        torch.ops.kvision.spatial_gradient(x, border, 1, True)


def test_arguments_by_name(device: torch.device) -> None:
    x = torch.rand(2, 3, 8, 9, device=device)
    sobel = torch.ops.kvision.sobel(input=x, normalized=False, eps=1e-4)
    assert_close(sobel, K.filters.sobel(x, False, 1e-4))
    blurred = torch.ops.kvision.gaussian_blur2d(
        input=x, sigma=None, ky=3, kx=5, sigma_y=1.0, sigma_x=2.0, border=BORDER["reflect"]
    )
    assert_close(blurred, K.filters.gaussian_blur2d(x, (3, 5), (1.0, 2.0)))


def test_wrong_kinds_of_arguments(device: torch.device) -> None:
    """Torch itself compares arguments with the schema."""
    x = torch.rand(1, 1, 4, 4, device=device)
    for args in [
        (),
        (x,),
        (x, True),
        (None, True, 1.0),
        ("x", True, 1.0),
        (x, "yes", 1.0),
        (x, True, "1"),
        (x, True, 1.0, 2),
    ]:
        with pytest.raises((RuntimeError, TypeError), match="sobel"):
            torch.ops.kvision.sobel(*args)


def test_gradients_flow(device: torch.device) -> None:
    """Through the dispatcher, without any function of kvision."""
    a = torch.rand(1, 2, 6, 7, device=device, requires_grad=True)
    b = a.detach().clone().requires_grad_()
    torch.ops.kvision.sobel(a, True, 1e-6).square().sum().backward()
    K.filters.sobel(b).square().sum().backward()
    assert_close(a.grad, b.grad)
    sigma = torch.tensor([[1.0, 2.0]], device=device, requires_grad=True)
    torch.ops.kvision.gaussian_blur2d(a, sigma, 3, 3, 0.0, 0.0, BORDER["reflect"]).square().sum().backward()
    assert sigma.grad.abs().min() > 0
