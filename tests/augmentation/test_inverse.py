"""`inverse` of results: images, labels, and masks of known pixels."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A

pytestmark = pytest.mark.interface

H, W = 48, 64
MAPS = {
    "elastic": lambda **o: A.RandomElasticTransform((47, 47), (8.0, 8.0), (1.5, 1.5), **o),
    "thin plate": lambda **o: A.RandomThinPlateSpline(0.1, **o),
    "fisheye": lambda **o: A.RandomFisheye((-0.1, 0.1), (-0.1, 0.1), (1.9, 2.1), **o),
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


@pytest.mark.parametrize("name", ["flip", "crop", "rotation", "elastic", "once", "volume"])
def test_predictions_of_another_size_are_moved_at_their_scale(name: str) -> None:
    """As their nearest enlarged forms, whose results are read at the smaller scale."""
    children: dict[str, Any] = {
        "flip": [A.RandomHorizontalFlip(p=1.0)],
        "crop": [A.RandomCrop((32, 32), p=1.0)],
        "rotation": [A.RandomRotation(30.0, p=1.0)],
        "elastic": [A.RandomElasticTransform((9, 9), (4.0, 4.0), p=1.0)],
        "once": [A.RandomAffine(20.0, p=1.0), A.RandomElasticTransform((9, 9), (4.0, 4.0), p=1.0)],
        "volume": [A.RandomHorizontalFlip3D(p=1.0)],
    }
    x = torch.rand(2, 1, 8, 64, 64) if name == "volume" else torch.rand(2, 1, 64, 64)
    resample = "once" if name == "once" else "each"
    augment = A.AugmentationSequential(*children[name], data_keys=["input", "mask"], resample=resample)
    y, _ = augment(x, x, seed=3)
    small = torch.rand(2, 1, *(n // 4 for n in y.shape[2:]))
    large = small
    for axis in range(2, small.dim()):
        large = large.repeat_interleave(4, axis)
    center = (..., *[slice(2, None, 4)] * (small.dim() - 2))
    for params in (None, augment._params):
        back, masks = augment.inverse(small, [*small], params=params)
        expected, mask = augment.inverse(large, large, params=params)
        assert torch.equal(back, expected[center]) and torch.equal(torch.stack(masks), mask[center])
    if len(children[name]) == 1:
        child = augment[0]
        assert torch.equal(child.inverse(small), child.inverse(large)[center])
    if name == "rotation":
        chain, videos = A.ImageSequential(*children[name]), A.VideoSequential(*children[name])
        chain(x), videos(x[:, None])
        assert torch.equal(chain.inverse(small), chain.inverse(large)[center])
        assert torch.equal(videos.inverse(small[:, None]), videos.inverse(large[:, None])[..., 2::4, 2::4])
