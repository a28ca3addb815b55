"""Operations that mix the samples of a batch."""

from __future__ import annotations

import pickle
from typing import Any

import pytest
import torch
from scipy import stats
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from op_tests import THOROUGH, pairwise

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


PARTNERS = {
    "RandomMixUpV2": (lambda params: [params["mixup_pairs"]], {}),
    "RandomCutMixV2": (lambda params: list(params["mix_pairs"]), {"num_mix": 2}),
    "PatchMix": (lambda params: [params["mix_pairs"]], {}),
    "RandomMosaic": (lambda params: list(params["permutation"].unbind(1)[1:]), {}),
}


@pytest.mark.parametrize(("name", "p", "batch"), pairwise(list(PARTNERS), (0.2, 0.5, 1.0), (3, 8)))
@pytest.mark.parametrize("seeds", [40, pytest.param(4000 if THOROUGH else 1000, marks=pytest.mark.slow)])
def test_partners_are_a_random_permutation_of_the_chosen(seeds: int, name: str, batch: int, p: float) -> None:
    partners_of, options = PARTNERS[name]
    same = {} if name == "RandomMosaic" else {"same_on_batch": True}
    mixes = [getattr(A, name)(p=p, **options), getattr(A, name)(p=p, **options, **same)]
    x = torch.empty(batch, 1, 16, 16)
    tables: dict[tuple[int, int], Tensor] = {}  # of each round and number of chosen samples: who met whom
    for seed in range(seeds):
        mix = mixes[seed % 2]
        execution = mix._draw(x, seed, None)
        params = mix._params_on_device(x, execution)
        chosen = torch.arange(batch)
        if execution.chosen is not None:
            chosen = chosen[execution.chosen]
        for which, partners in enumerate(partners_of(params)):
            mixed = torch.arange(batch)
            mixed[chosen] = partners[chosen]
            assert torch.equal(partners, mixed)  # the others keep themselves
            table = (partners[chosen, None] == chosen).double()
            assert torch.equal(table.sum(0), torch.ones(len(chosen), dtype=torch.float64))
            at = which, len(chosen)
            tables[at] = table + tables.get(at, 0)
    statistic = freedom = 0.0
    for (_, n), table in tables.items():
        count = float(table.sum()) / max(n, 1)
        if n > 1 and count >= 5 * n:
            # Tables of permutations vary by n / (n - 1) more than those of independent rows.
            statistic += float(((table - count / n) ** 2).sum()) * (n - 1) / count
            freedom += (n - 1) ** 2
    assert not freedom or stats.chi2.sf(statistic, freedom) > 1e-3
    assert freedom or (seeds < 4000 and p < 1)


@pytest.mark.parametrize("name", ["RandomMixUpV2", "RandomCutMixV2", "PatchMix"])
def test_same_on_batch_shares_what_is_mixed_but_not_the_partner(name: str) -> None:
    x = images()
    mix = getattr(A, name)(same_on_batch=True)
    y = mix(x, seed=3)
    params = mix._params
    shared = {"RandomMixUpV2": "mixup_lambdas", "RandomCutMixV2": "crop_src", "PatchMix": "patch_coords"}[name]
    of_samples = params[shared].transpose(0, 1) if name == "RandomCutMixV2" else params[shared]
    assert torch.equal(of_samples, of_samples[:1].expand_as(of_samples))
    partners = PARTNERS[name][0](params)[0]
    assert not torch.equal(partners, torch.arange(6)) and not torch.equal(y, x)


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


@pytest.mark.parametrize("in_container", [False, True], ids=["alone", "container"])
@pytest.mark.parametrize("name", ["RandomMixUpV2", "RandomCutMixV2", "PatchMix"])
def test_probabilities_of_classes_are_mixed_as_the_images(name: str, in_container: bool, device: torch.device) -> None:
    """Images of one channel a class, whose pixels are labels: their mean is what the labels become."""
    mix = getattr(A, name)(**CLASSES[name] | {"p": 0.7}, data_keys=["input", "class"])
    augment = A.AugmentationSequential(mix, data_keys=["input", "class"]) if in_container else mix
    one_hot = torch.eye(6, dtype=torch.int64, device=device)[torch.tensor([0, 2, 4, 1, 1, 5])]
    for labels in (one_hot, one_hot.float(), one_hot.double() * 0.75 + 0.25 / 6):
        x = labels.double()[:, :, None, None].expand(6, 6, 12, 16)
        y, mixed = augment(x, labels, seed=8)
        assert mixed.dtype == (labels.dtype if labels.is_floating_point() else torch.float32)
        torch.testing.assert_close(mixed.double(), y.mean((2, 3)), rtol=1e-6, atol=1e-6)
        assert not torch.equal(y, x)
    assert torch.equal(getattr(A, name)(p=0.0, data_keys=["input", "class"])(x, one_hot)[1], one_hot.float())


