"""Images as text."""

from __future__ import annotations

import re

import kornia
import pytest
import torch

import kvision as K
from kvision.core.exceptions import ImageError, TypeCheckError, ValueCheckError


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, torch.float64, torch.int64])
def test_agrees_with_kornia(channels, dtype, device):
    levels = torch.randint(0, 256, (channels, 64, 64))
    image = levels.to(dtype) / 255 if dtype.is_floating_point else levels.to(dtype)
    assert K.image.image_to_string(image.to(device)) == kornia.image.image_to_string(image)


def test_every_gray_agrees_with_kornia():
    image = torch.arange(256, dtype=torch.uint8).reshape(1, 16, 16)
    assert K.image.image_to_string(image) == kornia.image.image_to_string(image)


def test_codes_are_the_nearest_of_the_palette():
    """Against all 240 colors, written out."""
    cube = [
        (r, g, b)
        for r in (0, 95, 135, 175, 215, 255)
        for g in (0, 95, 135, 175, 215, 255)
        for b in (0, 95, 135, 175, 215, 255)
    ]
    palette = torch.tensor(cube + [(8 + 10 * k,) * 3 for k in range(24)])
    image = torch.randint(0, 256, (3, 40, 40))
    codes = [int(code) for code in re.findall(r"48;5;(\d+)m", K.image.image_to_string(image))]
    distance = (image.flatten(1).T[:, None] - palette).square().sum(-1)
    assert codes == (16 + distance.argmin(1)).tolist()  # of equally near ones, argmin takes the first, too


def test_wide_images_are_reduced():
    image = torch.zeros(3, 10, 100)
    image[:, :, 50:] = 1
    lines = K.image.image_to_string(image, max_width=20).splitlines()
    assert lines == ["\033[48;5;16m  " * 10 + "\033[48;5;231m  " * 10 + "\033[0m"] * 2
    assert len(K.image.image_to_string(torch.zeros(1, 1, 100), 10).splitlines()) == 1


def test_print_image(capsys, tmp_path):
    image = torch.randint(0, 256, (3, 4, 6), dtype=torch.uint8)
    K.io.write_image(tmp_path / "picture.png", image)
    for source in (image, tmp_path / "picture.png", str(tmp_path / "picture.png")):
        K.image.print_image(source)
        assert capsys.readouterr().out == K.image.image_to_string(image)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: K.image.image_to_string("x"), TypeCheckError, "image_to_string: expected image to be a Tensor"),
        (lambda: K.image.image_to_string(torch.zeros(4, 4)), ImageError, r"\(3, H, W\) or \(1, H, W\), got \(4, 4\)"),
        (lambda: K.image.image_to_string(torch.zeros(2, 4, 4)), ImageError, r"got \(2, 4, 4\)"),
        (lambda: K.image.image_to_string(torch.zeros(1, 3, 4, 4)), ImageError, r"got \(1, 3, 4, 4\)"),
        (lambda: K.image.image_to_string(torch.zeros(3, 0, 4)), ImageError, r"got \(3, 0, 4\)"),
        (lambda: K.image.image_to_string(torch.ones(1, 2, 2) * 2), ValueCheckError, r"in \[0, 1\], got values from 2"),
        (lambda: K.image.image_to_string(torch.full((1, 2, 2), -1)), ValueCheckError, r"in \[0, 255\], got .* from -1"),
        (lambda: K.image.image_to_string(torch.full((1, 2, 2), torch.nan)), ValueCheckError, "from nan to nan"),
        (lambda: K.image.image_to_string(torch.zeros(1, 2, 2), 0), ValueCheckError, "max_width"),
        (
            lambda: K.image.print_image(3),
            TypeCheckError,
            "print_image: expected image to be a Tensor or a path, got int",
        ),
        (lambda: K.image.print_image("/none/such.png"), FileNotFoundError, "/none/such.png"),
    ],
)
def test_errors(call, error, text):
    with pytest.raises(error, match=text):
        call()
