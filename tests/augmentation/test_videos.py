"""Videos with their masks, boxes and key points: inside AugmentationSequential, under seeds, and with noise of pixels."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A

KEYS = ["input", "mask", "keypoints", "bbox", "bbox_xyxy", "class"]


def sample(format: str, device: torch.device) -> list[Tensor]:
    """Two videos of three frames with labels of each frame."""
    video = torch.rand(2, 3, 3, 16, 20, generator=torch.Generator().manual_seed(0))
    mask = (video[:, :, :1] > 0.5).long()
    points = torch.rand(2, 3, 5, 2, generator=torch.Generator().manual_seed(1)) * 10
    corners = torch.tensor([[1.0, 1], [8, 1], [8, 6], [1, 6]]).expand(2, 3, 1, 4, 2)
    boxes = torch.tensor([[1.0, 1, 8, 6], [90, 90, 99, 99]]).expand(2, 3, 2, 4)
    classes = torch.arange(12).view(2, 3, 2)
    if format == "BCTHW":
        video, mask = video.transpose(1, 2), mask.transpose(1, 2)
    return [x.to(device) for x in (video, mask, points, corners, boxes, classes)]


def children(format: str, same: bool = True) -> list[Any]:
    video = A.VideoSequential(
        A.RandomAffine(10.0, p=1.0), A.RandomHorizontalFlip(), data_format=format, same_on_frame=same
    )
    return [video, A.ColorJitter(0.1, 0.1, 0.1, 0.1)]


@pytest.mark.parametrize("format", ["BTCHW", "BCTHW"])
@pytest.mark.parametrize("same", [True, False])
def test_labels_follow_their_frames(format: str, same: bool, device: torch.device) -> None:
    inputs = sample(format, device)
    augment = A.AugmentationSequential(*children(format, same), data_keys=KEYS)
    moved = augment(*inputs)
    assert [m.shape for m in moved] == [x.shape for x in inputs]
    video, mask, points, _, boxes, _ = moved

    # Each frame moved by its matrix, as one image would.
    matrix = augment.transform_matrix.view(2, 3, 3, 3)
    assert torch.equal(matrix[:, :1].expand_as(matrix), matrix) == same
    here = inputs[2] @ matrix[..., :2, :2].mT + matrix[..., None, :2, 2]
    torch.testing.assert_close(points, here)
    frames = A.AugmentationSequential(A.RandomInvert(p=0.0), data_keys=["input", "keypoints"])
    assert torch.equal(frames(inputs[0].flatten(0, 1), inputs[2].flatten(0, 1))[1], inputs[2].flatten(0, 1))

    for a, b in zip(augment(*inputs, params=augment._params), moved):
        assert torch.equal(a, b)
    back = augment.inverse(*moved)
    torch.testing.assert_close(back[2], inputs[2], rtol=0, atol=1e-4)
    known = augment.known_pixels(video)
    assert known.dtype == torch.bool and known.shape == mask.shape and known.float().mean() > 0.5
    assert (back[1] == inputs[1])[known].float().mean() > 0.7
    assert augment.visible_points[0].shape == points.shape[:-1] and boxes.shape == inputs[4].shape


def test_seeds_of_videos(device: torch.device) -> None:
    """A seed a video, whatever the batch; frames with parameters of their own have seeds made of it."""
    inputs = sample("BTCHW", device)
    seeds = torch.tensor([5, 9], device=device)
    for same in (True, False):
        augment = A.AugmentationSequential(*children("BTCHW", same), data_keys=KEYS)
        both, last = augment(*inputs, seed=seeds), augment(*[x[1:] for x in inputs], seed=seeds[1:])
        assert all(torch.equal(a[1:], b) for a, b in zip(both, last))
        alone = A.VideoSequential(A.RandomAffine(10.0, p=1.0), same_on_frame=same)
        still = inputs[0][:, :1].expand(-1, 3, -1, -1, -1)
        y = alone(still, seed=seeds)
        assert torch.equal(alone(still[1:], seed=seeds[1:]), y[1:])
        assert torch.equal(y[:, 0], y[:, 1]) == same and not torch.equal(y[0], y[1])


def test_removed_boxes_and_masks_without_channels(device: torch.device) -> None:
    inputs = sample("BTCHW", device)
    augment = A.AugmentationSequential(*children("BTCHW"), data_keys=KEYS, clip_boxes=True)
    *_, boxes, classes = augment(*inputs)
    assert [kept.shape for kept in augment.kept_boxes] == [(2, 3, 1), (2, 3, 2)]
    assert augment.kept_boxes[1][..., 0].all() and not augment.kept_boxes[1][..., 1].any()
    assert (
        (classes[..., 1] == -1).all() and torch.equal(classes[..., 0], inputs[-1][..., 0]) and boxes[0, 0, 1].sum() == 0
    )
    flat = augment(inputs[0], inputs[1][:, :, 0], torch.tensor([4, 7]), data_keys=["input", "mask", "class"])
    assert flat[1].shape == (2, 3, 16, 20) and flat[2].tolist() == [4, 7]
    points = augment(inputs[2], data_keys=["keypoints"])  # by the last call
    torch.testing.assert_close(augment.inverse(points, data_keys=["keypoints"]), inputs[2], rtol=0, atol=1e-4)


def test_errors() -> None:
    augment = A.AugmentationSequential(A.VideoSequential(A.RandomHorizontalFlip()), data_keys=["input", "keypoints"])
    with pytest.raises(AssertionError, match=r"expected input of shape \(B, T, C, H, W\), got \(2, 3, 8, 8\)"):
        augment(torch.zeros(2, 3, 8, 8), torch.zeros(2, 1, 2))
    with pytest.raises(ValueError, match=r"expected keypoints of shape \(2, 3, '...'\), got \(2, 1, 2\)"):
        augment(torch.zeros(2, 3, 3, 8, 8), torch.zeros(2, 1, 2))
    with pytest.raises(AssertionError, match="got the images of another container"):
        A.ImageSequential(A.VideoSequential(A.RandomHorizontalFlip()))(torch.zeros(2, 3, 8, 8))


@pytest.mark.parametrize(
    "make",
    [
        lambda: A.RandomElasticTransform((5, 5), (2.0, 2.0), p=1.0),
        lambda: A.RandomGaussianNoise(p=1.0),
        lambda: A.RandomSaltAndPepperNoise(p=1.0),
        lambda: A.RandomPlasmaShadow(p=1.0),
        lambda: A.RandomRain((10, 20), (5, 6), (1, 2), p=1.0),
        lambda: A.auto.RandAugment(2, 9),
        lambda: A.auto.AutoAugment(),
    ],
    ids=lambda make: type(make()).__name__,
)
@pytest.mark.parametrize("seed", [None, 3, torch.tensor([5, 9])], ids=str)
def test_noise_and_policies_are_those_of_a_video(make: Any, seed: Any, device: torch.device) -> None:
    still = sample("BTCHW", device)[0][:, :1].expand(-1, 3, -1, -1, -1)
    augment = A.VideoSequential(make())
    seed = seed.to(device) if isinstance(seed, Tensor) else seed
    y = augment(still, seed=seed)
    assert torch.equal(y, y[:, :1].expand_as(y))
    torch.testing.assert_close(augment(still, params=augment._params), y, rtol=0, atol=1e-6)
    own = A.VideoSequential(make(), same_on_frame=False)
    assert own(still, seed=seed).shape == still.shape
