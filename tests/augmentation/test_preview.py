"""Sheets of draws: labels are drawn at their objects."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

import kvision as K
import kvision.augmentation as A
from kvision.augmentation.container.sheet import draw_samples

pytestmark = pytest.mark.interface

ORANGE = torch.tensor([255, 140, 0])[:, None, None] / 255
KEYS = ["image", "mask", "bbox_xyxy", "keypoints"]


def square(device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A white square on gray with its mask, its box and its center, 64 pixels wide."""
    mask = torch.zeros(1, 64, 64, dtype=torch.uint8, device=device)
    mask[:, 20:40, 10:30] = 1
    box, center = torch.tensor([[10.0, 20.0, 30.0, 40.0]]), torch.tensor([[19.5, 29.5]])
    return 0.5 + 0.5 * mask.expand(3, -1, -1).float(), mask, box.to(device), center.to(device)


def extent(result: Tensor) -> list[int]:
    """First column, first row, and the ends of both, of the pixels that are found (H, W)."""
    rows, columns = (result.any(axis).nonzero().flatten() for axis in (1, 0))
    return [int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1]


def is_orange(cell: Tensor) -> Tensor:
    return (cell - ORANGE.to(cell)).abs().amax(0) < 0.05


def test_boxes_and_points_are_drawn_where_the_object_is(device: torch.device) -> None:
    image, _, box, center = square(device)
    augment = A.AugmentationSequential(
        A.RandomTranslate((-0.1, 0.5), (-0.3, 0.3), p=1.0), A.RandomHorizontalFlip(), data_keys=["image", "bbox_xyxy"]
    )
    cells = draw_samples(augment, (image, box), count=6, size=256, seed=3)
    plain = draw_samples(augment, (image, box[:0]), count=6, size=256, seed=3)
    positions = set()
    for drawn, clear in zip(cells[1:], plain[1:]):
        object_at, box_at = extent(clear[0] > 0.9), extent(is_orange(drawn))
        assert max(abs(a - b) for a, b in zip(object_at, box_at)) <= 3  # the half width of a line
        positions.add(tuple(object_at))
    assert len(positions) == 6
    cells = draw_samples(augment, (image, center), ["image", "keypoints"], count=6, size=256, seed=3)
    for drawn, clear in zip(cells[1:], plain[1:]):
        (left, top, right, bottom), disc = extent(clear[0] > 0.9), extent(is_orange(drawn))
        assert abs(disc[0] + disc[2] - left - right) <= 2 and abs(disc[1] + disc[3] - top - bottom) <= 2


def test_masks_of_every_kind_are_drawn(device: torch.device) -> None:
    image, mask, _, _ = square(device)
    other = torch.zeros_like(mask)
    other[:, :10] = 1
    for masks in (mask, mask[0], mask.bool(), mask.float(), mask[None], torch.cat([mask, other])):
        tinted = draw_samples(nn.Identity(), (image, masks), ["image", "mask"], count=1, size=64)[1]
        changed = (tinted - image).abs().amax(0) > 0.05
        if masks.shape[0] == 1 or masks.dim() == 2:
            assert torch.equal(changed, mask[0] > 0)
        else:
            assert changed[:10].all() and changed[20:40, 10:30].all() and not changed[45:].any()
    assert (tinted[:, 30, 20] - tinted[:, 5, 20]).abs().max() > 0.1  # regions have colors of their own


def test_the_first_cell_is_the_image_in_a_frame(device: torch.device) -> None:
    image = torch.rand(3, 20, 32, device=device)
    cells = draw_samples(A.RandomHorizontalFlip(p=0.0), (image,), count=2, size=32)
    assert all(torch.equal(cell, image) for cell in cells[1:])
    assert torch.equal(cells[0][:, 2:-2, 2:-2], image[:, 2:-2, 2:-2]) and not torch.equal(cells[0], image)


def test_sheets(device: torch.device, tmp_path: Path) -> None:
    image, mask, box, center = square(device)
    augment = A.AugmentationSequential(A.RandomResizedCrop((40, 20)), A.RandomGrayscale(), data_keys=KEYS)
    before = torch.get_rng_state()
    sheet = A.preview(augment, image, mask, box, center, count=4, columns=2, size=48, seed=1, file=tmp_path / "a.png")
    assert torch.equal(torch.get_rng_state(), before)
    assert sheet.shape == (3, 3 * 52 + 4, 2 * 52 + 4) and sheet.device == image.device
    assert torch.equal(sheet, A.preview(augment, image, mask, box, center, count=4, columns=2, size=48, seed=1))
    assert not torch.equal(sheet, A.preview(augment, image, mask, box, center, count=4, columns=2, size=48))
    written = K.io.load_image(tmp_path / "a.png")
    assert (written - sheet.cpu()).abs().max() < 0.01


def test_samples_of_a_batch_alternate(device: torch.device) -> None:
    images = torch.rand(2, 1, 16, 16, device=device)
    boxes = [torch.tensor([[2.0, 2.0, 9.0, 9.0]], device=device), torch.zeros(0, 4, device=device)]
    cells = draw_samples(nn.Identity(), (images, boxes), ["image", "bbox_xyxy"], count=4, size=16)[1:]
    assert torch.equal(cells[1], images[1].expand(3, -1, -1)) and torch.equal(cells[3], cells[1])
    assert torch.equal(cells[0], cells[2]) and not torch.equal(cells[0], images[0].expand(3, -1, -1))
    mixed = A.preview(A.RandomMosaic(p=1.0), torch.rand(4, 3, 16, 16, device=device), size=16)
    assert mixed.shape[0] == 3


def test_chains_of_torch_move_labels_and_normalization_is_undone(device: torch.device) -> None:
    image, mask, box, center = square(device)
    chain = nn.Sequential(A.RandomRotation(90.0, p=1.0), A.RandomVerticalFlip())
    sheet = A.preview(chain, image, mask, box, center, data_keys=KEYS, seed=2)
    normalized = nn.Sequential(*chain, A.Normalize([0.4, 0.5, 0.6], [0.2, 0.25, 0.3]))
    torch.testing.assert_close(
        A.preview(normalized, image, mask, box, center, data_keys=KEYS, seed=2), sheet, rtol=0, atol=1e-4
    )
    whole = A.AugmentationSequential(*chain, data_keys=KEYS)
    torch.testing.assert_close(A.preview(whole, image, mask, box, center, seed=2), sheet)
    byte_image = (255 * image).round().to(torch.uint8)
    torch.testing.assert_close(
        A.preview(chain, byte_image, mask, box, center, data_keys=KEYS, seed=2), sheet, rtol=0, atol=0.02
    )


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda x: A.preview(len, x), TypeError, "preview: expected augment to be a module, got builtin"),
        (lambda x: A.preview(nn.Identity(), x, x), ValueError, r"preview: expected an image .* got 2 inputs"),
        (lambda x: A.preview(nn.Identity(), x[0]), ValueError, r"preview: expected an image of shape .*\(8, 8\)"),
        (lambda x: A.preview(nn.Identity(), x, count=0), ValueError, "preview: expected count to be a positive int"),
        (lambda x: A.preview(nn.Identity(), x, data_keys=["mask"]), ValueError, "preview: expected an image"),
    ],
)
def test_errors(call, error, message) -> None:
    with pytest.raises(error, match=message):
        call(torch.rand(3, 8, 8))
