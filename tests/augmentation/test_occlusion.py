"""What is dropped from images: where, with which values, and from masks."""

from __future__ import annotations

import pytest
import torch

import kvision.augmentation as A


def _params(batch: int, shape: tuple[int, ...], **params: torch.Tensor) -> dict[str, torch.Tensor]:
    return {**params, "batch_prob": torch.ones(batch), "forward_input_shape": torch.tensor(shape)}


def test_holes_are_where_they_were_drawn(device: torch.device) -> None:
    """Also overlapping ones, and those without pixels, in floats and bytes of any number of channels."""
    holes = torch.tensor([[[1.0, 2, 3, 2], [2, 1, 1, 4], [0, 0, 0, 0]], [[0, 0, 5, 1], [4, 4, 2, 2], [5, 0, 1, 6]]])
    expected = torch.zeros(2, 1, 6, 7, dtype=torch.bool)
    for sample, rectangles in zip(expected, holes.int().tolist()):
        for x, y, w, h in rectangles:
            sample[:, y : y + h, x : x + w] = True
    for channels, fill in ((1, 0.5), (3, (0.0, 0.5, 1.0)), (2, "random")):
        x = torch.full((2, channels, 6, 7), 0.25, device=device)
        augment = A.CoarseDropout(fill=fill, p=1.0)
        drawn = _params(2, x.shape, holes=holes, fill=torch.rand(x.shape))
        y, as_bytes = augment(x, params=drawn).cpu(), augment((255 * x).to(torch.uint8), params=drawn).cpu()
        values = drawn["fill"] if fill == "random" else torch.tensor(fill).reshape(1, -1, 1, 1)
        assert torch.equal(y, torch.where(expected, values, x.cpu()))
        assert torch.equal(as_bytes, torch.where(expected, (255 * values).round(), 63).to(torch.uint8))


def test_holes_of_labels() -> None:
    """Masks lose what images lose, or stay as they are; boxes and points stay."""
    x, masks = torch.ones(8, 3, 16, 20), torch.full((8, 2, 16, 20), 7)
    boxes, points = torch.tensor([[[1.0, 2, 8, 9]]]).expand(8, 1, 4), torch.tensor([[[3.0, 4.0]]]).expand(8, 1, 2)
    keys = ["input", "mask", "bbox_xyxy", "keypoints"]
    for make in (A.CoarseDropout, A.GridDropout, A.GridMask, A.PixelDropout):
        value = {"mask_drop_value": 5} if make is A.PixelDropout else {"fill_mask": 5}
        options = {"dropout_prob": 0.3, "per_channel": True} if make is A.PixelDropout else {}
        augment = A.AugmentationSequential(make(p=0.7, **options, **value), data_keys=keys)
        y, moved, same_boxes, same_points = augment(x, masks, boxes, points, seed=1)
        dropped = (y == 0).any(1, keepdim=True).expand_as(masks)
        assert torch.equal(moved, torch.where(dropped, 5, 7)) and dropped.any() and not dropped[:, 0].any((1, 2)).all()
        assert torch.equal(same_boxes, boxes) and torch.equal(same_points, points)
        kept = make(p=1.0, **options, **dict.fromkeys(value))
        assert torch.equal(A.AugmentationSequential(kept, data_keys=keys[:2])(x, masks)[1], masks)


def test_grid_dropout_has_a_hole_in_each_unit(device: torch.device) -> None:
    """Of half its side, as in Albumentations, at the drawn offset of each unit; a shift is the same in all."""
    x = torch.ones(1, 1, 13, 22, device=device)
    offsets = torch.tensor([[[0.0, 0.5], [0.99, 0.0], [0.3, 0.7]], [[0.0, 0.99], [0.4, 0.0], [0.5, 0.9]]])[None]
    y = A.GridDropout(0.5, holes_number_xy=(2, 3), p=1.0)(x, params=_params(1, x.shape, offsets=offsets)).cpu()
    expected = torch.ones(1, 1, 13, 22)
    for row, (top, bottom) in enumerate(((0, 4), (4, 8), (8, 13))):
        for column, (left, right) in enumerate(((0, 11), (11, 22))):
            tall, wide = (bottom - top) // 2, (right - left) // 2
            first_y = top + int(offsets[0, 0, row, column] * (bottom - top - tall + 1))
            first_x = left + int(offsets[0, 1, row, column] * (right - left - wide + 1))
            expected[..., first_y : first_y + tall, first_x : first_x + wide] = 0
    assert torch.equal(y, expected)
    shifted = A.GridDropout(0.5, False, unit_size_range=(4, 4), shift_xy=(1, 9), p=1.0)(x[..., :12, :18]).cpu()
    rows, columns = torch.ones(12), torch.ones(18)
    rows[[9, 10, 11]] = 0  # holes of the first unit, and of all others at the edge of the image
    columns[[1, 2, 5, 6, 10, 11, 14, 15]] = 0  # units of 4, 5, 4 and 5 pixels
    assert torch.equal(shifted[0, 0], 1 - (1 - rows[:, None]) * (1 - columns))
    with pytest.raises(
        ValueError, match="GridDropout: expected unit_size_range of at most the shorter side, 13, got 14"
    ):
        A.GridDropout(unit_size_range=(2, 14))(x)


