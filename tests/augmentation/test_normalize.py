"""Normalization of bytes, which count as x / 255, alone and in every container."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

import kvision as K
import kvision.augmentation as A

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
NORMALIZE = A.Normalize(MEAN, STD)


def stored(device: torch.device, channels: int = 3) -> Tensor:
    return torch.randint(
        0, 256, (4, channels, 8, 10), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    ).to(device)


def normalized(x: Tensor) -> Tensor:
    mean, std = (torch.tensor(values, dtype=torch.float64, device=x.device)[:, None, None] for values in (MEAN, STD))
    return (x.double() / 255 - mean) / std


CONTAINERS: dict[str, Callable[[Tensor], Tensor]] = {
    "alone": NORMALIZE,
    "ImageSequential": A.ImageSequential(NORMALIZE),
    "AugmentationSequential": A.AugmentationSequential(A.RandomHorizontalFlip(p=0.0), NORMALIZE),
    "random_apply": A.ImageSequential(NORMALIZE, random_apply=1),
    "nested, another module behind": A.ImageSequential(A.ImageSequential(NORMALIZE), nn.Identity()),
    "there and back": A.ImageSequential(NORMALIZE, A.Denormalize(MEAN, STD), NORMALIZE),
    "PatchSequential": A.PatchSequential(NORMALIZE, patchwise_apply=False, grid_size=(2, 2)),
    "VideoSequential": lambda x: A.VideoSequential(NORMALIZE)(x[:, None])[:, 0],
    "an operation": lambda x: A.auto.operations.OperationBase(A.Normalize(MEAN, STD, p=1.0))(x),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_bytes_count_as_fractions_of_255(name: str, device: torch.device) -> None:
    x = stored(device)
    y = CONTAINERS[name](x)
    assert y.dtype == torch.float32
    torch.testing.assert_close(y.double(), normalized(x), rtol=0, atol=2e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_samples_that_are_not_chosen_get_the_unit_as_well(channels: int, device: torch.device) -> None:
    x, half = stored(device, channels), A.Normalize(0.5, 0.25, p=0.5, p_batch=0.5)
    values = x.double() / 255
    results = {"chosen": 4 * values - 2, "others": values}
    for seed in range(8):
        y = half(x, seed=seed)
        chosen = half._params["batch_prob"].to(device)[:, None, None, None] > 0.5
        expected = torch.where(chosen, results["chosen"], results["others"])
        assert y.dtype == torch.float32
        torch.testing.assert_close(y.double(), expected, rtol=0, atol=1e-6)
        assert torch.equal(half(x, params=half._params), y)


def test_p_of_0_leaves_bytes(device: torch.device) -> None:
    x = stored(device)
    assert torch.equal(A.Normalize(MEAN, STD, p=0.0)(x), x)
    assert torch.equal(A.ImageSequential(A.Normalize(MEAN, STD, p=0.0))(x), x)


def test_bytes_and_floats_give_the_same_behind_it(device: torch.device) -> None:
    """What follows in a chain gets float32, whether it joins the pass or not."""
    chain = A.ImageSequential(
        A.RandomHorizontalFlip(),
        A.Denormalize(0.1, 0.5),
        A.RandomBrightness((0.5, 1.5), p=1.0),
        A.RandomAffine(20.0, p=1.0),
    )
    x = stored(device)
    torch.testing.assert_close(chain(x, seed=1), chain(x.float() / 255, seed=1), rtol=0, atol=1e-5)


def test_cells_of_bytes_get_the_unit_of_their_neighbors(device: torch.device) -> None:
    x = stored(device)
    y = A.PatchSequential(NORMALIZE, nn.Identity(), grid_size=(1, 2))(x)
    torch.testing.assert_close(y[..., :5].double(), normalized(x[..., :5]), rtol=0, atol=2e-6)
    torch.testing.assert_close(y[..., 5:], x[..., 5:].float() / 255)


def test_pipelines_of_the_guide_take_bytes(device: torch.device) -> None:
    """The first pipeline of docs/augmentation.md: up to the rounding of its last pass, bytes give what floats give."""
    train = A.AugmentationSequential(
        A.RandomResizedCrop((8, 8)), A.RandomHorizontalFlip(), A.ColorJitter(0.2, 0.2, 0.2, 0.1), NORMALIZE
    )
    x = stored(device)
    assert (train(x, seed=2) - train(x.float() / 255, seed=2)).abs().max() < 1.5 / 255 / min(STD)


def test_mean_of_bytes_is_refused(device: torch.device) -> None:
    message = r": expected mean of at most 1 for uint8 images, which count as x / 255, got \[127.5\]"
    for chain in (A.Normalize(127.5, 127.5), A.ImageSequential(A.RandomHorizontalFlip(), A.Normalize(127.5, 127.5))):
        with pytest.raises(ValueError, match="^Normalize" + message):
            chain(stored(device))
        assert chain(stored(device).float()).max() <= 1
    with pytest.raises(ValueError, match="^Denormalize" + message):
        A.Denormalize(127.5, 60.0)(stored(device))


def test_flags_of_a_call_and_changed_flags(device: torch.device) -> None:
    x, augment = stored(device).float() / 255, A.Normalize(MEAN, STD)
    torch.testing.assert_close(augment(x, mean=torch.zeros(3), std=torch.full((3,), 0.5)), 2 * x)
    augment.flags["mean"], augment.flags["std"] = torch.zeros(3), torch.ones(3)
    torch.testing.assert_close(augment(x), x)


def test_enhance_keeps_the_unit_of_its_images(device: torch.device) -> None:
    x = stored(device).float()
    torch.testing.assert_close(K.enhance.normalize(x, torch.tensor([127.5]), torch.tensor([127.5])), x / 127.5 - 1)
