"""`inverse` of results: images, labels, and masks of known pixels."""

from __future__ import annotations

import copy
from fractions import Fraction
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision.augmentation as A

pytestmark = pytest.mark.interface

H, W = 48, 64
MAPS = {
    "elastic": lambda **o: A.RandomElasticTransform((47, 47), (8.0, 8.0), (1.5, 1.5), **o),
    "thin plate": lambda **o: A.RandomThinPlateSpline(0.1, **o),
    "fisheye": lambda **o: A.RandomFisheye((-0.1, 0.1), (-0.1, 0.1), (1.9, 2.1), **o),
    "nodes": lambda **o: A.PiecewiseAffine((0.1, 0.15), **o),
}


def smooth(device: torch.device) -> Tensor:
    y, x = torch.linspace(0, 3, H)[:, None], torch.linspace(0, 4, W)
    return torch.stack([(x + y).sin(), x.cos() * y.cos(), (x - y).sin()])[None].mul(0.4).add(0.5).to(device)


@pytest.mark.parametrize("name", MAPS)
def test_maps_are_undone(name: str, device: torch.device) -> None:
    """Image, mask, boxes and points come back where the result shows them."""
    image = smooth(device)
    mask = (image[:, :1] > 0.5).to(torch.uint8)
    points = torch.tensor([[[30.0, 20.0], [40.0, 28.0]]], device=device)
    box = torch.tensor([[[22.0, 14.0, 42.0, 30.0]]], device=device)
    augment = A.AugmentationSequential(MAPS[name](p=1.0), data_keys=["input", "mask", "keypoints", "bbox_xyxy"])
    for seed in range(3):
        moved = augment(image, mask, points, box, seed=seed)
        back = augment.inverse(*moved)
        known = augment.known_pixels(moved[0])
        assert known.shape == (1, 1, H, W) and 0.4 < known.float().mean() <= 1
        assert ((back[0] - image).abs() * known).max() < 0.06
        assert (back[0] * ~known)[..., 8:-8, 8:-8].numel() and ((back[1] != mask) & known).float().mean() < 0.03
        torch.testing.assert_close(back[2], points, rtol=0, atol=0.02)
        result = back[3] - box  # around what was around the moved one
        assert (result[..., :2] < 0.05).all() and (result[..., 2:] > -0.05).all() and result.abs().max() < 12
        assert augment.visible_points[0].all()
        for a, b in zip(augment.inverse(*moved, params=augment._params), back):
            torch.testing.assert_close(a, b)


@pytest.mark.parametrize("name", MAPS)
def test_single_map(name: str, device: torch.device) -> None:
    image = smooth(device).expand(3, -1, -1, -1)
    augment = MAPS[name](p=0.5)
    moved = augment(image, seed=4)
    chosen = augment._params["batch_prob"] > 0.5
    assert 0 < chosen.sum() < 3
    back = augment.inverse(moved)
    assert torch.equal(back[~chosen], image[~chosen]) and not torch.equal(back[chosen], image[chosen])
    known = augment.known_pixels(moved)
    assert known[~chosen].all() and ((back - image).abs() * known).max() < 0.06
    assert (augment.inverse((255 * moved).byte()).dtype) == torch.uint8


@pytest.mark.parametrize("name", MAPS)
def test_boxes_bound_what_they_contained(name: str, device: torch.device) -> None:
    """Sides bend: a moved box is around all of its outline, not only around the corners."""
    box = torch.tensor([[[14.0, 10.0, 50.0, 38.0]]], device=device)
    corners = torch.tensor([[[[14.0, 10], [49, 10], [49, 37], [14, 37]]]], device=device)
    filled = torch.zeros(1, 1, H, W, device=device)
    filled[..., 10:38, 14:50] = 1
    augment = A.AugmentationSequential(MAPS[name](p=1.0), data_keys=["input", "bbox_xyxy", "bbox"])
    for seed in range(5):
        moved, result, quadrangle = augment(filled, box, corners, seed=seed)
        rows, columns = (moved[0, 0] > 0.5).nonzero().float().unbind(1)
        x0, y0, x1, y1 = result[0, 0]
        assert x0 - 0.6 <= columns.min() and columns.max() + 1 <= x1 + 0.6
        assert y0 - 0.6 <= rows.min() and rows.max() + 1 <= y1 + 0.6
        assert (x1 - x0 - (columns.max() - columns.min() + 1)).abs() < 2
        assert (y1 - y0 - (rows.max() - rows.min() + 1)).abs() < 2
        # All pixels are inside of the quadrangle, whose sides touch them.
        first, last = quadrangle[0, 0], quadrangle[0, 0].roll(-1, 0)
        along = (last - first) / (last - first).norm(dim=-1, keepdim=True)
        pixels = torch.stack([columns, rows], -1)
        offset = along[:, 0, None] * (pixels[:, 1] - first[:, 1, None]) - along[:, 1, None] * (
            pixels[:, 0] - first[:, 0, None]
        )
        assert offset.min() > -0.6 and offset.amin(1).max() < 1.1


