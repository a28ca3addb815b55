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
    mode: str, align_corners: bool, size: tuple[int, int], dtype: torch.dtype, device: torch.device, monkeypatch: Any
) -> None:
    """As antialiased resizing of each window; by matrices, as CUDA and compiled calls have it, and window by window."""
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
    monkeypatch.setattr("kvision.augmentation.crop.is_compiling", lambda: True)
    torch.testing.assert_close(crop(x, seed=4), y, rtol=0, atol=1 if dtype == torch.uint8 else 1e-5)


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
