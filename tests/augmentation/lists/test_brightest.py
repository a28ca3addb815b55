"""The largest values of the images of a list; fog is among what test_statistics_lists.py compares."""

import pytest
import torch

from augmentation.test_lists import SMALL, pictures
from kvision.augmentation.lists.brightest import brightest


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, torch.float64], ids=str)
def test_largest_values(dtype, device):
    images = [*pictures(device, SMALL, dtype), *pictures(device, [(150, 90)], dtype)]
    assert torch.equal(brightest(images), torch.stack([x.amax() for x in images]).to(brightest(images)))
    if dtype != torch.uint8:
        images[1][0, 3, 4], images[2] = torch.nan, -images[2]
        y = brightest(images)
        assert y[1].isnan() and y[2] == 0 and y[0] == images[0].amax()


def test_equal_pixels_share_the_gradient(device):
    images = pictures(device, SMALL)
    images[0][0, :2, 5] = 2.0
    images = [x.requires_grad_() for x in images]
    (gradient, *_) = torch.autograd.grad(brightest(images).sum(), images)
    assert gradient[0, :2, 5].tolist() == [0.5, 0.5] and gradient.sum() == 1