def test_known_pixels_of_crops_and_turns(device: torch.device) -> None:
    image = smooth(device).expand(2, -1, -1, -1)
    crop = A.AugmentationSequential(A.RandomCrop((20, 30)), A.RandomHorizontalFlip())
    moved = crop(image)
    known, back = crop.known_pixels(moved), crop.inverse(moved)
    assert known.sum((1, 2, 3)).tolist() == [600, 600]
    assert torch.equal(back * known, image * known) and (back * ~known).abs().sum() == 0
    assert torch.equal(crop.known_pixels(moved, params=crop._params), known)

    # Left the image in the first of two shifts, although the second one brings it back.
    apart = A.ImageSequential(A.RandomTranslate((0.25, 0.25), p=1.0), A.RandomTranslate((-0.25, -0.25), p=1.0))
    known = apart.known_pixels(apart(image))
    assert known[..., : W - 16].all() and not known[..., W - 16 :].any()
    alone = A.RandomHorizontalFlip(p=1.0)
    assert alone.known_pixels(alone(image)).all()
    assert A.RandomInvert().known_pixels(image).all()


def test_visible_points(device: torch.device) -> None:
    """Points that a crop cuts off are not visible, also where a later shift brings their positions back."""
    image = smooth(device)
    points = torch.tensor([[[2.0, 2.0], [32.0, 24.0], [60.0, 45.0]]], device=device)
    crop = A.AugmentationSequential(A.CenterCrop((20, 20)), data_keys=["input", "keypoints"])
    crop(image, points)
    assert crop.visible_points[0].tolist() == [[False, True, False]]
    crop(image, [points[0]])
    assert isinstance(crop.visible_points[0], list) and crop.visible_points[0][0].tolist() == [False, True, False]

    apart = [A.RandomTranslate((0.25, 0.25), p=1.0), A.RandomTranslate((-0.25, -0.25), p=1.0)]
    back = A.AugmentationSequential(*apart, data_keys=["input", "keypoints"])
    back(image, points)
    assert back.visible_points[0].tolist() == [[True, True, False]]


def at_centers(x: Tensor, size: list[int]) -> Tensor:
    """Each pixel of a result of a size is the one of `x` that contains its center."""
    for axis, n in enumerate(size, start=2):
        at = [int(Fraction(2 * i + 1, 2 * n) * x.shape[axis]) for i in range(n)]
        x = x.index_select(axis, torch.tensor(at, device=x.device))
    return x


@pytest.mark.parametrize(
    "name", ["flip", "crop", "rotation", "expand", "elastic", "once", "policy", "nested policy", "volume"]
)
def test_predictions_of_another_size_are_moved_at_their_scale(name: str, device: torch.device) -> None:
    """As their nearest enlarged forms, whose results are read at the smaller scale."""
    size = {"flip": (8, 8), "crop": (41, 33)}.get(name, (13, 9))
    children: dict[str, Any] = {
        "flip": [A.RandomHorizontalFlip(p=1.0)],
        "crop": [A.RandomCrop((16, 20), p=1.0)],
        "rotation": [A.RandomRotation(30.0, p=1.0)],
        "expand": [A.RandomRotation(30.0, p=1.0, expand=True)],
        "elastic": [A.RandomElasticTransform((9, 9), (4.0, 4.0), p=1.0)],
        "once": [A.RandomAffine(20.0, p=1.0), A.RandomElasticTransform((9, 9), (4.0, 4.0), p=1.0)],
        "policy": [A.auto.RandAugment(2, 20)],
        "nested policy": [A.ImageSequential(A.auto.AutoAugment()), A.CenterCrop((24, 28))],
        "volume": [A.RandomRotation3D((0.0, 0.0, 30.0), p=1.0)],
    }
    x = torch.rand((2, 3, 4, 32, 32) if name == "volume" else (2, 3, 32, 32), device=device)
    resample = "once" if name == "once" else "each"
    augment = A.AugmentationSequential(*children[name], data_keys=["input", "mask"], resample=resample).to(device)
    y, _ = augment(x, x, seed=3)
    result = y.shape[2:]
    own = [*result[:-2], *size]
    small = torch.rand(2, 3, *own, device=device)
    large = at_centers(small, [*result])
    expected_size = [int(Fraction(n * m, k) + Fraction(1, 2)) for n, m, k in zip(x.shape[2:], own, result)]
    known = at_centers(augment.known_pixels(large), expected_size)
    for params in (None, augment._params):
        back, masks = augment.inverse(small, [*small], params=params)
        expected, mask = augment.inverse(large, large, params=params)
        assert torch.equal(back, at_centers(expected, expected_size))
        assert torch.equal(torch.stack(masks), at_centers(mask, expected_size))
        assert torch.equal(augment.known_pixels(small, params=params), known)
    if len(children[name]) == 1:
        child = augment[0]
        assert torch.equal(child.inverse(small), at_centers(child.inverse(large), expected_size))
        assert torch.equal(child.inverse(small), child.inverse(small, params=child._params))
        assert torch.equal(child.known_pixels(small), at_centers(child.known_pixels(large), expected_size))