def test_labels_of_boxes_are_not_probabilities() -> None:
    x, boxes = images(), torch.tensor([[[1.0, 1.0, 5.0, 5.0], [2.0, 2.0, 9.0, 9.0]]]).repeat(6, 1, 1)
    one_hot = torch.tensor([[0, 1]] * 6)
    for labels in (one_hot, one_hot.float()):
        cut = A.RandomCutMixV2(data_keys=["input", "bbox_xyxy", "class"])
        for augment in (cut, A.AugmentationSequential(cut, data_keys=["input", "bbox_xyxy", "class"])):
            _, moved, of_boxes = augment(x, boxes, labels)
            assert moved.shape == (6, 4, 4) and of_boxes.shape == (6, 4) and of_boxes.dtype == labels.dtype
    with pytest.raises(ValueError, match=r"RandomMixUpV2: expected labels .* got torch.int64 \(6, 2\)"):
        A.RandomMixUpV2(data_keys=["input", "class"])(x, torch.tensor([[3, 1]] * 6))


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
    whole = torch.tensor([[[1, 2, 9, 8]]]).repeat(4, 1, 1)
    mosaic = A.RandomMosaic(p=1.0, data_keys=["input", "bbox_xyxy"])
    assert torch.equal(mosaic(x, whole, seed=2)[1], mosaic(x, whole.float(), seed=2)[1])


def test_masks_of_mosaics_of_another_size_are_those_of_their_images() -> None:
    images = 100 * torch.arange(6.0)[:, None, None, None] + torch.arange(64.0).reshape(8, 8)
    for augment in (
        A.RandomMosaic((6, 5), p=0.5, resample="nearest", data_keys=["input", "mask"]),
        A.AugmentationSequential(A.RandomMosaic((6, 5), p=0.5, resample="nearest"), data_keys=["input", "mask"]),
    ):
        for seed in range(3):
            mixed, masks = augment(images, images.clone(), seed=seed)
            assert mixed.shape[-2:] == (6, 5)
            assert torch.equal(mixed, masks)


@pytest.mark.parametrize(
    "name, key, shape",
    [
        ("RandomMixUpV2", "mask", (3, 1, 8, 8)),
        ("RandomCutMixV2", "mask", (3, 1, 8, 8)),
        ("RandomCutMixV2", "bbox_xyxy", (3, 4, 4)),
        ("PatchMix", "bbox_xyxy", (3, 4, 4)),
        ("RandomJigsaw", "mask", (3, 1, 8, 8)),
        ("RandomJigsaw", "bbox_xyxy", (3, 32, 4)),
        ("RandomJigsaw", "keypoints", (3, 2, 2)),
        ("RandomMosaic", "mask", (3, 1, 8, 8)),
        ("RandomMosaic", "bbox_xyxy", (3, 8, 4)),
    ],
)
def test_labels_have_the_shape_of_mixed_ones_at_a_probability_of_zero(name: str, key: str, shape: Any) -> None:
    images, boxes = torch.rand(3, 1, 8, 8), torch.tensor([[[1.0, 1, 2, 2], [0, 2, 1, 3]]]).repeat(3, 1, 1)
    labels = {"mask": torch.rand(3, 1, 8, 8), "bbox_xyxy": boxes, "keypoints": torch.rand(3, 2, 2)}[key]
    for p in (0.0, 1.0):
        mixed, moved = getattr(A, name)(p=p, data_keys=["input", key])(images, labels)
        assert moved.shape == shape
        if p == 0:
            kept = moved[moved.flatten(2).any(2)].view(labels.shape) if key == "bbox_xyxy" else moved
            assert torch.equal(mixed, images) and torch.equal(kept, labels)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.bool])
def test_labels_of_boxes_that_have_no_minus_one(dtype: torch.dtype) -> None:
    images, boxes, labels = torch.rand(4, 1, 8, 8), 8 * torch.rand(4, 2, 4), torch.ones(4, 2, dtype=dtype)
    for cls in (A.RandomCutMixV2, A.RandomMosaic):
        mix = cls(p=0.5, data_keys=["input", "bbox_xyxy", "class"])
        with pytest.raises(TypeError, match="expected labels of boxes of a signed type"):
            mix(images, boxes, labels)


