"""in_range against OpenCV and Kornia."""

import cv2
import kornia
import numpy as np
import pytest
import torch

import kvision as K
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError

in_range = K.filters.in_range
LOWER, UPPER = (0.2, 0.1, 0.3), (0.8, 0.9, 0.7)


def test_mask_against_opencv(device):
    image = np.random.default_rng(0).integers(0, 256, (31, 40, 3), dtype=np.uint8)
    expected = cv2.inRange(image, (10, 20, 30), (200, 255, 140)) // 255
    x = torch.from_numpy(image).permute(2, 0, 1)[None].to(device)
    mask = in_range(x, (10, 20, 30), (200, 255, 140), return_mask=True)
    assert mask.dtype == torch.uint8 and torch.equal(mask[0, 0].cpu(), torch.from_numpy(expected))
    assert torch.equal(in_range(x, (10, 20, 30), (200, 255, 140)), x * mask)


@pytest.mark.parametrize("return_mask", [False, True])
@pytest.mark.parametrize("shape", [(2, 3, 6, 5), (3, 6, 5), (6, 5)], ids=str)
def test_against_kornia(shape, return_mask, device):
    x = torch.rand(shape)
    channels = shape[-3] if len(shape) > 2 else 1
    lower, upper = LOWER[:channels], UPPER[:channels]
    expected = kornia.filters.in_range(x, lower, upper, return_mask)
    assert torch.equal(in_range(x.to(device), lower, upper, return_mask).cpu(), expected)
    assert torch.equal(K.filters.InRange(lower, upper, return_mask)(x.to(device)).cpu(), expected)


@pytest.mark.parametrize("shape", [(), (1,), (3,), (1, 5), (3, 1, 1), (3, 6, 5), (2, 3, 1, 1), (2, 1, 6, 5)], ids=str)
def test_bounds_that_are_tensors(shape, device):
    x, lower = torch.rand(2, 3, 6, 5), torch.rand(shape) / 2
    expected = kornia.filters.in_range(x, lower, lower + 0.5)
    assert torch.equal(in_range(x.to(device), lower.to(device), (lower + 0.5).to(device)).cpu(), expected)


def test_integers_compare_exactly(device):
    x = torch.tensor([[[0, 10, 20, 200, 255]]], dtype=torch.uint8, device=device)

    def mask(lower, upper):
        return in_range(x, lower, upper, return_mask=True).flatten().tolist()

    assert mask((10.5,), (300,)) == [0, 0, 1, 1, 1]
    assert mask((-3,), (20,)) == [1, 1, 1, 0, 0]
    bounds = torch.tensor([10.5, 300.0], device=device)
    assert mask(bounds[0], bounds[1]) == [0, 0, 1, 1, 1]
    large = torch.tensor([[[2**24, 2**24 + 1]]], device=device)
    assert in_range(large, (2**24 + 0.5,), (2**25,), return_mask=True).flatten().tolist() == [0, 1]


def test_nan_is_outside(device):
    x = torch.tensor([[[float("nan"), 0.5]]], device=device)
    assert in_range(x, (0.0,), (1.0,)).flatten().tolist() == [0, 0.5]
    assert in_range(x, (float("nan"),), (1.0,)).flatten().tolist() == [0, 0]


def test_empty(device):
    assert in_range(torch.rand(0, 3, 4, 5, device=device), LOWER, UPPER, True).shape == (0, 1, 4, 5)
    assert in_range(torch.rand(2, 0, 4, 5, device=device), (), ()).shape == (2, 0, 4, 5)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (([1.0], LOWER, UPPER), TypeCheckError, "in_range: expected input to be a Tensor, got list"),
        ((torch.rand(5), LOWER, UPPER), ShapeError, "in_range: expected input of shape"),
        ((torch.rand(1, 1, 3, 4, 5), LOWER, UPPER), ShapeError, "in_range: expected input of shape"),
        ((torch.rand(3, 4, 5), LOWER[:2], UPPER), ValueCheckError, "of 3 numbers, one a channel, got 2 and 3"),
        (
            (torch.rand(3, 4, 5), LOWER, torch.rand(3)),
            TypeCheckError,
            "both tuples or both tensors, got tuple and Tensor",
        ),
        ((torch.rand(3, 4, 5), 0.1, 0.9), TypeCheckError, "both tuples or both tensors, got float and float"),
        ((torch.rand(3, 4, 5), torch.rand(2), torch.rand(3)), ShapeError, r"lower to broadcast to \(3, 4, 5\), got"),
        ((torch.rand(3, 4, 5), *[torch.rand(1, 3, 4, 5)] * 2), ShapeError, "lower to broadcast"),
        ((torch.rand(3, 4, 5), *[torch.rand(3, device="meta")] * 2), DeviceError, "lower on meta"),
        ((torch.rand(3, 4, 5), LOWER, UPPER, 1), TypeCheckError, "expected return_mask to be a bool, got 1"),
    ],
)
def test_bad_input(arguments, error, message):
    with pytest.raises(error, match=message):
        in_range(*arguments)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_types_compare_in_float32(dtype, device):
    """0.1 in half is below or above the float32 0.1: a bound is not rounded to the type of the image."""
    x = torch.tensor([0.1, 0.2, 0.3], device=device).to(dtype).reshape(1, 1, 1, 3)
    expected = ((x.float() >= 0.1) & (x.float() <= 0.3)).to(dtype)
    assert not expected.all()
    assert torch.equal(K.filters.in_range(x, (0.1,), (0.3,), return_mask=True), expected)
    bounds = torch.tensor([0.1], device=device), torch.tensor([0.3], device=device)
    assert torch.equal(K.filters.in_range(x, *bounds, return_mask=True), expected)
