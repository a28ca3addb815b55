"""The Image record."""

from __future__ import annotations

import kornia
import numpy as np
import pytest
import torch

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.image import ChannelsOrder, ColorSpace, Image, ImageLayout, ImageSize, PixelFormat

FIRST, LAST = ChannelsOrder.CHANNELS_FIRST, ChannelsOrder.CHANNELS_LAST


def make(space=ColorSpace.RGB, order=LAST, dtype=np.uint8):
    channels = 1 if space is ColorSpace.GRAY else 3
    shape = (4, 5, channels) if order is LAST else (channels, 4, 5)
    return Image.from_numpy((np.random.default_rng(0).random(shape) * 255).astype(dtype), space, order)


def test_properties(device):
    layout = ImageLayout(ImageSize(4, 5), 2, FIRST)
    data = torch.rand(2, 4, 5, device=device)
    image = Image(data, PixelFormat(ColorSpace.UNKNOWN, 32), layout)
    assert image.data is data and image.layout is layout and image.pixel_format.bit_depth == 32
    assert (image.shape, image.dtype, image.device.type) == ((2, 4, 5), torch.float32, device.type)
    assert (image.channels, image.height, image.width, image.channels_order) == (2, 4, 5, FIRST)
    assert image.image_size == ImageSize(4, 5)
    assert repr(image).startswith("Image(data=tensor(") and "ImageSize(height=4, width=5)" in repr(image)


@pytest.mark.parametrize("order", [FIRST, LAST])
@pytest.mark.parametrize("source", [ColorSpace.GRAY, ColorSpace.RGB, ColorSpace.BGR])
@pytest.mark.parametrize("target", ["gray", "rgb", "bgr"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_conversions_agree_with_kornia(order, source, target, dtype):
    image = make(source, order, dtype)
    peer = kornia.image.Image.from_numpy(
        image.to_numpy(), kornia.image.ColorSpace[source.name], kornia.image.ChannelsOrder[order.name]
    )
    got, want = getattr(image, f"to_{target}")(), getattr(peer, f"to_{target}")()
    torch.testing.assert_close(got.data, want.data)
    assert got.pixel_format.color_space.name == target.upper() and got.channels_order is order
    assert got.image_size == image.image_size


def test_to_and_clone():
    image = make()
    assert image.float().pixel_format == PixelFormat(ColorSpace.RGB, 32) and image.dtype == torch.uint8
    assert image.to(torch.float64).pixel_format.bit_depth == 64
    assert image.to("cpu", torch.float16).dtype == torch.float16
    copy = image.clone()
    copy.data.zero_()
    assert image.data.any()


def test_memory_is_shared_with_numpy_and_dlpack():
    array = np.zeros((4, 5, 3), np.float32)
    image = Image.from_numpy(array)
    array[0, 0, 0] = 7
    assert image.to_numpy()[0, 0, 0] == 7
    back = Image.from_dlpack(image.to_dlpack(), ColorSpace.BGR, LAST)
    array[0, 0, 1] = 8
    assert back.data[0, 0, 1] == 8 and back.pixel_format.color_space is ColorSpace.BGR
    assert Image.from_dlpack(np.zeros((3, 4, 5))).height == 4


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_color_space_by_number_of_channels(channels):
    expected = {1: ColorSpace.GRAY, 3: ColorSpace.RGB}.get(channels, ColorSpace.UNKNOWN)
    assert Image.from_numpy(np.zeros((4, 5, channels))).pixel_format.color_space is expected
    assert Image.from_numpy(np.zeros((4, 5))).channels == 1
    assert Image.from_numpy(np.zeros((4, 5)), channels_order=FIRST).shape == (1, 4, 5)


def test_files_and_terminal(tmp_path, capsys):
    for space, order in [(ColorSpace.RGB, LAST), (ColorSpace.BGR, FIRST), (ColorSpace.BGR, LAST)]:
        image = make(space, order)
        image.write(tmp_path / "picture.png")
        read = Image.from_file(tmp_path / "picture.png")
        assert read.channels_order is FIRST and read.pixel_format == PixelFormat(ColorSpace.RGB, 8)
        rgb = image.to_rgb().data
        assert torch.equal(read.data, rgb if order is FIRST else rgb.movedim(-1, 0))
        image.print()
        assert capsys.readouterr().out == K.image.image_to_string(read.data)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: Image.from_numpy([1]), TypeCheckError, "Image.from_numpy: expected data to be a numpy.ndarray"),
        (lambda: Image.from_numpy(np.zeros(3)), ShapeError, r"data of three axes, got \(3,\)"),
        (lambda: Image.from_numpy(np.zeros((1, 3, 4, 5))), ShapeError, r"got \(1, 3, 4, 5\)"),
        (
            lambda: Image.from_numpy(np.zeros((4, 5, 3)), ColorSpace.GRAY),
            ValueCheckError,
            "channels of 1 for GRAY, got 3",
        ),
        (
            lambda: Image.from_numpy(np.zeros((4, 5, 3)), None, "last"),
            TypeCheckError,
            "to be a ChannelsOrder, got 'last'",
        ),
        (lambda: Image.from_numpy(np.zeros((4, 5, 2))).to_rgb(), ValueCheckError, "to convert to RGB, got UNKNOWN"),
        (lambda: make(dtype=np.uint16).to_gray(), TypeCheckError, "uint8 or floating point, got torch.uint16"),
        (
            lambda: Image(torch.zeros(3, 4, 5), PixelFormat(ColorSpace.RGB, 8), ImageLayout(ImageSize(4, 5), 3, FIRST)),
            ValueCheckError,
            "bit_depth of 32 for torch.float32, got 8",
        ),
        (
            lambda: Image(torch.zeros(3, 4, 5), PixelFormat(ColorSpace.RGB, 32), ImageLayout(ImageSize(4, 5), 3, LAST)),
            ShapeError,
            r"Image: expected data of shape \(4, 5, 3\), got \(3, 4, 5\)",
        ),
    ],
)
def test_errors(call, error, text):
    with pytest.raises(error, match=text):
        call()
