"""Pixels that read neighbors."""

import pytest
import torch
from torch import Tensor

from kvision.augmentation.corruption.glass import Moves, read_neighbors
from kvision.augmentation.keys import Keys
from kvision.augmentation.noise import PixelNoise
from op_tests import OpTests

KEYS = torch.tensor([0x123456789ABCDEF, -3])
PLAN = (1, 2, 3, 0)


class TestReadNeighbors(OpTests):
    operators = ("read_neighbors",)
    bytes = True
    variants = [
        {"seeds": lambda x: torch.arange(x.shape[0]) * 7919 - 3},
        {"seeds": lambda x: torch.arange(x.shape[0]) * 7919 - 3, "max_delta": 1, "steps": 3},
    ]
    mixed = ("images",)
    accepted = ("max_delta 32768", "keys of torch.int64", "keys of another batch", "seeds of torch.int64")

    @staticmethod
    def function(x: Tensor, seeds: Tensor, max_delta: int = 4, steps: int = 2) -> Tensor:
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        return read_neighbors(x, KEYS[:1], seeds, None, (0, *PLAN[1:]), max_delta, steps)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
def test_the_map_moves_as_the_words_do(layout, device):
    x = torch.rand(3, 2, 37, 53, device=device).to(memory_format=layout)
    drawn = read_neighbors(x, KEYS, None, None, PLAN, 5, 3)
    u = Moves(3).draw(PixelNoise(Keys(KEYS, None, False), 1, False, x.device), (3, 2, 37, 53), 0)
    assert u.shape == (3, 6, 37, 53) and 0 <= u.amin() < 1e-3 and 1 - 1e-3 < u.amax() < 1
    key, _, draw, _ = PixelNoise(Keys(KEYS, None, False), 1, False, x.device).arguments()[3]
    assert torch.equal(
        read_neighbors(x, KEYS, None, u, PLAN, 5, 3), read_neighbors(x, KEYS, None, None, (key, 0, draw, 0), 5, 3)
    )
    assert not torch.equal(drawn[0], drawn[1]) and drawn.is_contiguous(memory_format=layout)


def test_pixels_stay_near(device):
    """Numbers of a step are uniform from -max_delta to max_delta - 1."""
    height, width = 64, 80
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x = torch.stack([rows, columns])[None].float().to(device)
    moved = (read_neighbors(x, KEYS, None, None, PLAN, 4, 1) - x).cpu()[0, :, 4:-4, 4:-4]
    for axis in moved:
        counts = torch.bincount((axis.flatten() + 4).long(), minlength=8)
        expected = axis.numel() / 8
        assert (
            len(counts) == 8 and ((counts - expected) ** 2 / expected).sum() < 29
        )  # of chi squared with 7 degrees: 1e-4
