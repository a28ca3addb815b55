"""Lines of rain."""

import pytest
import torch

from kvision.augmentation.corruption.rain import rain_mask
from point_op_tests import Call, PointOpTests


def drops() -> torch.Tensor:
    return torch.stack([torch.randint(0, 6, ()), torch.randint(1, 5, ()), torch.randint(-3, 4, ())])


class TestRainMaskOperators(PointOpTests):
    calls = {
        "rain_mask": [
            Call(
                (drops, lambda: torch.rand(5, 2)),
                ([9, 8], 4),
                broadcasts=False,
                differentiable=False,
                dtypes=(torch.float32,),
                accepted=("of torch.int64", "size", "longest"),
            )
        ]
    }


@pytest.mark.parametrize("size", [(21, 6), (64, 65), (224, 100)], ids=str)
def test_masks_are_those_of_the_reference(size, device):
    drops = torch.tensor([[0, 5, 3], [40, 1, 0], [300, 20, -5], [200, 3, 5], [300, 7, 1]])
    positions = torch.rand(5, 300, 2)
    positions[:, 0], positions[:, 1] = 0, 1
    y = rain_mask(drops.to(device), positions.to(device), list(size), 20).cpu()
    assert torch.equal(y, rain_mask.reference(drops, positions, list(size), 20))
    assert not y[0].any() and int(y[1].sum()) <= 40


def test_lines_join_their_ends(device):
    """A drop of 4 x 3 pixels that leans to the left begins at the right and ends below, one column less each third of the way."""
    y = rain_mask(torch.tensor([[1, 4, -3]]).to(device), torch.zeros(1, 1, 2).to(device), [4, 3], 4)[0, 0].cpu()
    assert y.nonzero().tolist() == [[0, 2], [1, 2], [2, 1], [3, 0]]
