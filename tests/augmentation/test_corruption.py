"""Noise, blurs and codecs against formulas of their own, and against SciPy and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import scipy.special
import torch
from scipy import stats

import kvision.augmentation as A
from kvision.augmentation.noise import poisson_quantile


def images(*shape: int, device: torch.device) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(1)).to(device)


def drawn(batch: int, **params: torch.Tensor | float) -> dict[str, torch.Tensor]:
    vectors = {name: torch.as_tensor(value).expand(batch) for name, value in params.items() if isinstance(value, float)}
    return {**params, **vectors, "batch_prob": torch.ones(batch)}  # type: ignore[dict-item]


def test_counts_are_quantiles_of_the_poisson_distribution(device: torch.device) -> None:
    u = images(20000, device=device)
    for rate in (0.0, 0.03, 0.7, 4.0, 60.0):
        counts = poisson_quantile(u, torch.full_like(u, rate)).cpu().numpy()
        expected = stats.poisson.ppf(u.cpu().numpy(), rate).clip(0)
        assert (counts != expected).mean() < 2e-4 and abs(counts - expected).max() <= 3


def test_shot_noise_counts_photons_of_linear_light(device: torch.device) -> None:
    x = images(2, 3, 16, 20, device=device)
    u = torch.rand(x.shape)
    y = A.ShotNoise(p=1.0)(x, params=drawn(2, scale=0.2, noise=u)).cpu()
    counts = stats.poisson.ppf(u.numpy(), x.cpu().numpy().astype(np.float64) ** 2.2 / 0.2)
    expected = torch.from_numpy((counts * 0.2).clip(0, 1) ** (1 / 2.2)).float()
    assert ((y - expected).abs() > 1e-5).float().mean() < 2e-3  # words beside a step


def test_factors_and_speckle() -> None:
    x, u = images(2, 3, 4, 5, device=torch.device("cpu")), torch.rand(2, 3, 4, 5)
    y = A.MultiplicativeNoise((0.5, 1.5), True, True, p=1.0)(x, params=drawn(2, factors=0.5 + u))
    torch.testing.assert_close(y, (x * (0.5 + u)).clamp(0, 1))
    y = A.SpeckleNoise(p=1.0)(x, params=drawn(2, std=0.4, factors=1 + 0.4 * (u - 0.5)))
    torch.testing.assert_close(y, (x + 0.4 * x * (u - 0.5)).clamp(0, 1))


def test_iso_noise_is_that_of_hue_and_lightness(device: torch.device) -> None:
    """By OpenCV's HLS, in degrees: a normal hue, and counts of the deviation of lightness."""
    x = images(1, 3, 24, 31, device=device)
    u, normal = torch.rand(1, 1, 24, 31), torch.randn(1, 1, 24, 31)
    noise = {"luminance_noise": u, "color_noise": normal}
    y = A.ISONoise(p=1.0)(x, params=drawn(1, color_shift=0.05, intensity=0.5, **noise)).cpu()
    hls = cv2.cvtColor(x[0].movedim(0, -1).cpu().numpy(), cv2.COLOR_RGB2HLS)
    counts = stats.poisson.ppf(u[0, 0].numpy(), hls[..., 1].std() * 0.5)
    hls[..., 0] = (hls[..., 0] + 360 * 0.05 * 0.5 * normal[0, 0].numpy()) % 360
    hls[..., 1] += counts * 0.5 * (1 - hls[..., 1])
    expected = torch.from_numpy(cv2.cvtColor(hls, cv2.COLOR_HLS2RGB)).movedim(-1, 0)
    assert ((y[0] - expected).abs() > 1e-3).float().mean() < 2e-3


@pytest.mark.parametrize("radius", [2, 5, 10])
def test_defocus_is_a_disk(radius: int, device: torch.device) -> None:
    """Of OpenCV's filter, with a disk whose edge OpenCV has blurred."""
    x = images(1, 2, 40, 33, device=device)
    at = np.arange(-max(8, radius), max(8, radius) + 1)
    disk = (at[:, None] ** 2 + at**2 <= radius**2).astype(np.float32)
    size = 3 if radius <= 8 else 5
    kernel = cv2.GaussianBlur(disk / disk.sum(), (size, size), 0.4)
    y = A.Defocus((1, 10), p=1.0)(x, params=drawn(1, radius=float(radius), alias_blur=0.4)).cpu()
    for plane, expected in zip(y[0], x[0].cpu().numpy()):
        np.testing.assert_allclose(plane.numpy(), cv2.filter2D(expected, -1, kernel), atol=2e-6)