def test_refuses_tensors_that_cannot_be_mixed() -> None:
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


@pytest.mark.parametrize("name", ["RandomTransplantation", "RandomTransplantation3D"])
def test_transplants_are_regions_of_one_label(name: str, device: torch.device) -> None:
    size = (3, 6, 7) if name.endswith("3D") else (6, 7)
    masks = torch.randint(0, 5, (8, *size), generator=torch.Generator().manual_seed(1)).to(device)
    x = (10.0 * torch.arange(8, device=device).reshape(-1, *[1] * (1 + len(size))) + masks[:, None]).expand(8, 2, *size)
    transplant = getattr(A, name)(excluded_labels=[0], p=0.6)
    y, moved = transplant(x, masks, seed=3)
    params = transplant._params
    chosen = params["batch_prob"] > 0.5
    assert 0 < chosen.sum() < 8
    for i in range(8):
        donor, label = (i - 1) % 8, params["selected_labels"][i]
        region = (masks[donor] == label) & chosen[i]
        assert label != 0
        assert torch.equal(moved[i], torch.where(region, masks[donor], masks[i]))
        assert torch.equal(y[i], torch.where(region, x[donor], x[i]))
    again, _ = transplant(x, masks, params=params)
    assert torch.equal(again, y)
    without = {name: value for name, value in params.items() if name != "selection"}
    assert torch.equal(getattr(A, name)(p=1.0)(x, masks, params=without)[1][chosen], moved[chosen])
    assert torch.equal(getattr(A, name)(p=0.0)(x, masks)[0], x)
    assert torch.equal(getattr(A, name)(excluded_labels=range(5), p=1.0)(x, masks)[0], x)
    with pytest.raises(ValueError, match=f"{name}: expected one input of each data key"):
        transplant(x)
    with pytest.raises(ValueError, match=f"{name}: expected image of the size of masks"):
        transplant(x[..., 1:], masks)


def test_transplantation_draws_by_the_kernel(device: torch.device) -> None:
    masks = torch.randint(0, 5, (4, 6, 7), device=device)  # labels have no kernel of the draws
    x, transplant = torch.rand(4, 2, 6, 7, device=device), A.RandomTransplantation(p=0.6)
    with K.backend("native"):
        result = transplant(x, masks, seed=3)
    with K.backend("reference"):
        expected = transplant(x, masks, seed=3)
    assert all(map(torch.equal, result, expected))


def test_labels_are_equally_likely_to_be_transplanted() -> None:
    masks = torch.zeros(3000, 4, 4, dtype=torch.int64)
    masks[:, 0, 0], masks[:, 0, 1] = 1, 2  # one pixel each, and fourteen others
    transplant = A.RandomTransplantation(p=1.0)
    transplant(torch.zeros(3000, 1, 4, 4), masks, seed=0)
    counts = transplant._params["selected_labels"].bincount(minlength=3)
    assert (counts - 1000).abs().max() < 130


def test_adaptive_augmentation() -> None:
    Ada = A.presets.ada.AdaptiveDiscriminatorAugmentation
    x = images(batch=64)
    ada = Ada(initial_p=0.5, update_every=2, adjustment_speed=0.25, max_p=0.8)
    y = ada(x, seed=1)
    kept = (y == x).flatten(1).all(1)
    assert 15 < kept.sum() < 49
    assert torch.equal(ada(x, params=ada._params), y)
    average, p = 0.5, 0.5
    ada.ema_lambda = 0.4
    for accuracy in (0.99, 0.99, 0.3, 0.95, 0.95, 0.85):
        ada(x, real_acc=0.0)  # every second call counts
        ada(x, real_acc=torch.tensor([1.0, -1.0, -1.0]) if accuracy == 0.3 else accuracy)
        average = 0.4 * average + 0.6 * (1 / 3 if accuracy == 0.3 else accuracy)
        p = min(p + 0.25, 0.8) if average >= 0.85 else max(p - 0.25, 0.0)
        assert abs(ada.real_acc_ema - average) < 1e-6 and abs(ada.p - p) < 1e-12
    ada.p = 0.0
    assert torch.equal(ada(x), x)
    both = Ada(A.RandomInvert(p=1.0), initial_p=1.0, data_keys=["input", "mask"])
    image, mask = both(x, x[:, :1].long())
    torch.testing.assert_close(image, 1 - x)
    assert mask.dtype == torch.int64
    boxes = [torch.tensor([[1.0, 2.0, 5.0, 6.0]]) for _ in x]
    lists = Ada(A.RandomHorizontalFlip(p=1.0), initial_p=0.5, data_keys=["input", "bbox_xyxy"])
    image, moved = lists(x, boxes)
    kept = (image == x).flatten(1).all(1)
    assert 15 < kept.sum() < 49
    assert all(torch.equal(after, before) == same for after, before, same in zip(moved, boxes, kept.tolist()))
    with pytest.raises(ValueError, match="initial_p"):
        Ada(initial_p=2.0)
    with pytest.raises(ValueError, match="keep sizes"):
        Ada(A.CenterCrop(4), initial_p=1.0)(x)


