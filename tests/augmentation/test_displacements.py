"""Displacements of elastic transforms: noise after a blur, by one operator."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kvision import augmentation as A
from kvision import backend
from kvision.augmentation.displacements import blur_settings, elastic_displacements
from kvision.augmentation.keys import Keys
from kvision.augmentation.noise import PixelNoise
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.filters import gaussian_blur2d
from op_tests import OpTests, assert_close


def blurred_noise(input, kernel_size, sigma, scale):
    """The operator with the checks of its callers."""
    if not isinstance(input, Tensor) or input.is_complex():
        raise TypeCheckError("blurred_noise: expected noise")
    if input.dim() != 4 or 0 in input.shape[2:]:
        raise ShapeError("blurred_noise: expected noise of shape (B, 2, H, W)")
    x = input if input.is_floating_point() else input.float()
    return elastic_displacements(x, None, blur_settings(kernel_size, sigma), scale)


class TestElasticDisplacements(OpTests):
    function = staticmethod(blurred_noise)
    operators = ("elastic_displacements", "gaussian_blur2d_backward")
    channels = 2
    max_size = 17
    shape = (3, 2, 13, 20)
    small = (1, 2, 4, 5)
    variants = [
        {"kernel_size": (5, 7), "sigma": (1.5, 2.0), "scale": (3.0, -2.0)},
        {"kernel_size": (63, 63), "sigma": (16.0, 8.0), "scale": (30.0, 20.0)},
        {"kernel_size": (65, 3), "sigma": (2.0, 2.0), "scale": (1.0, 1.0)},
    ]


def source(keys: list[int], seeds: list[int] | None = None, same: bool = False, device: str = "cpu") -> PixelNoise:
    seeds_of_samples = None if seeds is None else torch.tensor(seeds)
    return PixelNoise(Keys(torch.tensor(keys), seeds_of_samples, seeds is not None), 0, same, torch.device(device))


@pytest.mark.parametrize("size", [(1, 4), (37, 60), (130, 264), (200, 7), (512, 128)], ids=str)
@pytest.mark.parametrize("kernel", [(3, 5), (63, 63), (31, 9), (33, 47), (99, 3)], ids=str)
def test_drawn_noise_equals_noise_as_an_argument(size, kernel, device):
    """Displacements of drawn noise, and of the same noise as an argument, have the same bits."""
    like = torch.empty(1, device=device).expand(3, 2, *size)
    blur, scale = blur_settings(kernel, (7.0, 5.0)), (11.0, 13.0)
    for noise_source in (source([5]), source([0], [3, 4, 5]), source([6], same=True)):
        noise_source = noise_source._replace(device=torch.device(device))
        drawn = elastic_displacements(like, noise_source, blur, scale)
        noise = noise_source.symmetric((3, 2, *size))
        assert torch.equal(drawn, elastic_displacements(noise, None, blur, scale))
        expected = gaussian_blur2d(noise.double(), kernel, (7.0, 5.0), "constant")
        expected = expected * torch.tensor([11.0, 13.0], dtype=torch.float64, device=device)[:, None, None]
        assert_close(drawn, expected.float(), 1e-5, 2e-5)
    with backend("reference"):
        assert_close(elastic_displacements(like, noise_source, blur, scale), drawn, 1e-5, 2e-5)


def test_keys_on_the_device(device):
    like = torch.empty(1, device=device).expand(2, 2, 20, 24)
    on_host = source([9])._replace(device=torch.device(device))
    on_device = on_host._replace(keys=on_host.keys._replace(keys=on_host.keys.keys.to(device)))
    a, b = (
        elastic_displacements(like, noise_source, blur_settings(9, 2.0), (1.0, 1.0))
        for noise_source in (on_host, on_device)
    )
    assert torch.equal(a, b)


def test_sigma_may_be_learned(device):
    sigma = torch.tensor([[2.0, 3.0]], device=device, requires_grad=True)
    noise = torch.rand(2, 2, 16, 12, device=device) - 0.5
    moved = elastic_displacements(noise, None, blur_settings((7, 7), sigma), (2.0, 3.0))
    assert_close(moved, elastic_displacements(noise, None, blur_settings((7, 7), (2.0, 3.0)), (2.0, 3.0)))
    assert torch.autograd.grad(moved.square().sum(), sigma)[0].abs().min() > 0


@pytest.mark.parametrize("p", [0.6, 1.0])
def test_windows_of_each_image_of_a_list_have_the_gradients_of_learned_deviations(
    p: float, device: torch.device
) -> None:
    sigma = torch.tensor([[20.0, 30.0]], device=device, requires_grad=True)
    augment = A.RandomElasticTransform((63, 31), sigma, (2.0, 3.0), scale_window=True, p=p)
    images = [torch.rand(2, h, w, device=device) for h, w in ((40, 30), (17, 64), (300, 9), (1, 5))]
    seeds = torch.arange(len(images), device=device)
    results = augment(images, seed=seeds)
    alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(images)]
    for own, expected in zip(results, alone):
        assert_close(own, expected, 1e-5, 1e-4)
    of_list, of_each = (torch.autograd.grad(sum(y.sum() for y in ys), sigma)[0] for ys in (results, alone))
    assert_close(of_list, of_each, 1e-3, 1e-3)
