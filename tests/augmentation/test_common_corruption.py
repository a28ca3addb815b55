"""The corruptions of ImageNet-C against numbers of imagecorruptions 1.1.2, and weather against formulas of its own."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest
import torch
from scipy import ndimage

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import CORRUPTION, DISTORTION, OCCLUSION
from kvision.augmentation.corruption.common import CORRUPTIONS

# What imagecorruptions makes of three pixels of `picture`, in levels.
PIXELS = ((5, 9), (31, 42), (60, 70))
VALUES = {
    ("defocus_blur", 3): [[32.0, 182.4, 137.4], [157.0, 109.6, 122.2], [30.5, 81.4, 147.5]],
    ("defocus_blur", 5): [[33.2, 159.1, 121.0], [158.7, 119.2, 129.5], [77.9, 109.2, 117.3]],
    ("brightness", 2): [[37.1, 233.0, 255.0], [208.0, 137.8, 39.7], [16.2, 71.9, 255.0]],
    ("contrast", 3): [[112.0, 142.7, 144.0], [137.0, 123.3, 106.0], [108.4, 114.9, 144.0]],
    ("saturate", 1): [[163.6, 214.3, 220.0], [157.0, 141.1, 118.9], [158.2, 172.6, 220.0]],
    ("saturate", 4): [[0.0, 197.8, 220.0], [157.0, 91.5, 0.0], [0.0, 51.3, 220.0]],
    ("gaussian_blur", 2): [[32.0, 192.7, 166.5], [157.0, 106.3, 110.1], [16.7, 70.0, 176.1]],
    ("pixelate", 1): [[32.0, 197.0, 220.0], [157.0, 98.0, 30.0], [16.0, 68.0, 220.0]],
    ("pixelate", 4): [[29.0, 205.0, 157.0], [155.0, 108.0, 125.0], [16.0, 81.0, 157.0]],
}
# Its mean change of `picture` in severity 3, in levels, and how far ours may be off: it draws by other generators, rounds down,
# swaps pixels in glass_blur and enlarges whole pixels in zoom_blur.
CHANGES = {
    "gaussian_noise": (32.67, 0.02),
    "shot_noise": (35.08, 0.02),
    "impulse_noise": (11.38, 0.05),
    "glass_blur": (36.35, 0.12),
    "motion_blur": (43.83, 0.15),
    "zoom_blur": (26.16, 0.1),
    "snow": (67.98, 0.05),
    "fog": (52.97, 0.2),
    "elastic_transform": (22.95, 0.05),
    "jpeg_compression": (21.26, 0.1),
    "speckle_noise": (30.64, 0.02),
    "spatter": (7.81, 0.1),
}


def picture(device: torch.device) -> torch.Tensor:
    y, x = np.mgrid[:64, :80]
    green = np.sin(x / 5) * np.cos(y / 7) * 100 + 128
    channels = [(3 * x + y) % 256, green, np.where((x // 8 + y // 8) % 2, 220, 30)]
    return torch.from_numpy(np.stack(channels).astype(np.uint8))[None].to(device)


def test_fixed_corruptions_have_their_values(device: torch.device) -> None:
    image = picture(device)
    for (name, severity), expected in VALUES.items():
        y = 255 * A.CommonCorruption(name, severity)(image.float() / 255).cpu()
        values = torch.stack([y[0, :, row, column] for row, column in PIXELS])
        assert (values - torch.tensor(expected)).abs().max() <= 1, (name, severity, values)


def test_drawn_corruptions_change_as_much(device: torch.device) -> None:
    assert {*CHANGES, *(name for name, _ in VALUES), "frost"} == set(CORRUPTIONS)
    images = picture(device).expand(6, -1, -1, -1)
    for name, (expected, tolerance) in CHANGES.items():
        y = A.CommonCorruption(name, 3)(images, seed=torch.arange(6))
        change = (y.float() - images).abs().mean().item()
        assert abs(change - expected) <= tolerance * expected, (name, change)
        assert torch.equal(A.CommonCorruption(name, 3)(images[4:5], seed=torch.tensor([4])), y[4:5]), name


def test_other_channels_and_severities(device: torch.device) -> None:
    x = torch.rand(2, 1, 48, 40, device=device)
    for name in CORRUPTIONS:
        options = {"texture": torch.rand(2, 3, 50, 60)} if name == "frost" else {}
        if name == "jpeg_compression":
            continue
        for severity in (1, 5):
            y = A.CommonCorruption(name, severity, **options)(x)
            assert y.shape == x.shape and y.min() >= 0 and y.max() <= 1, name


def test_bytes_are_floats_rounded_once(device: torch.device) -> None:
    x = (255 * torch.rand(4, 3, 48, 40, generator=torch.Generator().manual_seed(1))).to(torch.uint8).to(device)
    names = ("brightness", "contrast", "elastic_transform", "jpeg_compression", "saturate", "gaussian_blur", "pixelate")
    for augment in (
        *(A.CommonCorruption(name, severity, p=p) for name in names for severity in (1, 4, 5) for p in (1.0, 0.5)),
        A.RandomRain((20, 40), (3, 10), (-3, 3), p=1.0),
        A.RandomSnow(p=1.0),
        A.RandomPlasmaBrightness(p=0.5),
    ):
        y, exact = augment(x, seed=3), 255 * augment(x.float() / 255, seed=3)
        assert y.dtype == torch.uint8 and (y - exact).abs().max() <= 0.52, augment  # weights of bytes may be in 256ths


def test_frost_is_a_window_of_the_texture(device: torch.device) -> None:
    textures, x = torch.rand(2, 3, 9, 12), torch.rand(3, 3, 7, 8, device=device)
    drawn = {"texture": [0.2, 0.9, 0.4], "top": [0.0, 0.99, 0.4], "left": [0.5, 0.0, 0.99]}
    params = {name: torch.tensor(values) for name, values in drawn.items()}
    params |= {"image_weight": torch.full((3,), 0.7), "frost_weight": torch.full((3,), 0.2)}
    y = A.RandomFrost(textures, p=1.0)(x, params={**params, "batch_prob": torch.ones(3)}).cpu()
    for i, (texture, top, left) in enumerate(((0, 0, 2), (1, 2, 0), (0, 1, 4))):
        window = textures[texture, :, top : top + 7, left : left + 8]
        torch.testing.assert_close(y[i], 0.7 * x[i].cpu() + 0.2 * window)
    both = {**params, "texture": torch.zeros(3), "batch_prob": torch.ones(3)}
    of_one, of_two = (A.RandomFrost(each, p=1.0)(x, params=both) for each in (textures[:1], textures))
    torch.testing.assert_close(of_one, of_two)
    with pytest.raises(ValueError, match="RandomFrost: expected texture of at least 10 x 8 pixels, got 9 x 12"):
        A.RandomFrost(textures, p=1.0)(torch.rand(1, 3, 10, 8))


def test_mud_is_smooth_noise_above_a_threshold(device: torch.device) -> None:
    x, noise = torch.rand(1, 3, 20, 24, device=device), torch.randn(1, 1, 20, 24)
    numbers = {"mean": 0.65, "std": 0.5, "gauss_sigma": 1.5, "cutout_threshold": 0.68, "intensity": 0.6}
    params = {name: torch.tensor([value]) for name, value in numbers.items()}
    color = (0.3, 0.2, 0.1)
    augment = A.Spatter(gauss_sigma_range=(1, 2), intensity_range=(0.5, 1.0), mode="mud", color=color, p=1.0)
    y = augment(x, params={**params, "noise": noise, "batch_prob": torch.ones(1)}).cpu()
    layer = ndimage.gaussian_filter(0.65 + 0.5 * noise[0, 0].double().numpy(), 1.5, mode="nearest", radius=8)
    stains = ndimage.gaussian_filter((layer > 0.68).astype(float), 0.6, mode="nearest", radius=4)
    stains[stains < 0.8] = 0
    expected = x[0].cpu().numpy() * (1 - stains) + np.array(color)[:, None, None] * stains
    assert 0.1 < (stains > 0).mean() < 0.9
    np.testing.assert_allclose(y[0].numpy(), expected, atol=1e-4)


def test_rain_is_a_relief_of_the_distance_from_outlines(device: torch.device) -> None:
    """By OpenCV and SciPy, but for the outlines: those of the drops themselves, where the peers take Canny's."""
    x, noise = 0.4 * torch.rand(1, 3, 48, 56, device=device), torch.randn(1, 1, 48, 56)
    numbers = {"mean": 0.65, "std": 0.5, "gauss_sigma": 2.0, "cutout_threshold": 0.68, "intensity": 0.6}
    params = {name: torch.tensor([value]) for name, value in numbers.items()}
    y = A.Spatter(gauss_sigma_range=(1, 2), p=1.0)(x, params={**params, "noise": noise, "batch_prob": torch.ones(1)})
    layer = ndimage.gaussian_filter(0.65 + 0.5 * noise[0, 0].double().numpy(), 2.0, mode="nearest", radius=8)
    levels = np.floor(np.where(layer < 0.68, 0, layer).clip(0, 1) * 255).astype(np.uint8)
    cross = ndimage.generate_binary_structure(2, 1)
    outline = (levels > 0) & ~ndimage.binary_erosion(levels > 0, cross, border_value=1)
    distance = cv2.blur(np.minimum(ndimage.distance_transform_edt(~outline), 20).astype(np.float32), (3, 3))
    spread = cv2.equalizeHist(np.floor(distance).astype(np.uint8))
    light = np.array([[-2, -1, 0], [-1, 1, 1], [0, 1, 2]], np.float32)
    relief = cv2.blur(cv2.filter2D(spread, cv2.CV_8U, light).astype(np.float32), (3, 3)).round() * levels
    drops = 0.6 * relief / relief.max()
    expected = x[0].cpu().numpy() + np.array([175, 238, 238])[:, None, None] / 255 * drops
    assert 0.1 < (drops > 0).mean() < 0.9
    different = np.abs(y[0].cpu().numpy() - expected.clip(0, 1)) > 2e-3
    assert different.mean() < 2e-2  # means beside a whole number


