"""The noise of a sensor: the same on all devices, in all layouts and types."""

import pytest
import torch
from torch import Tensor

from kvision import augmentation as A
from kvision.augmentation.corruption.noises import iso_noise
from op_tests import OpTests, assert_close

KEYS = torch.tensor([0x123456789ABCDEF, -3])
PLAN = (1, 2, 3, 0)


class TestIsoNoise(OpTests):
    operators = ("iso_noise", "iso_noise_backward")
    bytes = True
    channels = 3
    small = (1, 3, 4, 5)
    variants = [
        {
            "parameters": lambda x: torch.tensor([[0.05, 0.5]]).expand(x.shape[0], 2),
            "seeds": lambda x: torch.arange(x.shape[0]) * 7919 - 3,
        }
    ]
    accepted = ("keys of torch.int64", "keys of another batch", "seeds of torch.int64")
    tolerances = {torch.uint8: (0, 1), torch.float32: (2e-5, 2e-5)}

    @staticmethod
    def function(x: Tensor, parameters: Tensor, seeds: Tensor) -> Tensor:
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        own = torch.float64 if x.dtype == torch.float64 else torch.float32
        return iso_noise(x, parameters.to(own), KEYS[:1], seeds, None, None, (0, *PLAN[1:]))

    def exercise(self, x, kwargs):
        """The gradient of images alone: that of parameters is the reference's, which calls color programs."""
        leaf = x.detach().requires_grad_()
        torch.autograd.grad(self.call(leaf, kwargs).sum(), leaf)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (40, 60), (400, 403)])
def test_many_pixels(size, layout, device):
    """More than one chunk of them, and more than a block has."""
    x = torch.rand(2, 3, *size).to(memory_format=layout)
    columns, chosen = torch.tensor([[0.02, 0.4], [0.1, 3.0]]), torch.tensor([1.0, 0.0])
    arguments = (columns.to(device), KEYS, None, chosen.to(device), None, PLAN)
    y = iso_noise(x.to(device), *arguments)
    expected = iso_noise.reference(x, columns, KEYS, None, chosen, None, PLAN)
    wrong = ((y.cpu() - expected).abs() > 1e-4).float().mean()
    assert wrong < 1e-3, wrong  # numbers beside a step of the counts
    assert torch.equal(y[1].cpu(), x[1]) and y.is_contiguous(memory_format=layout)
    assert torch.equal(y, iso_noise(x.to(device), *arguments))


def test_one_pixel_without_a_number(device):
    """Lightness has no deviation then."""
    x = torch.rand(2, 3, 9, 11, device=device)
    x[0, 1, 3, 4] = float("nan")
    y = iso_noise(x, torch.tensor([[0.1, 0.5]], device=device), KEYS, None, None, None, PLAN)
    assert y[0].isnan().all() and y[1].isfinite().all()


def test_maps_take_the_place_of_words(device):
    x, maps = torch.rand(2, 3, 21, 22), torch.rand(2, 2, 21, 22)
    columns = torch.tensor([[0.1, 0.5]])
    y = iso_noise(x.to(device), columns.to(device), KEYS, None, None, maps.to(device), PLAN).cpu()
    assert_close(y, iso_noise.reference(x, columns, KEYS, None, None, maps, PLAN), 1e-5, 1e-5)


@pytest.mark.parametrize("p", [0.5, 1.0])
def test_iso_noise_refuses_lists_of_other_channels(p, device):
    images = [torch.rand(2, 4, 5, device=device), torch.rand(2, 6, 4, device=device)]
    with pytest.raises(ValueError, match="ISONoise: expected images with 3 channels, got"):
        A.ISONoise(p=p)(images)
