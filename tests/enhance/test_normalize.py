"""Statistics of every shape."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import kvision as K
from op_tests import assert_close

E = K.enhance


def test_numbers_on_an_image_without_batch():
    """As the paper's example has it: uint8, three axes, plain numbers."""
    image = K.image_to_tensor(np.arange(24, dtype=np.uint8).reshape(2, 4, 3))
    y = K.normalize(image, 0.0, 255.0)
    assert_close(y, image.float() / 255)
    assert K.normalize is E.normalize


@pytest.mark.parametrize("shape", [(), (1,), (3,), (1, 3), (2, 3), (2, 1), (1, 3, 1, 1), (2, 3, 1, 1)], ids=str)
def test_shapes_of_statistics(shape, device):
    x = torch.rand(2, 3, 4, 5, dtype=torch.float64, device=device)
    mean, std = torch.rand(2, *shape, dtype=torch.float64, device=device) + 0.1
    aligned = (s.view(1, 3, 1, 1) if shape == (3,) else s.reshape(*shape, *(1,) * (4 - s.dim())) for s in (mean, std))
    m, s = aligned
    assert_close(E.normalize(x, mean, std), (x - m) / s)
    assert_close(E.denormalize(x, mean, std), x * s + m)
    assert_close(E.denormalize(E.normalize(x, mean, std), mean, std), x)


@pytest.mark.parametrize("trailing", [(), (7,), (4, 5, 6)], ids=str)
def test_channels_are_the_second_axis(trailing, device):
    x = torch.rand(2, 3, *trailing, device=device)
    mean = torch.rand(3, device=device)
    assert_close(E.normalize(x, mean, 0.5), (x - mean.view(3, *(1,) * len(trailing))) / 0.5)


def test_modules_take_lists(device):
    x = torch.rand(2, 3, 4, 5, dtype=torch.float64, device=device)
    module, back = E.Normalize((0.485, 0.456, 0.406), [0.229, 0.224, 0.225]), E.Denormalize((0.485, 0.456, 0.406), 0.2)
    mean = torch.tensor([0.485, 0.456, 0.406], dtype=torch.float64, device=device).view(3, 1, 1)
    std = torch.tensor([0.229, 0.224, 0.225], dtype=torch.float64, device=device).view(3, 1, 1)
    assert_close(module.to(device)(x), (x - mean) / std)
    assert_close(back.to(device)(x), x * 0.2 + mean)