def test_fog_keeps_the_brightest_value() -> None:
    x, plasma = torch.rand(2, 3, 8, 9), torch.rand(2, 1, 8, 9)
    params = {"plasma": plasma, "intensity": torch.tensor([2.0, 1.5]), "batch_prob": torch.ones(2)}
    y = A.RandomFog(p=1.0)(x, params=params)
    for image, clouds, amount, result in zip(x, plasma, (2.0, 1.5), y):
        stretched = (clouds - clouds.min()) / (clouds.max() - clouds.min())
        torch.testing.assert_close(result, (image + amount * stretched) * image.max() / (image.max() + amount))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: A.CommonCorruption("mist"), "CommonCorruption: .*name"),
        (lambda: A.CommonCorruption("fog", 6), "CommonCorruption: expected severity to be 1, 2, 3, 4 or 5, got 6"),
        (lambda: A.CommonCorruption("frost"), "CommonCorruption: expected texture for 'frost'"),
        (lambda: A.RandomFrost(torch.ones(2, 8, 8)), "RandomFrost: expected texture of shape"),
        (lambda: A.RandomFog((-1.0, 2.0)), "RandomFog: expected intensity"),
        (lambda: A.Spatter(mode="snow"), "Spatter: mode must be one of rain, mud"),
        (lambda: A.Spatter(gauss_sigma_range=(0.0, 1.0)), "Spatter: expected gauss_sigma"),
    ],
)
def test_wrong_arguments(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]


