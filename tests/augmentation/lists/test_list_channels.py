"""Changes of whole channels of images in lists: what each image becomes alone, by one program."""

from __future__ import annotations

import pytest
import torch

from augmentation.test_lists import SMALL, assert_as_alone, pictures
from kvision import augmentation as A
from kvision.augmentation import channels as programs
from op_tests import assert_close

CHANGES = {
    "dropped": lambda p: A.RandomChannelDropout(p=p),
    "filled": lambda p: A.RandomChannelDropout(2, 0.3, p=p),
    "light": lambda p: A.RandomPlanckianJitter("CIED", p=p),
    "order": lambda p: A.RandomChannelShuffle(p=p),
    "factors": lambda p: A.MultiplicativeNoise((0.5, 1.5), per_channel=True, p=p),
    "one factor": lambda p: A.MultiplicativeNoise((0.5, 1.5), p=p),
}


@pytest.mark.parametrize("p", [0.6, 1.0])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", CHANGES)
def test_channels_of_a_list(name, dtype, p, device):
    augment, images = CHANGES[name](p), pictures(device, SMALL, dtype)
    assert_as_alone(augment, images)
    assert_as_alone(A.ImageSequential(A.RandomHorizontalFlip(), augment, A.RandomInvert()), images)


def test_other_numbers_of_channels(device):
    for name in ("dropped", "order", "factors", "one factor"):
        assert_as_alone(CHANGES[name](0.6), [torch.rand(4, *size, device=device) for size in SMALL])


@pytest.mark.parametrize("name", ["factors", "one factor"])
def test_factors_are_one_program_drawn_and_replayed(name, device, monkeypatch):
    operator, calls = programs.warp_and_color_to_list, []
    monkeypatch.setattr(programs, "warp_and_color_to_list", lambda *a: (calls.append(a), operator(*a))[1])
    augment, images = CHANGES[name](0.6), pictures(device, SMALL)
    results = augment(images, seed=3)
    assert len(calls) == 1
    assert all(torch.equal(a, b) for a, b in zip(augment(images, params=augment._params), results))
    assert len(calls) == 2


def test_all_orders_of_channels(device):
    images = [torch.tensor([0.1, 0.2, 0.3], device=device).view(3, 1, 1).expand(3, 4, 5 + i % 2) for i in range(64)]
    results = A.RandomChannelShuffle(p=1.0)(images, seed=torch.arange(64, device=device))
    assert len({tuple(y[:, 0, 0].tolist()) for y in results}) == 6


def test_gradients_of_channels(device):
    images = [x.requires_grad_() for x in pictures(device, SMALL)]
    for name in ("filled", "order"):
        augment, seeds = CHANGES[name](0.6), torch.arange(len(images), device=device)
        gradients = torch.autograd.grad(
            sum((k * y).sum() for k, y in enumerate(augment(images, seed=seeds), 1)), images
        )
        for b, x in enumerate(images):
            alone = (b + 1) * augment(x[None], seed=seeds[b : b + 1]).sum()
            assert torch.allclose(gradients[b], torch.autograd.grad(alone, x)[0])


@pytest.mark.parametrize("channels", [3, 4])
def test_a_shuffle_copies_what_is_no_finite_number(channels, device):
    images = [torch.rand(channels, 5, 6 + i % 2, device=device) for i in range(8)]
    for i, x in enumerate(images):
        x[i % channels, 1, 2], x[0, 0, 0] = torch.nan, torch.inf
    for x, y in zip(images, A.RandomChannelShuffle(p=0.8)(images, seed=torch.arange(8, device=device))):
        assert y.isnan().sum() == 1 and torch.equal(y.nan_to_num(7).sort(0).values, x.nan_to_num(7).sort(0).values)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("channels", [2, 5])
def test_contrast_of_other_channels_is_about_the_mean_of_all(channels, dtype, device):
    """Of batches in any layout, videos and lists, by one call of an operator."""
    x = torch.rand(3, channels, 9, 14, dtype=dtype, device=device)
    mean = x.mean((1, 2, 3), keepdim=True)
    expected = (mean + 0.5 * (x - mean)).clamp(0, 1)
    augment = A.ColorJitter(contrast=(0.5, 0.5))
    for batch in (x, x.contiguous(memory_format=torch.channels_last), x.flip(3).flip(3), x[:, :, :, None].squeeze(3)):
        y = augment(batch)
        assert_close(y, expected, 1e-6, 1e-6)
        assert y.stride() == batch.stride()
    assert_close(torch.stack(augment(list(x))), expected, 1e-6, 1e-6)
    clips = x[:, None].expand(-1, 4, -1, -1, -1)
    assert_close(A.VideoSequential(augment)(clips), expected[:, None].expand_as(clips), 1e-6, 1e-6)
