"""Objects of masks that are dropped."""

import pytest
import torch
from scipy import ndimage

from augmentation.test_lists import pictures, seeds_of
from kvision import augmentation as A
from kvision.augmentation.draws import mixed_words
from kvision.augmentation.engine.list_runs import ListParts
from kvision.augmentation.occlusion.objects import drop_objects
from kvision.contrib.connected_components import connected_components
from point_op_tests import Call, PointOpTests


def masks() -> torch.Tensor:
    return torch.randint(0, 3, (1, 8, 9))


class TestDropObjectsOperators(PointOpTests):
    calls = {
        "drop_objects": [
            Call(
                (
                    masks,
                    lambda: connected_components((masks() != 0).byte()),
                    lambda: torch.tensor(5.0),
                    lambda: torch.tensor(2.0),
                    lambda: torch.tensor(7),
                ),
                (3,),
                broadcasts=False,
                differentiable=False,
                dtypes=(torch.float32,),
                accepted=("of torch.int64", "most"),
            )
        ],
    }


@pytest.mark.parametrize("number", [1, 3])
def test_the_highest_ranks_are_dropped(number, device):
    """In random masks of small objects, and of many that are one."""
    x = torch.randint(0, 4, (5, number, 31, 45)) * (torch.rand(5, number, 31, 45) < 0.4)
    x[4] = 0
    words, counts = torch.tensor([3.0, 7.0, 2**24 - 1.0, 0.0, 1.0]), torch.tensor([1.0, 4.0, 0.0, 50.0, 2.0])
    regions = connected_components((x != 0).byte()) if number == 1 else None
    arguments = x, regions, words, counts, None
    y = drop_objects(*(None if a is None else a.to(device) for a in arguments), 50).cpu()
    assert torch.equal(y, drop_objects.reference(*arguments, 50))
    assert torch.equal(
        drop_objects(*(None if a is None else a.to(device) for a in arguments), 2).cpu()[3:],
        drop_objects.reference(*arguments, 2)[3:],
    )
    for b, count in enumerate(counts.int().tolist()):
        covered = [plane != 0 for plane in x[b] if plane.any()]
        if number == 1:
            labels = torch.from_numpy(ndimage.label(x[b, 0].numpy(), structure=[[1] * 3] * 3)[0])
            pairs = set(zip(labels.flatten().tolist(), x[b, 0].flatten().tolist()))
            covered = [(labels == i) & (x[b, 0] == value) for i, value in pairs if value]
        whole = sum(bool(y[b, 0][c].all()) for c in covered)
        parts = sum(bool(y[b, 0][c].any()) and not bool(y[b, 0][c].all()) for c in covered)
        assert whole >= min(count, len(covered)) and (number > 1 or (whole == min(count, len(covered)) and not parts))
        inside = torch.stack(covered).any(0) if covered else torch.zeros(31, 45, dtype=torch.bool)
        assert not y[b, 0][~inside].any()


def test_hash_is_that_of_draws(device):
    """Ranks of two objects in the order of their words."""
    x = torch.tensor([[1, 0], [0, 1]])[None, :, None].to(device)
    for word in range(8):
        ranks = mixed_words(torch.arange(2) ^ mixed_words(torch.tensor(word)))
        dropped = drop_objects(
            x, None, torch.tensor([float(word)], device=device), torch.ones(1, device=device), None, 1
        )
        assert dropped.flatten().tolist() == [int(ranks[0] > ranks[1]), int(ranks[1] > ranks[0])]


