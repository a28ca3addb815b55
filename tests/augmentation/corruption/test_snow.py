"""Images in snow."""

import pytest
import torch
from torch import Tensor

from kvision.augmentation.corruption.snow import add_snow
from op_tests import OpTests


class TestAddSnow(OpTests):
    operators = ("add_snow",)
    bytes = True
    variants = [
        {"flakes": lambda x: 0.2 * torch.rand(x.shape[0], 1, *x.shape[2:]), "weight": weight} for weight in (0.7, 0.3)
    ]
    mixed = ("flakes", "images")
    tolerances = {torch.uint8: (0, 1)}  # sums in another order round to the other byte

    @staticmethod
    def function(x: Tensor, flakes: Tensor, weight: float) -> Tensor:
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        own = torch.float64 if x.dtype == torch.float64 else torch.float32
        steps = (255 * flakes).floor() + 0.25  # far from where they are rounded up
        return add_snow(x, (steps / 255).to(own), weight)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_flakes_are_seen_twice(channels, layout, device):
    x = torch.full((2, channels, 41, 37), 0.25).contiguous(memory_format=layout)
    flakes = torch.zeros(2, 1, 41, 37)
    flakes[1, 0, 3, 5] = 0.2
    y = add_snow(x.to(device), flakes.to(device), 0.5).cpu()
    gray = 0.25 + 0.5 * (1.5 * 0.25 + 0.5 - 0.25)
    assert y.is_contiguous(memory_format=layout)
    assert torch.allclose(y[0], torch.full_like(y[0], gray))
    lit = (y[1] > gray + 0.1).nonzero().tolist()
    assert lit == [[c, *at] for c in range(channels) for at in ([3, 5], [37, 31])]
