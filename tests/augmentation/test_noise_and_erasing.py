"""Random noise, erased rectangles and light: their distributions, labels and replay in other types."""

from __future__ import annotations

import pytest
import torch

import kvision.augmentation as A
from kvision.augmentation import random_generator as rg


@pytest.mark.parametrize("name", ["RandomGaussianNoise", "RandomSaltAndPepperNoise"])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float64], ids=str)
def test_parameters_repeat_the_fused_noise(name: str, dtype: torch.dtype, device: torch.device) -> None:
    x = torch.rand(4, 3, 9, 7, device=device)
    x = (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    augment = getattr(A, name)(p=0.7)
    y = augment(x)
    again = augment(x, params=dict(augment._params))
    if dtype == torch.float64:  # parameters are float32
        torch.testing.assert_close(again, y, rtol=0, atol=1e-6)
    else:
        assert torch.equal(again, y)


def test_gaussian_noise_has_its_mean_and_deviation(device: torch.device) -> None:
    noise = A.RandomGaussianNoise(0.25, 2.0, p=1.0)(torch.zeros(8, 3, 64, 64, device=device), seed=1)
    assert abs(noise.mean() - 0.25) < 0.03 and abs(noise.std() - 2) < 0.03
    normal = torch.erf((noise - 0.25) / 2 / 2**0.5)  # uniform in -1 .. 1
    assert abs((normal.abs() < 0.5).float().mean() - 0.5) < 0.01


def test_a_subclass_reads_the_noise() -> None:
    class Doubled(A.RandomGaussianNoise):
        def apply_transform(self, input, params, flags, transform=None):  # type: ignore[no-untyped-def]
            return input + 2 * params["gaussian_noise"]

    x = torch.zeros(2, 3, 5, 5)
    once, twice = A.RandomGaussianNoise(p=1.0)(x, seed=3), Doubled(p=1.0)(x, seed=3)
    assert torch.equal(twice, 2 * once)


def test_salt_and_pepper_hit_all_channels(device: torch.device) -> None:
    x = torch.full((4, 3, 64, 64), 0.5, device=device)
    augment = A.RandomSaltAndPepperNoise(0.2, 0.25, p=1.0)
    y = augment(x, seed=1)
    assert torch.equal(y, y[:, :1].expand_as(y))
    assert abs((y == 1).float().mean() - 0.05) < 0.01 and abs((y == 0).float().mean() - 0.15) < 0.015
    params = augment._params
    assert torch.equal(params["mask_salt"], (y == 1).cpu()) and torch.equal(params["mask_pepper"], (y == 0).cpu())


def test_erasing_zeroes_masks_and_leaves_boxes() -> None:
    augment = A.AugmentationSequential(A.RandomErasing(value=0.5, p=0.7), data_keys=["input", "mask", "bbox_xyxy"])
    x, masks = torch.ones(8, 3, 16, 16), torch.ones(8, 1, 16, 16, dtype=torch.int64)
    boxes = torch.tensor([[[1.0, 2, 8, 9]]]).expand(8, 1, 4)
    y, moved, same = augment(x, masks, boxes)
    assert torch.equal(moved == 0, y[:, :1] == 0.5) and (moved == 0).any() and (moved == 1).all((1, 2, 3)).any()
    assert torch.equal(same, boxes)


def test_erasing_fills_bytes() -> None:
    y = A.RandomErasing((1.0, 1.0), (1.0, 1.0), value=0.5, p=1.0)(torch.zeros(1, 1, 4, 4, dtype=torch.uint8))
    assert y.unique().tolist() == [128]


@pytest.mark.parametrize("name", ["Gaussian", "Linear", "LinearCorner"])
def test_light_is_as_strong_as_its_gain(name: str) -> None:
    kwargs = {"gain": (0.1, 0.2), "sign": (-1.0, 1.0)}
    augment = getattr(A, f"Random{name}Illumination")(p=1.0, **kwargs)
    x = torch.full((32, 1, 9, 12), 0.5)
    change = augment(x, seed=2) - x
    strongest = change.abs().amax((1, 2, 3))
    assert (strongest >= 0.0999).all() and (strongest <= 0.2001).all()
    assert change.abs().amin((1, 2, 3)).max() < 1e-6
    assert (change.sum((1, 2, 3)) > 0).any() and (change.sum((1, 2, 3)) < 0).any()


def test_generators_draw_by_themselves() -> None:
    for generator in (rg.GaussianNoiseGenerator(0.0, 1.0), rg.SaltAndPepperGenerator((0.1, 0.2), 0.5)):
        torch.manual_seed(3)
        first = generator((4, 3, 6, 5), same_on_batch=True)
        torch.manual_seed(3)
        second = generator((4, 3, 6, 5), same_on_batch=True)
        for name, value in first.items():
            assert torch.equal(value, second[name])
            assert torch.equal(value, value[:1].expand_as(value))


@pytest.mark.parametrize(
    ("name", "kwargs", "message"),
    [
        ("RandomGaussianNoise", {"std": -1.0}, "std"),
        ("RandomSaltAndPepperNoise", {"amount": (0.5, 1.5)}, "amount"),
        ("RandomErasing", {"value": 2.0}, "value"),
        ("RandomErasing", {"ratio": (0.0, 1.0)}, "ratio"),
        ("RandomGaussianIllumination", {"sigma": (-1.0, 1.0)}, "sigma"),
        ("RandomLinearIllumination", {"gain": (0.0, 2.0)}, "gain"),
        ("RandomLinearCornerIllumination", {"sign": (-2.0, 0.0)}, "sign"),
    ],
)
def test_wrong_ranges(name: str, kwargs: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected {message}"):
        getattr(A, name)(**kwargs)


def test_parameters_of_a_shape() -> None:
    assert A.RandomGaussianNoise().forward_parameters((2, 3, 4, 5))["gaussian_noise"].shape == (2, 3, 4, 5)
    assert A.RandomAffine(10.0).forward_parameters((2, 3, 4, 5))["center"].tolist() == [[2.0, 1.5], [2.0, 1.5]]