OBJECTS_OF = ((torch.uint8, 1), (torch.int64, 1), (torch.float32, 1), (torch.bool, 3))


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8, torch.float16, torch.float64], ids=str)
@pytest.mark.parametrize("kind, number", OBJECTS_OF, ids=str)
def test_objects_of_the_images_of_a_list(kind, number, dtype, device):
    """They are those of each image alone by its seed, in the images and in their masks, and equal sizes those of a batch."""
    images, p = pictures(device, ((40, 56), (64, 31), (33, 33), (17, 20)), dtype), 0.7
    given = [
        ((torch.rand(number, *x.shape[1:], device=device) < 0.3) * (1 + i % 3)).to(kind) for i, x in enumerate(images)
    ]
    seeds, has_gradient = seeds_of(images), dtype.is_floating_point
    for fill in (0.5, (0.1, 0.2, 0.3)):
        drop = A.MaskDropout((1, 9), fill, p=p)
        images = [x.clone().requires_grad_(has_gradient) for x in images]
        y, params = drop(images, masks=given, seed=seeds), drop._params
        assert type(drop._execution.of_list) is ListParts
        again = drop(images, masks=given, params=params)
        chain = A.AugmentationSequential(drop, data_keys=["input", "mask"])
        of_chain, masks = chain(images, given, seed=seeds)
        assert type(chain._record.parts) is ListParts
        if has_gradient:
            gradients = torch.autograd.grad(sum((a * a.detach()).sum() for a in y), images)
        for b, x in enumerate(images):
            alone = drop(x[None], masks=given[b][None], seed=seeds[b : b + 1])[0]
            assert torch.equal(y[b], alone) and torch.equal(again[b], alone)
            if has_gradient:
                (gradient,) = torch.autograd.grad((alone * alone.detach()).sum(), x)
                assert torch.allclose(gradients[b], gradient)
            own, mask = chain(x[None], given[b][None], seed=seeds[b : b + 1])
            assert torch.equal(of_chain[b], own[0]) and torch.equal(masks[b], mask[0])
        equal, equal_masks = [x[:, :16, :18] for x in images], [m[:, :16, :18] for m in given]
        batch = drop(torch.stack(equal), masks=torch.stack(equal_masks), seed=3)
        assert all(map(torch.equal, drop(equal, masks=equal_masks, seed=3), batch))


def test_images_with_one_mask_have_its_regions_as_objects_beside_images_with_several(device):
    """Whether they are alone, in a batch of lists of instances, or in a list, also after the pixels have moved."""
    one, several = torch.zeros(2, 6, 20, dtype=torch.uint8, device=device).split(1)
    one[0, 1:3, 1:5] = one[0, 4:, 12:15] = 1
    several = (torch.rand(3, 6, 20, device=device) < 0.3).byte()
    masks, images = [several, one, one, several[:0]], torch.rand(4, 3, 6, 20, device=device)
    other = [torch.rand(3, 8, 9, device=device)], [one[:, :, :9].repeat(1, 2, 1)[:, :8]]
    drop = A.MaskDropout((1, 1), p=1.0)
    for children in ((drop,), (A.RandomHorizontalFlip(p=1.0), drop), (A.ImageSequential(drop),)):
        chain = A.AugmentationSequential(*children, data_keys=["input", "mask"])
        seeds = torch.arange(5)
        of_batch, of_list = (
            chain(images, masks, seed=seeds[:4]),
            chain([*images, *other[0]], masks + other[1], seed=seeds),
        )
        for b, mask in enumerate(masks):
            alone = chain(images[b : b + 1], [mask], seed=seeds[b : b + 1])
            for together in (of_batch, of_list):
                assert torch.equal(together[0][b], alone[0][0]) and torch.equal(together[1][b], alone[1][0])
        assert sum(not a.any() for a in of_batch[0][1].flatten(1).T) in (6, 8)
    direct = drop(images, masks=masks, seed=seeds[:4])
    assert torch.equal(direct[1], drop(images[1:2], masks=one[None], seed=seeds[1:2])[0])


def test_masks_that_do_not_fit_a_list():
    images = pictures("cpu", ((40, 56), (64, 31)))
    drop, own = A.MaskDropout(p=1.0), [torch.ones(1, *x.shape[1:]) for x in images]
    mixed = [own[0].byte(), own[1]]
    assert all(torch.equal(a, torch.zeros_like(a)) for a in drop(images, masks=mixed))
    for masks in (own[:1], [own[0], own[0]]):
        with pytest.raises(ValueError, match="mask"):
            drop(images, masks=masks)
    with pytest.warns(UserWarning, match="this call has no masks"):
        assert all(map(torch.equal, drop(images), images))