def test_grid_mask_drops_lines(device: torch.device) -> None:
    """Of a quarter of a cell, at its offset; a quarter of a turn about the center of a square exchanges the axes."""
    x = torch.ones(2, 1, 16, 16, device=device)
    drawn = {"line_width": 0.3, "offset_x": 0.4, "offset_y": 0.0, "num_grid": 2.0}
    params = {name: torch.full((2,), value) for name, value in drawn.items()}
    params["rotation"] = torch.tensor([0.0, torch.pi / 2])
    y = A.GridMask(p=1.0)(x, params=_params(2, x.shape, **params)).cpu()
    rows, columns = torch.ones(16), torch.ones(16)
    rows[[0, 1, 8, 9]] = columns[[3, 4, 11, 12]] = 0  # cells of 8 pixels, lines of 2
    assert torch.equal(y[0, 0], rows[:, None] * columns)
    columns_down = (15 - torch.arange(16) - 3) % 8 >= 2
    assert torch.equal(y[1, 0], columns_down[:, None] * ((torch.arange(16) % 8) >= 2).float())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: A.CoarseDropout((0, 2)), "CoarseDropout: expected num_holes_range in ascending order of at least 1"),
        (lambda: A.CoarseDropout(hole_height_range=(0.2, 1.5)), "CoarseDropout: expected hole_height_range"),
        (
            lambda: A.CoarseDropout(fill="inpaint_ns"),
            "CoarseDropout: expected fill to be a number, one of each channel",
        ),
        (lambda: A.CoarseDropout(fill=(0.1, 0.2), p=1.0)(torch.ones(1, 3, 4, 4)), "expected fill of 3 channels, got 2"),
        (lambda: A.GridDropout(0.0), "GridDropout: expected ratio"),
        (lambda: A.GridMask((0, 3)), "GridMask: expected num_grid_range"),
        (lambda: A.PixelDropout(1.5), "PixelDropout: expected dropout_prob"),
        (lambda: A.PixelDropout(drop_value=255), "PixelDropout: expected drop_value"),
        (lambda: A.XYMasking(), "XYMasking: expected num_masks_x_range or num_masks_y_range with more than 0 stripes"),
        (lambda: A.TimeMasking(0), "TimeMasking: expected time_mask_param"),
    ],
)
def test_wrong_arguments(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]


def test_objects_of_masks_are_dropped(device: torch.device) -> None:
    """One connected region of a value, as Albumentations' MaskDropout, or a channel; from images and masks alike."""
    masks = torch.zeros(40, 1, 12, 15, dtype=torch.int64, device=device)
    regions = [
        (slice(1, 4), slice(1, 6)),
        (slice(5, 9), slice(2, 5)),
        (slice(5, 9), slice(5, 9)),
        (slice(11, 12), slice(0, 15)),
    ]
    for number, (rows, columns) in enumerate(regions):  # the second and the third one touch
        masks[:, :, rows, columns] = (7, 7, 2, 7)[number]
    x = torch.rand(40, 3, 12, 15, device=device)
    drop = A.MaskDropout(fill=0.5, p=0.8)
    y = drop(x, masks=masks, seed=torch.arange(40))
    changed, found = (y != x).any(1), set()
    for sample in changed.cpu():
        own = [i for i, (rows, columns) in enumerate(regions) if sample[rows, columns].any()]
        assert len(own) <= 1 and sample.sum() == sum(masks[0, 0][regions[i]].numel() for i in own)
        found.update(own)
    assert found == {0, 1, 2, 3} and not changed.flatten(1).any(1).all() and (y == 0.5).any()
    assert torch.equal(drop(x, params=drop._params), y)
    assert torch.equal(drop(x[3:5], masks=masks[3:5], seed=torch.arange(3, 5)), y[3:5])
    # In a container, at that step; instances in channels are objects of their own, and boxes stay.
    instances = torch.cat([masks == 7, masks == 2], 1).to(torch.uint8)
    augment = A.AugmentationSequential(
        A.RandomHorizontalFlip(p=1.0),
        A.MaskDropout((2, 2), p=1.0),
        A.RandomVerticalFlip(p=1.0),
        data_keys=["image", "mask"],
    )
    y, moved = augment(x, instances)
    assert moved.sum() == 0
    assert torch.equal((y == 0).all(1), instances.any(1).flip(-1).flip(-2))
    every = A.AugmentationSequential(A.MaskDropout((9, 9), p=1.0), data_keys=["image", "mask"])(x, masks)
    assert every[1].sum() == 0
    kept = A.AugmentationSequential(A.MaskDropout(fill_mask=None, p=1.0), data_keys=["image", "mask"])(x, masks)
    assert torch.equal(kept[1], masks) and not torch.equal(kept[0], x)
    video = A.VideoSequential(A.MaskDropout(p=1.0))
    frames, _ = A.AugmentationSequential(video, data_keys=["image", "mask"])(
        x.unflatten(0, (8, 5)), masks.unflatten(0, (8, 5))
    )
    assert (frames.flatten(0, 1) != x).any(1).flatten(1).any(1).all()
    with pytest.warns(UserWarning, match="MaskDropout: this call has no masks"):
        assert torch.equal(A.MaskDropout(p=1.0)(x), x)
