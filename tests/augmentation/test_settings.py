"""Settings and types of images that Kornia or torchvision take."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import GEOMETRIC, GEOMETRIC3D, IMAGES, MAPS, VOLUMES, Augmentation

pytestmark = pytest.mark.interface


def images(device: Any = "cpu", batch: int = 4) -> Tensor:
    return torch.rand(batch, 3, 16, 20, generator=torch.Generator().manual_seed(0)).to(device)


def volumes(device: Any = "cpu") -> Tensor:
    return torch.rand(2, 2, 6, 7, 8, generator=torch.Generator().manual_seed(0)).to(device)


@pytest.mark.parametrize("case", [c for c in (*IMAGES, *VOLUMES) if c.name != "PadTo"], ids=lambda case: case.name)
def test_params_at_p_0_have_all_names(case: Augmentation) -> None:
    x = volumes() if case in VOLUMES else images()
    never, always = case.make(p=0.0), case.make(p=1.0)
    assert torch.equal(never(x), x)
    always(x)
    none, drawn = never._params, always._params
    assert {name: (p.shape, p.dtype) for name, p in none.items()} == {
        name: (p.shape, p.dtype) for name, p in drawn.items()
    }
    assert not none["batch_prob"].any()
    assert torch.equal(never(x, params=none), x)
    if not case.changes_size:
        assert torch.equal(case.make(p=0.5)(x, params=none), x)


@pytest.mark.parametrize("name", ["RandomMixUpV2", "RandomCutMixV2", "PatchMix", "RandomJigsaw", "RandomMosaic"])
def test_params_of_mixes_at_p_0_mix_nothing(name: str) -> None:
    x = images()
    never, always = getattr(A, name)(p=0.0), getattr(A, name)(p=1.0)
    never(x), always(x)
    assert never._params.keys() == always._params.keys()
    assert torch.equal(always(x, params=never._params), x)


@pytest.mark.parametrize("dtype", [torch.int16, torch.uint16], ids=str)
@pytest.mark.parametrize("case", [*GEOMETRIC, *MAPS, *GEOMETRIC3D], ids=lambda case: case.name)
def test_geometric_classes_take_integers_of_16_bits(
    case: Augmentation, dtype: torch.dtype, device: torch.device
) -> None:
    values = (volumes if case in GEOMETRIC3D else images)(device) * 60000 - (30000 if dtype == torch.int16 else 0)
    x, augment = values.to(dtype), case.make(p=1.0)
    y = augment(x, seed=3)
    assert y.dtype == dtype
    assert torch.equal(y, augment(x.float(), seed=3).round().clamp(-32768, 65535).to(dtype))
    assert torch.equal(augment(x, params=augment._params), y)
    back = augment.inverse(y)
    assert back.dtype == dtype and torch.equal(back, augment.inverse(y.float()).round().to(dtype))
    container = A.AugmentationSequential(A.ImageSequential(augment), data_keys=["input", "input"])
    one, other = container(x, x, seed=2)
    assert one.dtype == dtype and torch.equal(one, other)
    assert torch.equal(one, container(x.float(), x.float(), seed=2)[0].round().to(dtype))
    assert container.inverse(one, one)[0].dtype == dtype


def test_classes_of_values_refuse_integers_of_16_bits() -> None:
    x = images().to(torch.int16)
    for augment in (A.ColorJitter(0.1), A.ImageSequential(A.RandomAffine(3.0), A.ColorJitter(0.1))):
        with pytest.raises(TypeError, match=f"{type(augment).__name__}: expected input of a floating-point type"):
            augment(x)


def test_modes_of_the_matrix_of_containers() -> None:
    flip, elastic = A.RandomHorizontalFlip(p=1.0), A.RandomElasticTransform(p=1.0)
    x = images()
    for children, rigid in (((flip, A.ColorJitter(0.1)), True), ((flip, elastic), False)):
        silent, mode, skip = (
            A.AugmentationSequential(*children, transformation_matrix_mode=name) for name in ("silent", "rigid", "skip")
        )
        y = silent(x, seed=1)
        assert torch.equal(skip(x, seed=1), y) and skip.transform_matrix is None
        if rigid:
            mode(x)
            assert torch.equal(mode.transform_matrix, silent.transform_matrix)
    nested = A.AugmentationSequential(A.ImageSequential(elastic), transformation_matrix_mode="rigid")
    for augment in (mode, nested):
        with pytest.raises(RuntimeError, match="matrices for .* 'rigid', got RandomElasticTransform"):
            augment(x)
    policy = A.auto.RandAugment(2, 9, transformation_matrix_mode="skip")
    policy(x)
    assert policy.transform_matrix is None


@pytest.mark.parametrize("container", [A.ImageSequential, A.AugmentationSequential, A.VideoSequential])
def test_random_apply_of_one_number_is_that_many_to_all(container: Any) -> None:
    children = [A.RandomInvert(p=1.0), A.RandomHorizontalFlip(p=1.0), A.RandomVerticalFlip(p=1.0)]
    augment = container(*children, random_apply=(2,))
    x = images()[:, None].expand(-1, 3, -1, -1, -1) if container is A.VideoSequential else images()
    counts = set()
    for seed in range(20):
        augment(x, seed=seed)
        counts.add(len(augment._params))
    assert counts == {2, 3}


def test_constant_channels_keep_their_value_in_auto_contrast(device: torch.device) -> None:
    x = torch.tensor([77, 77, 10, 200], dtype=torch.uint8, device=device).reshape(1, 2, 1, 2).expand(3, 2, 4, 2)
    expected = torch.tensor([77, 77, 0, 255], dtype=torch.uint8, device=device).reshape(1, 2, 1, 2).expand(3, 2, 4, 2)
    assert torch.equal(A.RandomAutoContrast(p=1.0)(x), expected)
    y = A.RandomAutoContrast(p=1.0)(x[:, :1] / 255)
    assert torch.equal(y, x[:, :1] / 255)


@pytest.mark.parametrize("gamma", [-0.4, -1.5])
def test_fisheyes_with_negative_exponents(gamma: float, device: torch.device) -> None:
    """An image of two ramps reads the position that the formula gives."""
    size = 33
    ramp = torch.linspace(-1, 1, size, device=device)
    x = torch.stack([ramp.expand(size, size), ramp[:, None].expand(size, size)])[None].double()
    fisheye = A.RandomFisheye((0.25, 0.25), (-0.25, -0.25), (gamma, gamma), p=1.0)
    y = fisheye(x)
    center = torch.tensor([0.25, -0.25], device=device, dtype=torch.float64)[:, None, None]
    source = x[0] * (1 + (x[0] - center).norm(dim=0).clamp(min=2.0**-10) ** gamma)
    inside = (source.abs() <= 1).all(0)
    assert y.isfinite().all() and 20 < inside.sum() < size**2 - 20
    torch.testing.assert_close(y[0][:, inside], source[:, inside], rtol=1e-5, atol=1e-5)
    assert (y[0][:, (source.abs() > 1 + 2 / (size - 2)).any(0)] == 0).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
def test_erasing_with_a_color_and_with_noise(dtype: torch.dtype, device: torch.device) -> None:
    x = torch.ones(40, 3, 16, 20, device=device) * (255 if dtype == torch.uint8 else 1)
    x, full = x.to(dtype), 255 if dtype == torch.uint8 else 1
    number, color, noise = (
        A.RandomErasing((0.2, 0.3), value=value, p=0.7) for value in (0.0, (0.2, 0.4, 0.6), "random")
    )
    erased = number(x, seed=5) == 0
    assert erased.any() and not erased.all()
    values = torch.tensor([0.2, 0.4, 0.6], device=device).reshape(3, 1, 1) * full
    assert torch.equal(color(x, seed=5), torch.where(erased, values.to(dtype), x))
    assert torch.equal(color(x, params=color._params), color(x, seed=5))
    y = noise(x, seed=5)
    assert torch.equal(y[~erased], x[~erased]) and torch.equal(noise(x, params=noise._params), y)
    drawn = y[erased].double() / full
    assert abs(drawn.mean() - 0.5) < 0.01 and abs(drawn.std() - 12**-0.5) < 0.01
    assert 0 <= drawn.min() < 0.01 and 0.99 < drawn.max() <= 1
    per_channel = y.double()[:, 0][erased[:, 0]], y.double()[:, 1][erased[:, 1]]
    assert abs(torch.corrcoef(torch.stack(per_channel))[0, 1]) < 0.05
    with pytest.raises(ValueError, match="RandomErasing: expected value of 1 channels, got 3"):
        color(x[:, :1])
    for wrong in ("pixel", 2.0, (0.1, 2.0, 0.1)):
        with pytest.raises(ValueError, match="RandomErasing: expected value"):
            A.RandomErasing(value=wrong)


def test_rotations_fill_and_mirror(device: torch.device) -> None:
    x = images(device)
    plain, filled, border = (
        A.RandomRotation(30.0, p=0.8, **k) for k in ({}, {"fill": 0.4}, {"padding_mode": "border"})
    )
    affine = A.RandomAffine(30.0, p=0.8, padding_mode="fill", fill_value=0.4)
    y = filled(x, seed=2)
    angle = {"angle": filled._params["degrees"], "batch_prob": filled._params["batch_prob"]}
    affine(x)
    torch.testing.assert_close(affine(x, params={**affine._params, **angle}), y, rtol=1e-4, atol=1e-4)
    assert (plain(x, seed=2) == 0).any() and not (border(x, seed=2) == 0).any()
    colors = A.RandomRotation((45.0, 45.0), p=1.0, fill=(0.2, 0.4, 0.6))((255 * x).byte())
    assert colors[0, :, 0, 0].tolist() == [51, 102, 153]
    with pytest.raises(ValueError, match="RandomRotation: expected padding_mode 'fill' with fill"):
        A.RandomRotation(30.0, padding_mode="border", fill=0.4)
    filled = A.RandomAffine(0.0, (0.5, 0.5), p=1.0, fill_value=0.4)(torch.ones_like(x), seed=2)
    assert filled.min().item() == pytest.approx(0.4)
    with pytest.raises(ValueError, match="RandomAffine: expected padding_mode 'fill' with fill_value"):
        A.RandomAffine(30.0, padding_mode="reflection", fill_value=0.4)


def test_rotations_expand_to_the_largest_of_a_batch(device: torch.device) -> None:
    x = images(device, 8)
    turn = A.RandomRotation((90.0, 90.0), p=1.0, expand=True)
    assert torch.equal(turn(x), x.rot90(1, (2, 3))) and turn(x[:0]).shape == (0, 3, 16, 20)
    torch.testing.assert_close(turn.inverse(turn(x)), x)
    rotate = A.RandomRotation(60.0, p=0.6, expand=True)
    y = rotate(x, seed=5)
    chosen = rotate._params["batch_prob"] > 0.5
    angles = torch.deg2rad(rotate._params["degrees"][chosen].double())
    cos, sin = angles.cos().abs(), angles.sin().abs()
    height, width = (16 * cos + 20 * sin).ceil().max().int(), (16 * sin + 20 * cos).ceil().max().int()
    assert 0 < chosen.sum() < 8 and y.shape == (8, 3, height, width)
    top, left = (height - 16) // 2, (width - 20) // 2
    inside = torch.nn.functional.pad(x, (left, width - 20 - left, top, height - 16 - top))
    assert torch.equal(y[~chosen], inside[~chosen])  # whole pixels, in the middle
    # Nothing of an image is lost: its sum stays, up to interpolation.
    smooth = torch.nn.functional.avg_pool2d(x, 5, 1, 2, count_include_pad=False)
    torch.testing.assert_close(rotate(smooth, seed=5).sum((2, 3)), smooth.sum((2, 3)), rtol=0.03, atol=0)
    assert torch.equal(rotate(x, params=rotate._params), rotate(x, seed=5))


@pytest.mark.parametrize("resample", ["each", "once"])
def test_expanded_rotations_in_containers(resample: str, device: torch.device) -> None:
    x = torch.zeros(6, 1, 32, 40, device=device)
    x[:, :, 8:14, 20:32] = 1
    boxes = torch.tensor([[[20.0, 8.0, 32.0, 14.0]]], device=device).repeat(6, 1, 1)
    points = torch.tensor([[[25.5, 10.5]]], device=device).repeat(6, 1, 1)
    augment = A.AugmentationSequential(
        A.RandomHorizontalFlip(),
        A.RandomRotation(50.0, p=0.7, expand=True),
        A.RandomVerticalFlip(),
        A.CenterCrop(48),
        data_keys=["input", "mask", "bbox_xyxy", "keypoints"],
        resample=resample,
    )
    for seed in (4, None):
        y, mask, moved, at = augment(x, (x > 0).long(), boxes, points, seed=seed)
        assert y.shape == (6, 1, 48, 48) == mask.shape and ((y > 0.5) != (mask > 0)).float().mean() < 0.002
        for image, (left, top, right, bottom), (px, py) in zip(mask[:, 0], moved[:, 0].tolist(), at[:, 0].tolist()):
            rows, columns = image.nonzero().unbind(1)
            outline = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
            assert all(abs(float(a) - b) < 1.01 for a, b in zip(outline, (left, top, right, bottom)))
            assert abs(columns.double().mean() - px) < 0.5 and abs(rows.double().mean() - py) < 0.5
        again = augment(x, (x > 0).long(), boxes, points, params=augment._params)
        assert all(map(torch.equal, again, (y, mask, moved, at)))
        back = augment.inverse(y, mask, moved, at)
        assert back[0].shape == x.shape and (back[0] - x).abs().mean() < 0.01
        torch.testing.assert_close(back[3], points, rtol=0, atol=1e-3)


@pytest.mark.parametrize("same", ["alone", "container"])
@pytest.mark.parametrize("missing", ["contrast", "saturation", "hue", "all"])
def test_adjustments_that_change_nothing_leave_the_program(missing: str, same: str, device: torch.device) -> None:
    """With the same draws, clips and gradients; given parameters are all applied."""
    ranges = {"brightness": 0.4, "contrast": 0.4, "saturation": 0.4, "hue": 0.2}
    less = {name: 0.0 if missing in (name, "all") else value for name, value in ranges.items()}
    x = (1.4 * images(device) - 0.2).requires_grad_()
    jitter, full = A.ColorJitter(**less, p=0.8), A.ColorJitter(**ranges, p=0.8)
    call = jitter if same == "alone" else A.ImageSequential(A.RandomHorizontalFlip(p=1.0), jitter)
    source = x if same == "alone" else x.flip(-1)
    y = call(x, seed=3)
    expected = full(source, params=jitter._params)
    torch.testing.assert_close(y, expected)
    torch.testing.assert_close(*(torch.autograd.grad(z.square().sum(), x, retain_graph=True)[0] for z in (y, expected)))
    if missing in ("contrast", "all"):
        steps = jitter._plan(x, False).image_pass
        assert steps is not None and not steps.has_contrast
    if device.type == "cpu":  # where the host knows the parameters
        assert torch.equal(call(x, params=call._params), y)
    full(source, seed=4)
    torch.testing.assert_close(jitter(source, params=full._params), full(source, params=full._params))


@pytest.mark.parametrize(
    "make",
    [
        lambda r: A.Downscale(r),
        lambda r: A.RandomScale(r),
        lambda r: A.CoarseDropout((1, 2), r, (0.1, 0.2)),
        lambda r: A.CoarseDropout((1, 2), (0.1, 0.2), r),
        lambda r: A.RandomErasing(r),
        lambda r: A.RandomErasing((0.1, 0.2), r),
        lambda r: A.RandomResizedCrop((4, 4), r),
        lambda r: A.RandomResizedCrop((4, 4), (0.1, 0.2), r),
    ],
)
def test_ranges_whose_draws_are_rounded_refuse_to_be_learned(make: Callable[[object], object]) -> None:
    """Their gradients would be 0. What they are made of is taken."""
    values = torch.tensor([0.2, 0.8])
    for learned in (torch.nn.Parameter(values), values.clone().requires_grad_()):
        with pytest.raises(TypeError, match=r"requires a gradient, which it would not get; pass \w+\.detach\(\)"):
            make(learned)
    make(values)
    make(torch.nn.Parameter(values, requires_grad=False))
