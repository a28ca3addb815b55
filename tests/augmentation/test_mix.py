"""Operations that mix the samples of a batch."""

from __future__ import annotations

import pickle
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A

CLASSES = {
    "RandomMixUpV2": {},
    "RandomCutMixV2": {"num_mix": 2, "cut_size": (0.2, 0.6)},
    "PatchMix": {"patch_size": 5, "p": 0.7},
    "RandomJigsaw": {"grid": (2, 4), "p": 0.7},
    "RandomMosaic": {"p": 0.7},
}
classes = pytest.mark.parametrize("name", CLASSES)


def images(device: Any = "cpu", batch: int = 6) -> Tensor:
    return torch.rand(batch, 3, 12, 16, generator=torch.Generator().manual_seed(0)).to(device)


@classes
def test_replay_seeds_and_pickles(name: str, device: torch.device) -> None:
    x, mix = images(device), getattr(A, name)(**CLASSES[name])
    y = mix(x)
    assert y.shape == x.shape and y.dtype == x.dtype and not torch.equal(y, x)
    assert torch.equal(mix(x, params=mix._params), y)
    assert torch.equal(mix(x, seed=4), pickle.loads(pickle.dumps(mix))(x, seed=4))
    torch.manual_seed(3)
    first = mix(x)
    torch.manual_seed(3)
    assert torch.equal(mix(x), first)
    assert mix(x[:0]).shape == (0, 3, 12, 16)
    assert mix((255 * x).to(torch.uint8)).dtype == torch.uint8
    assert torch.equal(getattr(A, name)(**{**CLASSES[name], "p": 0.0})(x), x)
    with pytest.raises(RuntimeError, match=name):
        _ = mix.transform_matrix
    with pytest.raises(RuntimeError, match=name):
        mix.inverse(x)


@classes
def test_samples_not_chosen_are_unchanged(name: str) -> None:
    x = images(batch=40)
    mix = getattr(A, name)(**{**CLASSES[name], "p": 0.5})
    y = mix(x)
    chosen = mix._params["batch_prob"] > 0.5
    if name != "RandomMixUpV2" or chosen.any():
        assert torch.equal(y[~chosen], x[~chosen])


def test_mixup_is_the_weighted_sum() -> None:
    x, labels = images(), torch.arange(6)
    mix = A.RandomMixUpV2((0.2, 0.4), data_keys=["input", "class"])
    y, mixed = mix(x, labels)
    pairs, weights = mix._params["mixup_pairs"], mix._params["mixup_lambdas"]
    assert sorted(pairs.tolist()) == list(range(6)) and 0.2 <= weights.min() and weights.max() <= 0.4
    torch.testing.assert_close(y, torch.lerp(x, x[pairs], weights[:, None, None, None]))
    torch.testing.assert_close(mixed, torch.stack([labels.float(), labels[pairs].float(), weights], 1))
    assert isinstance(A.RandomMixUpV2()(x, labels), Tensor)


@pytest.mark.parametrize("name", ["RandomCutMixV2", "PatchMix"])
def test_labels_have_the_share_that_is_kept(name: str) -> None:
    x = torch.arange(6.0)[:, None, None, None].expand(6, 1, 12, 16)
    options = {"patch_size": 5} if name == "PatchMix" else {"cut_size": (0.2, 0.9)}
    mix = getattr(A, name)(**options, p=0.7, data_keys=["input", "class", "mask"])
    y, labels, mask = mix(x, torch.arange(6), x.long())
    assert torch.equal(mask, y.long())
    labels = labels.reshape(-1, 6, 3)[0]
    chosen = mix._params["batch_prob"] > 0.5
    for i in range(6):
        own, partner, kept = labels[i]
        if chosen[i] and own != partner:
            assert (y[i] == i).float().mean() == pytest.approx(float(kept))
            assert set(y[i].unique().tolist()) <= {float(own), float(partner)}
        if not chosen[i]:
            assert labels[i].tolist() == [i, i, 0]


def test_jigsaw_moves_masks_and_points() -> None:
    x = torch.arange(2 * 12 * 16.0).reshape(2, 1, 12, 16)
    jigsaw = A.RandomJigsaw((3, 4), p=1.0, data_keys=["input", "mask", "keypoints"])
    at = torch.tensor([[[1.0, 2.0], [9.0, 7.0]]]).expand(2, 2, 2)
    y, mask, points = jigsaw(x, x.long(), at)
    assert torch.equal(y.flatten(1).sort(1).values, x.flatten(1)) and torch.equal(mask, y.long())
    for b in range(2):
        for before, after in zip(at[b].long(), points[b].long()):
            assert y[b, 0, after[1], after[0]] == x[b, 0, before[1], before[0]]
    with pytest.raises(RuntimeError, match="grid"):
        A.RandomJigsaw((5, 4), p=1.0)(x)


def test_mosaic_boxes_are_on_their_objects() -> None:
    x = torch.zeros(4, 1, 16, 16)
    boxes = torch.tensor([[[2.0, 3.0, 9.0, 10.0]]]).expand(4, 1, 4).contiguous()
    for b in range(4):
        x[b, :, 3:10, 2:9] = b + 1.0
    mosaic = A.RandomMosaic(p=1.0, data_keys=["input", "bbox_xyxy", "mask"])
    y, moved, mask = mosaic(x, boxes, x.long())
    assert moved.shape == (4, 4, 4) and torch.equal(mask, y.long())
    drawn = torch.zeros_like(y, dtype=torch.bool)
    for b in range(4):
        for left, top, right, bottom in moved[b].long():
            drawn[b, :, top:bottom, left:right] = True
    assert torch.equal(drawn, y > 0)
    assert A.RandomMosaic((20, 24), p=0.5)(x).shape == (4, 1, 20, 24)


def test_what_cannot_be_mixed_is_refused() -> None:
    x = images()
    with pytest.raises(NotImplementedError, match="boxes cannot be mixed"):
        A.RandomMixUpV2(data_keys=["input", "bbox_xyxy"])(x, torch.zeros(6, 1, 4))
    with pytest.raises(ValueError, match="expected 2 inputs"):
        A.RandomMixUpV2(data_keys=["input", "class"])(x)
    for wrong in (-0.1, (0.5, 0.1), (0.0, 2.0)):
        with pytest.raises((TypeError, ValueError), match="RandomMixUpV2: expected lambda_val"):
            A.RandomMixUpV2(wrong)


def test_in_a_container() -> None:
    x, mask = images(), torch.randint(0, 5, (6, 1, 12, 16))
    augment = A.AugmentationSequential(
        A.RandomHorizontalFlip(p=1.0), A.RandomCutMixV2(p=1.0), data_keys=["input", "mask"]
    )
    y, moved = augment(torch.cat([mask.float()] * 3, 1), mask)
    assert torch.equal(y[:, :1], moved.float())
    assert torch.equal(augment(torch.cat([mask.float()] * 3, 1), mask, params=augment._params)[0], y)
    assert x.shape == y.shape