@pytest.mark.parametrize("name", ["RandomMixUpV2", "RandomCutMixV2", "PatchMix"])
def test_labels_are_of_the_images(name: str) -> None:
    mix = getattr(A, name)(data_keys=["input", "class"], p=1.0)
    for labels in (torch.zeros(5), torch.zeros(1), torch.tensor(1)):
        with pytest.raises(ValueError, match=f"{name}: expected label of 6 images"):
            mix(images(), labels)
    with pytest.raises(TypeError, match=f"{name}: expected label to be a Tensor, got list"):
        mix(images(), [0, 1, 2, 3, 4, 5])


@pytest.mark.parametrize("name", ["RandomTransplantation", "RandomTransplantation3D"])
@pytest.mark.parametrize("nested", [False, True], ids=["flat", "nested"])
def test_transplantation_in_containers(name: str, nested: bool, device: torch.device) -> None:
    """Masks say which pixels were pasted, whatever was done before and after."""
    size = (3, 6, 8) if name.endswith("3D") else (6, 8)
    flip = A.RandomHorizontalFlip3D(p=0.5) if name.endswith("3D") else A.RandomHorizontalFlip(p=0.5)
    masks = torch.randint(0, 5, (8, *size), generator=torch.Generator().manual_seed(1)).to(device)
    images = masks[:, None].float() + 10
    transplant = getattr(A, name)(excluded_labels=[0], p=0.6)
    children = [flip, A.ImageSequential(transplant, flip)] if nested else [flip, transplant, flip]
    augment = A.AugmentationSequential(*children, data_keys=["input", "mask"])
    for seed in (3, torch.arange(8), None):
        y, moved = augment(images, masks, seed=seed)
        assert torch.equal(y, moved[:, None].float() + 10) and not torch.equal(y, images)
        again = augment(images, masks, params=augment._params)
        assert torch.equal(again[0], y) and torch.equal(again[1], moved)
        with_channel = augment(images, masks[:, None], params=augment._params)
        assert torch.equal(with_channel[1][:, 0], moved)
        assert torch.equal(augment(images, params=augment._params, data_keys=["input"]), y)
    assert torch.equal(augment(images, masks, seed=3)[0], augment(images, masks, seed=3)[0])
    with pytest.raises(ValueError, match=f"{name}: expected a mask among the data_keys"):
        augment(images, data_keys=["input"])
    with pytest.raises(NotImplementedError, match=f"{name}: labels cannot be mixed"):
        augment(images, masks, torch.arange(8), data_keys=["input", "mask", "class"])


@pytest.mark.parametrize("mix", [A.RandomCutMixV2, A.RandomMixUpV2], ids=lambda mix: mix.__name__)
def test_labels_of_mixes_that_never_apply_have_the_shape_of_mixed_ones(mix, device):
    """Alone, in containers and between other children: those of p above 0, with the image as its own partner."""
    x, labels = torch.rand(4, 3, 8, 8, device=device), torch.arange(4, device=device)
    keys = ["input", "class"]
    alone = mix(p=0.0, data_keys=keys)(x, labels)
    for children in ([], [A.RandomHorizontalFlip(p=0.0)], [A.ColorJitter(p=0.0)]):
        container = A.AugmentationSequential(*children, mix(p=0.0, data_keys=keys), *children, data_keys=keys)
        for y, mixed in (container(x, labels), container(x, labels, params=container._params)):
            assert torch.equal(y, x) and torch.equal(mixed, alone[1])
    shape = mix(p=1.0, data_keys=keys)(x, labels)[1].shape
    assert alone[1].shape == shape and torch.equal(alone[1][..., 0].flatten().long(), labels)
