"""Lists of images of different sizes in containers: draws, labels, parameters and the inverse are those of each image."""

from __future__ import annotations

import pytest
import torch

from kvision import augmentation as A
from op_tests import assert_close

SIZES = ((40, 56), (64, 31), (33, 33), (90, 70))


def pictures(device, sizes=SIZES, dtype=torch.float32):
    images = [torch.rand(3, h, w, device=device) for h, w in sizes]
    return [(255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype) for x in images]


def chain(first=None, **options):
    return A.AugmentationSequential(
        first or A.RandomResizedCrop((24, 20), scale=(0.3, 0.9)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        A.Normalize(0.4, 0.3),
        **options,
    )


STARTS = {
    "crop": lambda: A.RandomResizedCrop((24, 20), scale=(0.3, 0.9)),
    "antialiased crop": lambda: A.RandomResizedCrop((24, 20), antialias=True),
    "window": lambda: A.RandomCrop((24, 20)),
    "padded window": lambda: A.RandomCrop((70, 70), padding=3, pad_if_needed=True),
    "resize": lambda: A.Resize((24, 20)),
    "antialiased resize": lambda: A.Resize((24, 20), antialias=True),
    "center": lambda: A.CenterCrop((24, 20)),
    "pad": lambda: A.PadTo((50, 50)),
}


@pytest.mark.parametrize("start", STARTS)
def test_each_image_is_augmented_as_by_itself(start, device):
    augment, images = chain(STARTS[start]()), pictures(device)
    seeds = torch.arange(len(SIZES), device=device) + 7
    results = augment(images, seed=seeds)
    for b, x in enumerate(images):
        assert_close(results[b : b + 1], augment(x[None], seed=seeds[b : b + 1]), 1e-4, 1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
def test_equal_sizes_draw_what_a_batch_draws(dtype, device):
    images = pictures(device, [(40, 56)] * 5, dtype)
    augment = A.AugmentationSequential(A.RandomResizedCrop((24, 20)), A.RandomHorizontalFlip(), A.ColorJitter(0.2, 0.2))
    for options in ({"seed": 3}, {}):
        torch.manual_seed(0)
        results = augment(images, **options)
        torch.manual_seed(0)
        assert_close(results, augment(torch.stack(images), **options), 1e-4, 1 if dtype == torch.uint8 else 1e-4)


def test_labels_follow_their_image(device):
    images = pictures(device)
    masks = [torch.randint(0, 9, (n, *x.shape[1:]), device=device) for n, x in zip((1, 2, 0, 3), images)]
    boxes = [torch.rand(n, 4, device=device).cumsum(1) * 9 for n in (2, 0, 1, 3)]
    points = [torch.rand(n, 2, device=device) * 30 for n in (1, 3, 0, 2)]
    augment = chain(data_keys=["input", "mask", "bbox_xyxy", "keypoints"])
    seeds = torch.arange(len(SIZES), device=device)
    results = augment(images, masks, boxes, points, seed=seeds)
    matrices = augment.transform_matrix
    for b, x in enumerate(images):
        alone = augment(x[None], masks[b][None], boxes[b][None], points[b][None], seed=seeds[b : b + 1])
        for of_list, of_image in zip(results[1:], alone[1:]):
            assert_close(of_list[b], of_image[0], 1e-4, 1e-3)
        assert_close(matrices[b : b + 1], augment.transform_matrix, 1e-4, 1e-4)


def test_parameters_repeat_a_call_and_the_inverse_gives_each_size(device):
    augment, images = chain(A.RandomResizedCrop((24, 20))), pictures(device)
    results = augment(images)
    params = augment._params
    assert params[0].data["src"].shape == (len(SIZES), 4, 2)
    assert params[0].data["input_size"].tolist() == [list(size) for size in SIZES]
    back = augment.inverse(results)
    assert [tuple(x.shape) for x in back] == [(3, *size) for size in SIZES]
    assert_close(augment(images, params=params), results, 1e-4, 1e-4)


def test_gradients_reach_each_image(device):
    images = [x.requires_grad_() for x in pictures(device)]
    gradients = torch.autograd.grad(chain()(images).square().sum(), images)
    assert all(g.shape == x.shape and g.abs().sum() > 0 for g, x in zip(gradients, images))


def test_plans_do_not_depend_on_the_sizes(device):
    augment = chain()
    counts = set()
    for i in range(40):
        augment(pictures(device, [(40 + i, 50), (60, 70 - i)]))
        counts.add(len(augment._plans._plans))
    assert len(counts) == 1


def test_what_makes_no_batch_is_refused():
    images = pictures("cpu")
    for augment in (
        A.AugmentationSequential(A.RandomHorizontalFlip()),
        A.AugmentationSequential(A.Resize(24)),
        A.AugmentationSequential(A.RandomMixUpV2(), A.Resize((24, 24))),
        A.ImageSequential(A.RandomCrop((8, 8), p=0.5)),
    ):
        with pytest.raises(TypeError, match="expected a list of images to meet an augmentation of a fixed size"):
            augment(images)
    with pytest.raises(TypeError, match="resample='once'"):
        chain(resample="once")(images)
    with pytest.raises(TypeError, match="random_apply"):
        chain(random_apply=True)(images)
    with pytest.raises(TypeError, match="list of 4 images"):
        A.VideoSequential(A.Resize((24, 24)), data_format="BTCHW")(images)
