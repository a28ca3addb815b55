"""Images of blocks."""

import pytest
import torch
from torch import Tensor

from kvision._modes import BLOCK_VALUE
from kvision.augmentation.corruption.pixelate import _pixelate_backward as pixelate_backward
from kvision.augmentation.corruption.pixelate import pixelate
from op_tests import OpTests, assert_close


def counts(x: Tensor) -> Tensor:
    """(B, 2): one block, some, as many as pixels, and more."""
    height, width = x.shape[-2:]
    some = torch.tensor([[1, width], [height // 2 + 1, 3], [height + 5, width // 3 + 1], [2, 0]])
    return some.repeat(x.shape[0] // 4 + 1, 1)[: x.shape[0]]


class TestPixelate(OpTests):
    operators = ("pixelate", "pixelate_backward")
    bytes = True
    variants = [{"counts": counts, "value": value} for value in BLOCK_VALUE.values()]
    accepted = ("counts of torch.float32", "value 0")
    mixed = ("counts", "images", "grad")
    tolerances = {torch.uint8: (0, 1)}  # sums in another order round to the other byte

    @staticmethod
    def function(x: Tensor, counts: Tensor, value: int) -> Tensor:
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        return pixelate(x, counts.float(), value)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
def test_blocks_of_random_counts(layout, device):
    """More rows than a block of threads has, and wide ones."""
    x = torch.rand(6, 3, 71, 301).contiguous(memory_format=layout)
    blocks = torch.stack([torch.randint(1, 72, (6,)), torch.randint(1, 302, (6,))], 1).float()
    for value in BLOCK_VALUE.values():
        y = pixelate(x.to(device), blocks.to(device), value).cpu()
        expected = pixelate.reference(x, blocks, value)
        assert_close(y, expected, 1e-5, 1e-5)
        assert y.is_contiguous(memory_format=layout)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
def test_gradients_of_random_counts(layout, device):
    """Of one block, of as many as pixels, and between."""
    grad = torch.rand(6, 3, 71, 301).contiguous(memory_format=layout)
    blocks = torch.stack([torch.randint(1, 72, (6,)), torch.randint(1, 302, (6,))], 1).float()
    blocks[0], blocks[1] = 1, 400
    for value in BLOCK_VALUE.values():
        y = pixelate_backward(grad.to(device), blocks.to(device), value).cpu()
        assert_close(y, pixelate_backward.reference(grad.double(), blocks, value).float(), 1e-4, 1e-5)
        assert y.is_contiguous(memory_format=layout)


def test_means_are_those_of_blocks(device):
    x = torch.arange(6.0, device=device)[None, None, None]
    two, four = torch.tensor([[1.0, 2.0]], device=device), torch.tensor([[1.0, 4.0]], device=device)
    assert pixelate(x, two, BLOCK_VALUE["mean"]).flatten().tolist() == [1, 1, 1, 4, 4, 4]
    # Blocks of 1.5 pixels: the first covers pixel 0 and half of pixel 1, whose center it has.
    first = (
        pixelate(x, four, BLOCK_VALUE["mean"]).flatten()[0],
        pixelate(x, four, BLOCK_VALUE["mean_of_whole"]).flatten()[0],
    )
    assert_close(torch.stack(first).cpu(), torch.tensor([1 / 3, 0.5]))