FRAMES = [
    case for case in (*CORRUPTION, *OCCLUSION, *DISTORTION) if case.name not in ("CommonCorruption", "MaskDropout")
]


@pytest.mark.parametrize("same", [True, False])
def test_frames_of_a_video(same: bool, device: torch.device) -> None:
    """Equal frames stay equal where all get the same parameters and noise, also those of bytes; else they differ."""
    x = torch.rand(2, 1, 3, 30, 40, generator=torch.Generator().manual_seed(3)).expand(2, 3, 3, 30, 40).to(device)
    makes = {case.name: case.make for case in FRAMES}
    makes |= {
        name: functools.partial(A.CommonCorruption, name, 3, torch.rand(3, 60, 60) if name == "frost" else None)
        for name in CORRUPTIONS
    }
    found = []
    for name, make in makes.items():
        for videos in (x, (255 * x).to(torch.uint8)):
            augment = A.VideoSequential(make(p=1.0), same_on_frame=same)
            y = augment(videos, seed=1)
            are_equal = torch.equal(y, y[:, :1].expand_as(y))
            if are_equal is not same and (
                same or augment._params[0].data.keys() - {"batch_prob", "forward_input_shape"}
            ):
                found.append(f"{name} {videos.dtype}")
            if not torch.equal(augment(videos, params=augment._params), y):
                found.append(f"{name} {videos.dtype} replayed")
    assert not found


def test_autocast_changes_nothing(device: torch.device) -> None:
    x = torch.rand(2, 3, 24, 28, device=device)
    for augment in (
        A.Defocus(p=1.0),
        A.Downscale(antialias=True, p=1.0),
        A.CommonCorruption("pixelate", 4),
        A.Spatter(p=1.0),
    ):
        expected = augment(x, seed=1)
        with torch.autocast(device.type, torch.bfloat16):
            assert torch.equal(augment(x, seed=1), expected)