def test_predictions_of_another_size_of_videos(device: torch.device) -> None:
    rotation = A.RandomRotation(30.0, p=1.0)
    videos = torch.rand(2, 3, 1, 32, 32, device=device)
    chain = A.VideoSequential(rotation, same_on_frame=False)
    container = A.AugmentationSequential(A.VideoSequential(rotation), data_keys=["input"])
    small = torch.rand(2, 3, 1, 11, 16, device=device)
    for augment in (chain, container):
        augment(videos, seed=1)
        large = at_centers(small.flatten(0, 1), [32, 32]).unflatten(0, (2, 3))
        for params in (None, augment._params):
            back = augment.inverse(large, params=params).flatten(0, 1)
            assert torch.equal(augment.inverse(small, params=params), at_centers(back, [11, 16]).unflatten(0, (2, 3)))
            known = augment.known_pixels(large, params=params).flatten(0, 1)
            assert torch.equal(
                augment.known_pixels(small, params=params), at_centers(known, [11, 16]).unflatten(0, (2, 3))
            )


def test_parameters_that_say_no_size(device: torch.device) -> None:
    """Those of empty containers, grids and other modules; images, or the last call, have it."""
    x, points = torch.rand(2, 3, 16, 16, device=device), torch.rand(2, 4, 2, device=device)
    noise = A.RandomGaussianNoise(p=1.0)
    for children in (
        [],
        [A.ImageSequential(), A.RandomHorizontalFlip(p=1.0)],
        [A.PatchSequential(noise, patchwise_apply=False)],
        [nn.Upsample(scale_factor=1)],
    ):
        augment = A.AugmentationSequential(*children, data_keys=["input", "keypoints"])
        y, moved = augment(x, points)
        params = augment._params
        assert torch.equal(augment(points, params=params, data_keys=["keypoints"]), moved)
        back, points_back = augment.inverse(y[..., ::2, ::2], moved, params=params)
        assert back.shape == (2, 3, 8, 8)
        torch.testing.assert_close(points_back, points)
        assert augment.known_pixels(y, params=params).shape == (2, 1, 16, 16)


@pytest.mark.parametrize("kind", [A.ImageSequential, A.AugmentationSequential, A.VideoSequential])
def test_containers_that_were_not_called_have_no_inverse(kind: Any, device: torch.device) -> None:
    x = torch.rand(2, 3, 1, 8, 8, device=device)[:, (slice(None) if kind is A.VideoSequential else 0)]
    augment = kind(A.RandomHorizontalFlip(p=1.0))
    with pytest.raises(RuntimeError, match=f"{kind.__name__}.inverse: there was no call yet; pass its params"):
        augment.inverse(x)
    called = kind(A.RandomHorizontalFlip(p=1.0))
    called(x)
    assert torch.equal(augment.inverse(x, params=called._params), x.flip(-1))
    augment._params = called._params
    assert torch.equal(augment.inverse(x), x.flip(-1))
    assert torch.equal(copy.deepcopy(called).inverse(x, params=called._params), x.flip(-1))


def test_masks_of_one_image_have_an_inverse(device: torch.device) -> None:
    """As many axes as the image, for as many instances as there are."""
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["input", "mask"])
    x, masks = torch.rand(3, 6, 8, device=device), torch.randint(0, 5, (2, 6, 8), device=device)
    y, moved = augment(x, masks)
    assert torch.equal(moved, masks.flip(-1)) and torch.equal(augment.inverse(y, moved)[1], masks)
