"""Crops that are resized with antialiasing."""

from __future__ import annotations

from typing import Any

import pytest
import torch

import kvision as K
import kvision.augmentation as A


@pytest.mark.parametrize("mode", ["bilinear", "bicubic"])
@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("size", [(12, 15), (45, 20), (1, 7)], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8], ids=str)
def test_antialiased_crops(
    mode: str, align_corners: bool, size: tuple[int, int], dtype: torch.dtype, device: torch.device
) -> None:
    """They are antialiased resizing of each window."""
    x = torch.rand(4, 3, 40, 50, generator=torch.Generator().manual_seed(1)).to(device)
    x = (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    crop = A.RandomResizedCrop(size, resample=mode, align_corners=align_corners, antialias=True)
    y = crop(x, seed=4)
    for image, result, corners in zip(x, y, crop._params["src"].long()):
        (left, top), (right, bottom) = corners[0].tolist(), corners[2].tolist()
        window = image[None, :, top : bottom + 1, left : right + 1]
        expected = K.geometry.resize(window, size, mode, align_corners=align_corners, antialias=True)[0]
        torch.testing.assert_close(result, expected, rtol=0, atol=1 if dtype == torch.uint8 else 1e-5)
    assert torch.equal(crop(x, params=crop._params), y)
    matrix = crop.transform_matrix
    assert torch.equal(crop.apply_transform(x, crop._params, crop.flags, matrix), y)
    nearest = A.RandomResizedCrop(size, resample="nearest", align_corners=align_corners)(x, seed=4)
    assert torch.equal(crop(x, seed=4, resample="nearest"), nearest)


@pytest.mark.parametrize("resample", ["each", "once"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8], ids=str)
def test_flips_around_antialiased_crops(dtype: torch.dtype, resample: str, device: torch.device) -> None:
    """Flips mirror the windows; the result is that of the separate calls, and so is its gradient."""
    x = torch.rand(9, 3, 40, 52, generator=torch.Generator().manual_seed(2)).to(device)
    x = (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    x.requires_grad_(x.is_floating_point())
    children = [
        A.RandomHorizontalFlip(),
        A.RandomVerticalFlip(),
        A.RandomResizedCrop((24, 31), antialias=True, align_corners=False),
        A.RandomVerticalFlip(),
        A.RandomHorizontalFlip(),
    ]
    augment = A.ImageSequential(*children, resample=resample)
    torch.manual_seed(5)
    y = augment(x)
    torch.manual_seed(5)
    expected = x
    for child in children:
        expected = child(expected)
    torch.testing.assert_close(y, expected, rtol=0, atol=1 if dtype == torch.uint8 else 1e-5)
    if x.requires_grad:
        weights = torch.rand(y.shape, generator=torch.Generator().manual_seed(3)).to(y)
        (grad,) = torch.autograd.grad((y * weights).sum(), x)
        (expected_grad,) = torch.autograd.grad((expected * weights).sum(), x)
        torch.testing.assert_close(grad, expected_grad, rtol=0, atol=1e-5)


@pytest.mark.parametrize("resample", ["each", "once"])
def test_what_is_no_flip_is_not_joined(resample: str, device: torch.device) -> None:
    """A crop of an antialiased crop reads pixels beside its own window."""
    x = torch.rand(4, 3, 40, 52, device=device)
    children = [A.RandomResizedCrop((20, 20), antialias=True), A.CenterCrop((8, 10)), A.RandomInvert(p=1.0)]
    y = A.ImageSequential(*children, resample=resample)(x, seed=7)
    torch.testing.assert_close(y, 1 - children[0](x, seed=7)[:, :, 6:14, 5:15], rtol=0, atol=1e-6)


def test_pipeline_of_an_antialiased_crop(device: torch.device) -> None:
    """One pass crops, flips, colors, normalizes and converts; its gradient is that of the separate calls."""

    def pipeline(**options: Any) -> A.ImageSequential:
        return A.ImageSequential(
            A.RandomResizedCrop((24, 32), antialias=True),
            A.RandomHorizontalFlip(),
            A.ColorJitter(0.2, 0.2, 0.2, 0.1),
            A.Normalize((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
            **options,
        )

    x = torch.rand(7, 3, 40, 52, generator=torch.Generator().manual_seed(2)).to(device).requires_grad_()
    augment = pipeline()
    for y in (augment(x, seed=3), augment(x.detach(), seed=3)):
        expected = x
        for child in augment.children():
            expected = child(expected, params=child._params)
        torch.testing.assert_close(y, expected, rtol=0, atol=2e-5)
    weights = torch.rand(expected.shape, generator=torch.Generator().manual_seed(3)).to(device)
    for layout in (torch.contiguous_format, torch.channels_last):
        (grad,) = torch.autograd.grad((augment(x, seed=3)), x, weights.contiguous(memory_format=layout))
        (expected_grad,) = torch.autograd.grad(expected, x, weights, retain_graph=True)
        torch.testing.assert_close(grad, expected_grad, rtol=1e-4, atol=1e-4)
    stored = (255 * x.detach()).to(torch.uint8)
    options: dict[str, Any] = {"output_dtype": torch.float16, "memory_format": torch.channels_last}
    half = pipeline(**options)(stored, seed=3)
    assert half.dtype == torch.float16 and half.is_contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(half, pipeline(output_dtype=torch.float32)(stored, seed=3).half(), rtol=0, atol=4e-3)


def test_labels_of_antialiased_crops(device: torch.device) -> None:
    """Masks, points and the inverse follow the matrix of crops without antialiasing."""
    x = torch.rand(3, 1, 40, 50, device=device)
    points = 40 * torch.rand(3, 5, 2, device=device)
    smooth, sharp = (
        A.AugmentationSequential(
            A.RandomHorizontalFlip(),
            A.RandomResizedCrop((12, 15), antialias=a),
            data_keys=["image", "mask", "keypoints"],
        )
        for a in (True, False)
    )
    a, b = smooth(x, x > 0.5, points, seed=3), sharp(x, x > 0.5, points, seed=3)
    assert not torch.equal(a[0], b[0]) and a[0].std() < b[0].std()
    assert (a[1] != b[1]).float().mean() < 0.05  # rounded once or twice
    torch.testing.assert_close(a[2], b[2])
    torch.testing.assert_close(smooth.transform_matrix, sharp.transform_matrix)
    assert smooth.inverse(*a)[0].shape == x.shape
    x.requires_grad_()
    smooth(x, x.detach() > 0.5, points, seed=3)[0].square().sum().backward()
    assert x.grad is not None and (x.grad != 0).float().mean() > 0.1
    with pytest.raises(ValueError, match="'bilinear' or 'bicubic' with antialias"):
        A.RandomResizedCrop((4, 4), resample="nearest", antialias=True)


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("resample", ["nearest", "bilinear", "bicubic"])
def test_resize_module_equals_the_function(resample: str, align_corners: bool) -> None:
    x = torch.rand(2, 3, 17, 13)
    augment = A.Resize((9, 11), resample=resample, align_corners=align_corners)
    y = augment(x)
    torch.testing.assert_close(augment.apply_transform(x, augment._params, augment.flags, augment.transform_matrix), y)


def test_wrong_sizes_and_modes_of_resize() -> None:
    with pytest.raises(ValueError, match="Resize: expected size of at least one pixel, got 0"):
        A.Resize(0)
    with pytest.raises(ValueError, match="Resize: expected resample 'bilinear' or 'bicubic' with antialias"):
        A.Resize(8, resample="nearest", antialias=True)
