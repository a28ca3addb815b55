"""Erased rectangles and grids."""

import pytest
import torch
from torch import Tensor

from kvision.augmentation.erase import erase_grid, erase_rectangles, is_erased, is_line
from op_tests import OpTests, assert_close


def boxes(x: Tensor) -> Tensor:
    """(B, 1, 4): some inside, some across the border, some without area."""
    height, width = x.shape[-2:]
    some = torch.tensor(
        [[1, 2, 3, 4], [-2.5, 0.5, 4, 2], [width - 2, height - 1, 9, 9], [0, 0, 0, 3], [0, 0, width, height]]
    )
    return some.repeat(x.shape[0] // 5 + 1, 1)[: x.shape[0], None]


class TestEraseRectangles(OpTests):
    operators = ("erase_rectangles",)
    bytes = True
    variants = [
        {"boxes": lambda x: (2 * boxes(x)).long(), "values": lambda x: torch.rand(x.shape[0], 1)},
        {
            "boxes": lambda x: (2 * torch.cat([boxes(x), boxes(x).flip(0)], 1)).long(),
            "values": lambda x: torch.rand(x.shape[:2]),
        },
    ]
    accepted = ("boxes of torch.float32",)
    mixed = ("boxes",)

    @staticmethod
    def function(x: Tensor, boxes: Tensor, values: Tensor) -> Tensor:
        # Boxes get no gradient, so that the variants have integers: twice the numbers.
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        return erase_rectangles(x, boxes.float() / 2, values)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


def grids(x: Tensor) -> Tensor:
    """(B, 5): lines of all widths, turned and at offsets, of more cells than there are pixels, too."""
    some = torch.tensor(
        [[0.3, 0.0, 0.4, 0.9, 2.0], [0.5, 0.5, 0.0, 1.0, 3.0], [0.0, -2.0, 0.5, 0.5, 40.0], [1.0, 1.0, 0.0, 0.0, 1.0]]
    )
    return some.repeat(x.shape[0] // 4 + 1, 1)[: x.shape[0]]


class TestEraseGrid(OpTests):
    operators = ("erase_grid",)
    bytes = True
    variants = [
        {"grids": lambda x: (10 * grids(x)).long(), "values": lambda x: torch.rand(x.shape[0], 1)},
        {"grids": lambda x: (10 * grids(x)[:1]).long(), "values": lambda x: torch.rand(x.shape[:2])},
    ]
    accepted = ("grids of torch.float32",)
    mixed = ("grids",)

    @staticmethod
    def function(x: Tensor, grids: Tensor, values: Tensor) -> Tensor:
        # Grids get no gradient, so that the variants have integers: ten times the numbers.
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        return erase_grid(x, grids.float() / 10, values)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
def test_lines_of_random_grids(layout, device):
    """At sizes that are no multiples of a tile; what is halfway between two pixels may be on either side after a turn."""
    x = torch.full((64, 3, 37, 61), 7, dtype=torch.uint8).contiguous(memory_format=layout)
    lines = torch.rand(64, 5) * torch.tensor([1.0, 12.0, 1.0, 1.0, 9.0]) + torch.tensor([0.0, -6.0, 0.0, 0.0, 1.0])
    lines[:8, 1] = 0
    lines[:, 4] = lines[:, 4].floor()
    values = torch.tensor([[1.0, 2, 3]]).expand(64, 3)
    expected = torch.where(is_line(x, lines), values.byte()[:, :, None, None], x)
    y = erase_grid(x.to(device), lines.to(device), values.to(device)).cpu()
    assert torch.equal(y[:8], expected[:8]) and (y != expected).float().mean() < 1e-4
    nothing = lines[:1].clone()
    nothing[0, 1] = float("nan")
    assert torch.equal(erase_grid(x[:1].to(device), nothing.to(device), values[:1].to(device)).cpu(), x[:1])


def test_rectangles(device):
    x = torch.ones(5, 2, 6, 8, device=device)
    values = torch.tensor([0.0, 0.25, 0.5, 0.75, 2.0], device=device)[:, None]
    result = erase_rectangles(x, boxes(x).float().to(device), values)
    expected = torch.ones(5, 2, 6, 8)
    expected[0, :, 2:6, 1:4] = 0
    expected[1, :, 1:3, :2] = 0.25
    expected[2, :, 5:, 6:] = 0.5
    expected[4] = 2
    assert torch.equal(result.cpu(), expected)
    assert torch.equal(erase_rectangles(x, boxes(x)[:1].float().to(device), values[:1])[4].cpu(), expected[0])


def test_nan_erases_no_pixel(device):
    x = torch.ones(1, 1, 4, 4, device=device)
    for i in range(4):
        box = torch.tensor([[[0.0, 0.0, 4.0, 4.0]]], device=device)
        box[0, 0, i] = float("nan")
        assert torch.equal(erase_rectangles(x, box, torch.zeros(1, 1, device=device)), x)


@pytest.mark.parametrize("dtype", [torch.int64, torch.int32, torch.bool, torch.int16], ids=str)
def test_masks_of_integers(dtype, device):
    mask = torch.ones(2, 1, 5, 5, dtype=dtype, device=device)
    result = erase_rectangles(
        mask, torch.tensor([[[1.0, 1.0, 2.0, 3.0]]], device=device).expand(2, 1, 4), torch.zeros(2, 1, device=device)
    )
    assert result.dtype == dtype and result.sum() == 2 * (25 - 6) and not result[:, :, 1:4, 1:3].any()


def test_bytes_are_rounded_and_saturated(device):
    x = torch.full((3, 1, 2, 2), 7, dtype=torch.uint8, device=device)
    values = torch.tensor([-3.0, 2.5, 300.0], device=device)[:, None]
    result = erase_rectangles(x, torch.tensor([[[0.0, 0, 1, 1]]], device=device).expand(3, 1, 4), values)
    assert result[:, 0, 0, 0].tolist() == [0, 2, 255] and (result.flatten(1)[:, 1:] == 7).all()


def test_gradients(device):
    x = torch.rand(5, 2, 6, 8, dtype=torch.float64, device=device, requires_grad=True)
    values = torch.rand(5, 2, dtype=torch.float64, device=device, requires_grad=True)
    erased = erase_rectangles(torch.zeros_like(x), boxes(x).float().to(device), torch.ones_like(values))
    result = erase_rectangles(x, boxes(x).float().to(device), values)
    to_x, to_values = torch.autograd.grad(result.sum(), (x, values))
    assert_close(to_x, 1 - erased.detach())
    assert_close(to_values, erased.sum((2, 3)).detach())


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
def test_many_boxes_and_values_of_channels(layout, device):
    """In images that are larger than a tile of the kernel, from boxes that are columns of a wider tensor."""
    columns = torch.randint(0, 2100, (2, 1 + 4 * 300), device=device).float()
    boxes = columns[:, 1:].reshape(2, 300, 4)
    boxes[..., 1::2] *= 0.025
    boxes[..., 2] *= 0.01
    x = torch.full((2, 3, 45, 2101), 7, dtype=torch.uint8, device=device).contiguous(memory_format=layout)
    values = torch.tensor([[1.0, 2, 3], [4, 5, 6]], device=device)
    expected = torch.where(is_erased(x, boxes), values.byte()[:, :, None, None], x)
    assert expected.ne(x).float().mean() > 0.2 and torch.equal(erase_rectangles(x, boxes, values), expected)


@pytest.mark.parametrize("size", [(70, 40), (67, 37)], ids=str)
def test_many_boxes_of_many_images(size, device):
    """More than a block of threads marks at once, in more rows than fill a device."""
    places = torch.rand(70, 300, 2, generator=torch.Generator().manual_seed(0)) * torch.tensor([40.0, 70.0])
    boxes = torch.cat([places, torch.tensor([2.5, 3.0]).expand(70, 300, 2)], 2).to(device)
    x = torch.rand(70, 3, *size, device=device)
    values = torch.rand(70, 3, device=device)
    expected = torch.where(is_erased(x, boxes), values[:, :, None, None], x)
    assert 0.2 < expected.ne(x).float().mean() < 0.9 and torch.equal(erase_rectangles(x, boxes, values), expected)
