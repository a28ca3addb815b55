"""Copy-paste against a loop over pixels: images, masks of instances, boxes and labels."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from kvision.augmentation.mixing.copy_paste import _other_samples

KEYS = ["image", "mask", "bbox_xyxy", "class"]


def scene(device: torch.device) -> list[Tensor]:
    """Images of the numbers of their samples, up to three instances in each, loose boxes and labels; -1 is no instance."""
    masks = torch.zeros(4, 3, 12, 15, dtype=torch.uint8)
    masks[0, 0, 2:8, 1:7] = masks[0, 1, 6:11, 5:14] = masks[0, 2, 0, 14] = 1
    masks[1, 0, :4, :9] = masks[1, 1, 7, 3:5] = 2
    masks[2, 0, 2:8, 1:7] = 255
    images = (torch.arange(4.0) / 4).reshape(4, 1, 1, 1).expand(4, 3, 12, 15)
    boxes = K.geometry.masks_to_boxes(masks, "xyxy")
    boxes = torch.where(boxes.any(-1, keepdim=True), boxes + torch.tensor([-0.25, -0.25, 0.25, 0.25]), 0.0)
    labels = torch.tensor([[5, 6, 7], [8, 9, -1], [4, -1, -1], [-1, -1, -1]])
    return [x.to(device) for x in (images, masks, boxes, labels)]


def expected(data: list[Tensor], donors: Tensor, selected: Tensor, least: float) -> tuple[list[Any], Tensor]:
    """By a loop over samples, instances and pixels."""
    images, masks, boxes, labels = (x.cpu() for x in data)
    results: list[Any] = []
    for i in range(len(images)):
        donor = int(donors[i])
        own, theirs = masks[i].clone(), torch.zeros_like(masks[i])
        image, given = images[i].clone(), torch.cat([boxes[i], torch.zeros_like(boxes[i])])
        names = torch.cat([labels[i], torch.full_like(labels[i], -1)])
        for n in range(3):
            if selected[i, n] and masks[donor, n].any():
                theirs[n], given[3 + n], names[3 + n] = masks[donor, n], boxes[donor, n], labels[donor, n]
        for y in range(12):
            for x in range(15):
                if theirs[:, y, x].any():
                    own[:, y, x], image[:, y, x] = 0, images[donor, :, y, x]
        for n in range(3):
            before, after = int((masks[i, n] != 0).sum()), own[n].nonzero()
            if before and len(after) < max(least * before, 1):
                own[n], given[n], names[n] = 0, 0, -1
            elif len(after) < before:
                (top, left), (bottom, right) = after.amin(0).tolist(), after.amax(0).tolist()
                given[n] = torch.tensor([left, top, right + 1, bottom + 1])
        results.append((image, torch.cat([own, theirs]), given, names))
    return [torch.stack(column) for column in zip(*results)], images


@pytest.mark.parametrize("least", [0.0, 0.7])
@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
def test_pixels_boxes_and_labels(least: float, dtype: torch.dtype, device: torch.device) -> None:
    data = scene(device)
    data[0] = (255 * data[0]).to(dtype) if dtype == torch.uint8 else data[0]
    paste = A.RandomCopyPaste(0.6, min_visibility=least, p=0.8, data_keys=KEYS)
    numbers = set()
    for seed in range(8):
        outputs = paste(*data, seed=seed)
        donors, selected = (paste._params[name].cpu() for name in ("donors", "selected"))
        numbers.add(int(selected.sum()))
        for output, value in zip(outputs, expected(data, donors, selected, least)[0], strict=True):
            assert torch.equal(output.cpu(), value)
        assert all(map(torch.equal, paste(*data, params=paste._params), outputs))
    assert len(numbers) > 2
    for kind in (torch.bool, torch.int32, torch.float16):
        masks = paste(data[0], data[1] != 0, *data[2:], seed=3)[1]
        again = paste(data[0], (data[1] != 0).to(kind), *data[2:], seed=3)[1]
        assert masks.dtype == torch.bool and again.dtype == kind and torch.equal(again != 0, masks)
    assert torch.equal(A.RandomCopyPaste(p=0.0)(*data[:2])[0], data[0])
    assert torch.equal(A.RandomCopyPaste(p=0.0)(*data[:2])[1][:, :3], data[1])


def test_donors_are_all_others_equally_likely(device: torch.device) -> None:
    """By the formula of a word of 24 bits, known values, and counts of many draws; a sample alone is its own."""
    words = torch.tensor([0, 2**24 // 3 - 1, 2**24 // 3 + 1, 2**24 - 1], dtype=torch.float32)
    assert _other_samples(words.to(device)).tolist() == [1, 2, 0, 2]
    assert _other_samples(words[:1]).tolist() == [0]
    paste, data, counts = A.RandomCopyPaste(1.0, p=1.0), scene(device)[:2], torch.zeros(4, 4)
    for seed in range(300):
        result = paste(*data, seed=seed)
        donors = paste._params["donors"].cpu()
        counts[torch.arange(4), donors] += 1
        assert all(map(torch.equal, paste(*data, seed=seed), result))
    assert counts.diagonal().tolist() == [0] * 4
    others = counts[~torch.eye(4, dtype=torch.bool)]  # binomial: mean 100, standard deviation 8
    assert (others - 100).abs().amax() < 35
    seeds = torch.tensor([7, 8, 9, 10])
    paste(*data, seed=seeds)
    donors = paste._params["donors"].cpu()
    paste(*data, seed=torch.tensor([1, 8, 3, 10]))  # those of a sample are by its seed alone
    assert paste._params["donors"].cpu()[1::2].equal(donors[1::2])


@pytest.mark.parametrize("nested", [False, True])
def test_in_containers(nested: bool, device: torch.device) -> None:
    """After a flip and before one: the same as on flipped data."""
    data, flip = scene(device), A.RandomHorizontalFlip(p=1.0)
    paste = A.RandomCopyPaste(1.0, p=1.0, data_keys=KEYS)
    children = [flip, A.ImageSequential(paste, flip)] if nested else [flip, paste, flip]
    augment = A.AugmentationSequential(*children, data_keys=KEYS)
    image, masks, boxes, labels = augment(*data)
    others = A.AugmentationSequential(flip, data_keys=KEYS)
    expected = paste(*others(*data), params=paste._params)  # the donors of the call
    for result, value in zip((image, masks, labels), (expected[0].flip(-1), expected[1].flip(-1), expected[3])):
        assert torch.equal(result, value)
    tight = K.geometry.masks_to_boxes(masks, "xyxy")
    is_box = labels >= 0
    assert ((boxes - tight).abs().amax(-1) <= 0.25)[is_box].all() and masks.flatten(2).any(2).equal(is_box)
    again = augment(*data, params=augment._params)
    assert all(map(torch.equal, again, (image, masks, boxes, labels)))


def test_soft_edges(device: torch.device) -> None:
    images, masks = scene(device)[:2]
    hard, _ = A.RandomCopyPaste(1.0, p=1.0)(images, masks)
    paste = A.RandomCopyPaste(1.0, blend_sigma=1.0, p=1.0)
    soft, _ = paste(images, masks)
    donors = paste._params["donors"]
    pasted = (masks[donors] != 0).any(1, keepdim=True).float()
    alpha = K.filters.gaussian_blur2d(pasted, (9, 9), (1.0, 1.0), "replicate")
    torch.testing.assert_close(soft, images + (images[donors] - images) * alpha)
    assert not torch.equal(soft, hard)


BAD = [
    (lambda: A.RandomCopyPaste(1.5), "RandomCopyPaste: expected select_p within 0 and 1"),
    (lambda: A.RandomCopyPaste(blend_sigma=-1.0), "expected blend_sigma of at least 0"),
    (lambda: A.RandomCopyPaste(p=1.0)(torch.ones(2, 3, 4, 4), torch.ones(2, 4, 4)), "expected masks of instances"),
    (lambda: A.RandomCopyPaste(p=1.0)(torch.ones(2, 3, 4, 5), torch.ones(2, 1, 4, 4)), "expected image of shape"),
    (lambda: A.AugmentationSequential(A.RandomCopyPaste(p=1.0), data_keys=["image"])(torch.ones(2, 3, 4, 4)),
     "RandomCopyPaste: expected a mask among the data_keys"),
]  # fmt: skip


@pytest.mark.parametrize("call, message", BAD, ids=range(len(BAD)))
def test_errors(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
