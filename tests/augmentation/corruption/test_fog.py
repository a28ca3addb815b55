"""Images behind fog."""

import pytest
import torch

from kvision.augmentation.corruption.fog import Fog
from op_tests import assert_close

SIZES = ((7, 9), (16, 20), (1, 33), (24, 5))
NUMBERS = torch.tensor([[0.7, 0.1, 0.9], [1.5, 0.2, 0.8], [0.3, 0.0, 1.0], [2.5, 0.4, 0.5]])  # amount, least, most


def clouds(dtype=torch.float32):
    """A layer of the largest size for each image, within its least and its most."""
    _, low, high = NUMBERS.to(dtype)[:, :, None, None, None].unbind(1)
    return low + (high - low) * torch.rand(len(SIZES), 1, 24, 33, dtype=dtype)


def behind_fog(x, layer, amount, low, high):
    """By the definition, of an image (C, H, W) in [0, 1]: fog is added, then the largest value is what it was."""
    stretched = (layer[:, : x.shape[1], : x.shape[2]] - low) / (high - low)
    most = x.max().clamp(0, 1)
    return ((x + amount * stretched) * most / (most + amount)).clamp(0, 1)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16, torch.uint8], ids=str)
def test_values(dtype, channels, device):
    own = torch.float64 if dtype == torch.float64 else torch.float32
    unit = [(0.2 + 0.15 * b) * torch.rand(channels, *size, dtype=own) for b, size in enumerate(SIZES)]
    images = [(255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype) for x in unit]
    layer, most = clouds(own), 255 if dtype == torch.uint8 else 1
    fog = Fog(layer.to(device), NUMBERS.to(device, own))
    on_device = [x.to(device) for x in images]
    results = fog.on_list(on_device)
    rounding = {torch.uint8: 0.51, torch.float16: 1e-3}.get(dtype, 1e-6)
    for x, y, own_layer, numbers in zip(images, results, layer, NUMBERS.double()):
        assert y.dtype == dtype and y.shape == x.shape
        expected = most * behind_fog(x.double() / most, own_layer.double(), *numbers)
        assert_close(y.cpu().double(), expected, 0, rounding)
    kept = fog.on_list(on_device, torch.tensor([1.0, 0.0, 1.0, 0.0], device=device))
    for b, (x, y) in enumerate(zip(on_device, kept)):
        assert torch.equal(y, x if b % 2 else results[b])


def test_black_images_stay_black(device):
    images = [torch.zeros(3, *size, device=device) for size in SIZES]
    assert all(map(torch.equal, Fog(clouds().to(device), NUMBERS.to(device)).on_list(images), images))


def test_gradients(device):
    """Through the largest value as well, which scales all others."""
    layer, numbers = clouds(torch.float64).to(device), NUMBERS.double().to(device)
    images = [(0.5 * torch.rand(2, *size, dtype=torch.float64)).to(device).requires_grad_() for size in SIZES[:2]]
    fog = Fog(layer[:2], numbers[:2])
    assert torch.autograd.gradcheck(lambda *x: tuple(fog.on_list(x)), images)
    grads = [torch.rand_like(x) for x in images]
    found = torch.autograd.grad(fog.on_list(images), images, grads)
    expected = [behind_fog(x, own, *n) for x, own, n in zip(images, layer, numbers)]
    for a, b in zip(found, torch.autograd.grad(expected, images, grads)):
        assert_close(a, b, 1e-9, 1e-9)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16], ids=str)
def test_gradients_of_batches_are_those_of_lists(dtype, device):
    """And values those of a call without a gradient, in any layout."""
    images = (0.2 + 0.6 * torch.rand(4, 3, 12, 17)).to(device, dtype)
    own = dtype if dtype == torch.float64 else torch.float32
    fog = Fog(clouds(own)[..., :12, :17].to(device), NUMBERS.to(device, own))
    for x in (images, images.contiguous(memory_format=torch.channels_last)):
        leaf = x.clone().requires_grad_()
        y = fog(leaf)
        assert torch.allclose(y, fog(x), atol=1e-6 if dtype != torch.float16 else 1e-3)
        grad = torch.autograd.grad(y, leaf, torch.ones_like(y))[0]
        layer, numbers = fog.layer.clone().requires_grad_(), fog.numbers  # by the reference
        expected = torch.autograd.grad(Fog(layer, numbers)(leaf), leaf, torch.ones_like(y))[0]
        assert_close(grad, expected, 1e-4 if dtype != torch.float16 else 1e-2)
