"""Random weather and fractal maps: what they change, and that all of it follows from the parameters."""

from __future__ import annotations

import pytest
import torch

import kvision.augmentation as A


def test_drops_are_lines_of_their_size(device: torch.device) -> None:
    for width in (-5, -1, 0, 1, 4):
        rain = A.RandomRain((1, 1), (6, 6), (width, width), p=1.0)
        y = rain(torch.zeros(16, 3, 20, 24, device=device), seed=2)
        for image in y[:, 0]:
            rows, columns = image.nonzero().unbind(1)
            assert len(rows) == 6 and rows.max() - rows.min() == 5  # rows.unique() are all of them
            assert columns.max() - columns.min() == max(abs(width) - 1, 0)
            lean = (columns[-1] - columns[0]).sign()  # from the highest to the lowest
            assert lean == (0 if abs(width) < 2 else width // abs(width))
        assert torch.equal(y.unique(), torch.tensor([0, 200 / 255], device=device))


def test_rain_is_everywhere() -> None:
    wet = A.RandomRain((200, 200), (3, 3), (-3, 3), p=1.0)(torch.zeros(64, 1, 12, 12), seed=3).amax(0)[0] > 0
    assert wet.all()


def test_drops_must_be_smaller_than_the_image() -> None:
    with pytest.raises(ValueError, match="RandomRain: expected images larger than drops"):
        A.RandomRain(p=1.0)(torch.zeros(1, 3, 20, 64))


def test_snow_lightens_dark_pixels_alone() -> None:
    x = torch.rand(4, 3, 16, 16)
    y = A.RandomSnow((0.4, 0.4), (1.5, 1.5))(x)
    lightness = (x.amax(1) + x.amin(1)) / 2
    dark = lightness < 0.4
    after = (y.amax(1) + y.amin(1)) / 2
    torch.testing.assert_close(after[dark], 1.5 * lightness[dark], rtol=1e-4, atol=1e-5)
    kept = ~dark[:, None].expand_as(x)
    torch.testing.assert_close(y[kept], x[kept], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["RandomPlasmaBrightness", "RandomPlasmaContrast", "RandomPlasmaShadow"])
def test_maps_are_fractal_noise(name: str) -> None:
    augment = getattr(A, name)(p=1.0)
    augment(torch.rand(4, 3, 33, 40), seed=1)
    plasma = augment._params["plasma"]
    assert plasma.shape == (4, 1 if name.endswith("Shadow") else 3, 33, 40)
    assert plasma.min() >= 0 and plasma.max() <= 1 and plasma.std() > 0.05
    steps = (plasma[..., 1:] - plasma[..., :-1]).abs().mean()
    distant = (plasma - plasma.flip(-1)).abs().mean()
    assert steps < distant  # neighbors resemble each other
    assert not torch.equal(plasma[0], plasma[1])


def test_shadow_is_one_for_all_channels() -> None:
    shadow = A.RandomPlasmaShadow(shade_intensity=(-0.5, -0.5), shade_quantity=(0.5, 0.5), p=1.0)
    y = shadow(torch.ones(4, 3, 32, 32), seed=5)
    assert torch.equal(y, y[:, :1].expand_as(y))
    assert y.unique().tolist() == [0.5, 1.0]
    assert torch.equal(y[:, :1] == 0.5, shadow._params["plasma"] < 0.5)


@pytest.mark.parametrize(
    ("name", "kwargs", "message"),
    [
        ("RandomRain", {"number_of_drops": (5, 2)}, "number_of_drops"),
        ("RandomRain", {"drop_height": (0, 2)}, "drop_height"),
        ("RandomRain", {"drop_width": (0.5, 2)}, "drop_width"),
        ("RandomSnow", {"snow_coefficient": (0.5, 2.0)}, "snow_coefficient"),
        ("RandomSnow", {"brightness": (0.5, 2.0)}, "brightness"),
        ("RandomPlasmaShadow", {"roughness": (0.5, 2.0)}, "roughness"),
    ],
)
def test_wrong_ranges(name: str, kwargs: dict[str, object], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"{name}: expected {message}"):
        getattr(A, name)(**kwargs)