def test_ringing_is_a_circular_low_pass(device: torch.device) -> None:
    x = images(2, 1, 20, 24, device=device).round()  # whose edges leave [0, 1]
    cutoff, sides = 1.1, torch.tensor([5.0, 9.0])
    y = A.RingingOvershoot((5, 9), p=1.0)(x, params=drawn(2, blur=sides, cutoff=cutoff)).cpu()
    for image, side, result in zip(x.cpu(), sides.int().tolist(), y):
        at = np.arange(side) - side // 2
        radius = np.hypot(at[:, None], at)
        radius[side // 2, side // 2] = 1
        kernel = cutoff * scipy.special.j1(cutoff * radius) / (2 * np.pi * radius)
        kernel[side // 2, side // 2] = cutoff**2 / (4 * np.pi)
        expected = cv2.filter2D(image[0].numpy(), -1, kernel / kernel.sum())
        np.testing.assert_allclose(result[0].numpy(), expected.clip(0, 1), atol=2e-5)


def test_zoom_blur_is_a_mean_of_enlargements(device: torch.device) -> None:
    x = images(1, 1, 11, 15, device=device)
    y = A.ZoomBlur((1.0, 1.5), p=1.0)(x, params=drawn(1, max_factor=1.25, step_factor=0.1)).cpu()
    image = x[0, 0].cpu().numpy()
    expected = 2 * image
    for factor in (1.1, 1.2):
        columns = ((np.arange(15) - 7) / factor + 7).astype(np.float32)
        rows = ((np.arange(11) - 5) / factor + 5).astype(np.float32)
        expected = expected + np.stack([np.interp(rows, np.arange(11), c) for c in _across(image, columns)], 1)
    np.testing.assert_allclose(y[0, 0].numpy(), expected / 4, atol=1e-5)


def _across(image: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(columns, np.arange(image.shape[1]), row) for row in image]).T


def test_glass_blur_reads_neighbors(device: torch.device) -> None:
    """Between two blurs, each pixel reads one that reads one, at most max_delta away, within the image."""
    x = images(1, 2, 9, 10, device=device)
    u = torch.rand(1, 4, 9, 10)
    y = A.GlassBlur(0.01, 3, 2, p=1.0)(x, params=drawn(1, offsets=u)).cpu()  # the blurs change nothing
    moves = (6 * u[0]).long() - 3
    for row in range(9):
        for column in range(10):
            r, c = row, column
            for i in (0, 2):
                down, right = moves[i : i + 2, r, c].tolist()
                r, c = min(max(r + down, 0), 8), min(max(c + right, 0), 9)
            torch.testing.assert_close(y[0, :, row, column], x[0, :, r, c].cpu())


def test_downscale_repeats_pixels_or_means(device: torch.device) -> None:
    x = images(2, 3, 12, 17, device=device)
    y = A.Downscale(p=1.0)(x, params=drawn(2, scale=torch.tensor([0.5, 0.3]))).cpu()
    for image, result, size in zip(x.cpu(), y, ((8, 6), (5, 4))):
        pixels = image.movedim(0, -1).numpy()
        small = cv2.resize(pixels, size, interpolation=cv2.INTER_NEAREST)
        expected = cv2.resize(small, (17, 12), interpolation=cv2.INTER_NEAREST)
        np.testing.assert_array_equal(result.movedim(0, -1).numpy(), expected)
    y = A.Downscale(antialias=True, p=1.0)(x[..., :16], params=drawn(2, scale=0.25)).cpu()
    means = x[..., :16].cpu().unflatten(3, (4, 4)).unflatten(2, (3, 4)).mean((3, 5))
    torch.testing.assert_close(y, means.repeat_interleave(4, 2).repeat_interleave(4, 3))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: A.ShotNoise((0.0, 0.1)), "ShotNoise: expected scale"),
        (lambda: A.Defocus((0, 3)), "Defocus: expected radius_range"),
        (lambda: A.RingingOvershoot((4, 8)), "RingingOvershoot: expected blur_range"),
        (lambda: A.ZoomBlur((1.0, 9.0)), "ZoomBlur: expected at most 256 factors, got 800"),
        (lambda: A.GlassBlur(max_delta=0), "GlassBlur: expected max_delta"),
        (lambda: A.Defocus(p=1.0)(torch.zeros(1, 1, 4, 4)), "Defocus: .*; lower radius_range for images this small"),
        (lambda: A.RingingOvershoot(p=1.0)(torch.zeros(1, 1, 4, 4)), "RingingOvershoot: .*; lower blur_range for"),
        (lambda: A.GlassBlur(p=1.0)(torch.zeros(1, 1, 2, 2)), "GlassBlur: .*; lower sigma for"),
        (lambda: A.CommonCorruption("defocus_blur", 1, p=1.0)(torch.zeros(1, 1, 2, 2)), "CommonCorruption: .*; choose"),
        (lambda: A.Downscale((0.5, 2.0)), "Downscale: expected scale"),
        (lambda: A.ISONoise(p=1.0)(torch.zeros(1, 1, 4, 4)), "ISONoise: expected images with 3 channels"),
    ],
)
def test_wrong_arguments(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]
