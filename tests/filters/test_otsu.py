"""Otsu's threshold against OpenCV, scikit-image and Kornia."""

import cv2
import kornia
import numpy as np
import pytest
import skimage.data
import skimage.filters
import torch

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close

otsu = K.filters.otsu_threshold


@pytest.mark.parametrize("name", ["camera", "coins", "page", "moon"])
def test_photographs_against_opencv_and_skimage(name, device):
    image = getattr(skimage.data, name)()
    image[0, :2] = 0, 255  # 256 bins are then the 256 gray levels, as OpenCV counts
    by_opencv, _ = cv2.threshold(image, 0, 255, cv2.THRESH_OTSU)
    mask, threshold = otsu(torch.from_numpy(image).to(device), return_mask=True)
    assert threshold.tolist() == [by_opencv] == [skimage.filters.threshold_otsu(image)]
    assert torch.equal(mask.cpu(), torch.from_numpy(image > by_opencv))
    thresholded, _ = otsu(torch.from_numpy(image).to(device))
    assert torch.equal(thresholded.cpu(), torch.from_numpy(np.where(image > by_opencv, image, 0).astype(np.uint8)))


@pytest.mark.parametrize("bins", [8, 256])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8, torch.int32, torch.int64], ids=str)
def test_against_kornia(dtype, bins, device):
    x = torch.rand(2, 3, 40, 30) ** 2
    x = (x if dtype.is_floating_point else x * 200).to(dtype)
    image, thresholds = otsu(x.to(device), bins)
    expected_image, expected = kornia.filters.otsu_threshold(x, bins)
    assert thresholds.dtype == dtype and torch.equal(image.cpu(), expected_image)
    torch.testing.assert_close(thresholds.cpu(), expected)


@pytest.mark.parametrize("bins", [8, 32])
def test_gradient_against_kornia(bins, device):
    ours = torch.rand(2, 20, 20, dtype=torch.float64, requires_grad=True)
    theirs = ours.detach().clone().requires_grad_()
    _, thresholds = K.filters.OtsuThreshold()(ours.to(device), bins, slow_and_differentiable=True)
    assert_close(thresholds.detach(), otsu(ours.detach().to(device), bins)[1])
    _, expected = kornia.filters.otsu_threshold(theirs, bins, slow_and_differentiable=True)
    weights = torch.tensor([1.0, -2.0], dtype=torch.float64)
    (thresholds.cpu() * weights).sum().backward()
    (expected * weights).sum().backward()
    assert_close(ours.grad, theirs.grad)


def test_image_keeps_its_gradient(device):
    x = torch.tensor([[0.0, 0.1, 0.8, 0.9]], device=device, requires_grad=True)
    otsu(x)[0].sum().backward()
    assert x.grad.tolist() == [[0, 0, 1, 1]]


@pytest.mark.parametrize("shape", [(12,), (3, 4), (2, 3, 4), (2, 3, 4, 5), (2, 2, 3, 4, 5)], ids=str)
def test_every_plane_has_its_threshold(shape, device):
    x = torch.rand(shape, device=device)
    image, thresholds = otsu(x)
    planes = x.reshape(-1, *shape[-2:]) if len(shape) > 2 else x[None]
    assert image.shape == shape and thresholds.shape == (len(planes),)
    for plane, threshold in zip(planes, thresholds):
        assert_close(otsu(plane)[1], threshold[None])
    rows, original = K.filters.OtsuThreshold().transform_input(x)
    assert original == shape and torch.equal(rows, planes.flatten(1))


def test_bounds_of_the_threshold(device):
    """It separates the parts even where a bright value lies on the edge of its bin, and in coarse types."""
    for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16):
        for bins in (2, 7, 8, 256):
            x = torch.tensor([0, 1, 2, 6, 7, 8.0], device=device, dtype=dtype)
            mask, threshold = otsu(x, bins, return_mask=True)
            assert 2 <= threshold < 6 and mask.tolist() == [False] * 3 + [True] * 3


def test_flat_and_empty(device):
    flat = torch.full((2, 1, 4, 4), 0.3, device=device)
    image, thresholds = otsu(flat, slow_and_differentiable=True)
    assert torch.equal(image, torch.zeros_like(flat)) and torch.equal(thresholds, flat[:, 0, 0, 0])
    for slow in (False, True):
        image, thresholds = otsu(torch.rand(0, 3, 4, 5, device=device), slow_and_differentiable=slow)
        assert image.shape == (0, 3, 4, 5) and thresholds.shape == (0,)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda x: otsu([1.0]), TypeCheckError, "otsu_threshold: expected x to be a Tensor, got list"),
        (lambda x: otsu(x > 0.5), TypeCheckError, "to hold numbers, got torch.bool"),
        (lambda x: otsu(x[None, None, None, None]), ShapeError, "otsu_threshold: expected x of shape"),
        (lambda x: otsu(x[..., :0]), ShapeError, "otsu_threshold: expected x of shape"),
        (lambda x: otsu(x, 1), ValueCheckError, "otsu_threshold: expected nbins"),
        (lambda x: otsu(x, 8.0), TypeCheckError, "otsu_threshold: expected nbins"),
    ],
)
def test_bad_input(call, error, message):
    with pytest.raises(error, match=message):
        call(torch.rand(4, 4))
