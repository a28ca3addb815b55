"""Writing image files."""

from __future__ import annotations

import cv2
import kornia
import numpy as np
import PIL.Image
import pytest
import torch

import kvision as K
from kvision.core.exceptions import ImageError, ShapeError, TypeCheckError, ValueCheckError
from kvision.io import ImageLoadType

UNCHANGED = ImageLoadType.UNCHANGED


def picture(channels, dtype=torch.uint8, height=16, width=24):
    x = torch.rand(channels, height, width)
    return x if dtype == torch.float32 else (x * torch.iinfo(dtype).max).to(dtype)


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [
        (".png", torch.uint8),
        (".png", torch.uint16),
        (".tif", torch.uint8),
        (".TIFF", torch.uint16),
        (".tif", torch.float32),
    ],
)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_lossless_round_trip(suffix, dtype, channels, tmp_path, device):
    image, path = picture(channels, dtype), tmp_path / f"x{suffix}"
    K.io.write_image(path, image.to(device))
    back = K.io.load_image(path, UNCHANGED)
    assert back.dtype == dtype and torch.equal(back, image)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("quality", [0, 50, 80, 100])
def test_jpeg_equals_opencv(channels, quality, tmp_path):
    image = picture(channels)
    K.io.write_image(tmp_path / "x.jpg", image, quality)
    bgr = image.flip(0).movedim(0, -1).contiguous().numpy()
    assert (tmp_path / "x.jpg").read_bytes() == cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, quality))[
        1
    ].tobytes()


def test_default_quality_is_80(tmp_path):
    image = picture(3)
    K.io.write_image(tmp_path / "a.jpg", image)
    K.io.write_image(tmp_path / "b.JPEG", image, 80)
    assert (tmp_path / "a.jpg").read_bytes() == (tmp_path / "b.JPEG").read_bytes()


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_webp(channels, tmp_path):
    smooth = torch.linspace(0.4, 1, 24).expand(channels, 16, 24)
    K.io.write_image(tmp_path / "x.webp", smooth, 100)
    want = ImageLoadType.RGBA8 if channels == 4 else ImageLoadType.RGB8
    back = K.io.load_image(tmp_path / "x.webp", want)
    assert (back.int() - K.core.pixels.to_uint8(smooth).int()).abs().max() <= 6


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_floating_point_is_rounded_and_clamped(dtype, tmp_path):
    K.io.write_image(tmp_path / "x.png", torch.tensor([[-1.0, 0, 0.5, 1, 2, torch.inf, torch.nan]], dtype=dtype))
    assert K.io.load_image(tmp_path / "x.png", UNCHANGED).flatten().tolist() == [0, 0, 128, 255, 255, 255, 0]
    levels = torch.arange(256) / 255
    K.io.write_image(tmp_path / "x.png", levels[None].to(dtype))
    if dtype != torch.bfloat16:
        assert torch.equal(K.io.load_image(tmp_path / "x.png", UNCHANGED).flatten(), torch.arange(256).byte())


def test_float_tiff_keeps_its_values(tmp_path):
    values = torch.tensor([[-1.5, 0.0, 0.3, 7.0]])
    for dtype in (torch.float16, torch.float32, torch.float64):
        K.io.write_image(tmp_path / "x.tif", values.to(dtype))
        assert torch.equal(K.io.load_image(tmp_path / "x.tif", UNCHANGED)[0], values.to(dtype).float())


def test_shapes_layouts_and_untouched_input(tmp_path):
    image = picture(3)
    for same in (image.clone(), image.movedim(0, -1).contiguous().movedim(-1, 0), image.repeat(1, 1, 2)[..., :24]):
        before = same.clone()
        K.io.write_image(str(tmp_path / "x.png"), same)
        assert torch.equal(K.io.load_image(tmp_path / "x.png", UNCHANGED), image) and torch.equal(same, before)
    K.io.write_image(tmp_path / "x.png", image[0])
    assert torch.equal(K.io.load_image(tmp_path / "x.png", UNCHANGED), image[:1])
    K.io.write_image(tmp_path / "x.png", torch.rand(3, 4, 5, requires_grad=True))


def test_other_libraries_read_the_same_pixels(tmp_path):
    image = picture(3)
    K.io.write_image(tmp_path / "x.png", image)
    assert np.array_equal(np.array(PIL.Image.open(tmp_path / "x.png")), image.movedim(0, -1))
    assert torch.equal(kornia.io.load_image(tmp_path / "x.png", kornia.io.ImageLoadType.RGB8), image)


X = torch.zeros(3, 4, 5, dtype=torch.uint8)


@pytest.mark.parametrize(
    ("name", "image", "error", "text"),
    [
        ("x.xyz", X, ValueCheckError, r"write_image: extension must be one of .jpg, .*; got '.xyz' in '.*x.xyz'"),
        ("x", X, ValueCheckError, "got '' in"),
        (".png", X, ValueCheckError, "got '' in"),
        ("x.png", X.numpy(), TypeCheckError, "write_image: expected image to be a Tensor, got ndarray"),
        (
            "x.png",
            X[None],
            ShapeError,
            r"image of shape \(C, H, W\) with C of 1 or 3 or 4 for .png, got \(1, 3, 4, 5\)",
        ),
        ("x.png", X[:2], ShapeError, r"got \(2, 4, 5\)"),
        ("x.png", X[:, :0], ShapeError, r"got \(3, 0, 5\)"),
        ("x.png", X[0, 0], ShapeError, r"got \(5,\)"),
        ("x.jpg", torch.zeros(4, 4, 5), ShapeError, r"with C of 1 or 3 for .jpg, got \(4, 4, 5\)"),
        ("x.jpg", X.to(torch.uint16), TypeCheckError, "floating point or uint8 for .jpg, got torch.uint16"),
        ("x.png", X.long(), TypeCheckError, "floating point or uint8, uint16 for .png, got torch.int64"),
        ("x.png", X.bool(), TypeCheckError, "got torch.bool"),
        ("missing/x.png", X, FileNotFoundError, "missing/x.png"),
        ("file/x.png", X, NotADirectoryError, "file/x.png"),
        ("folder.png", X, IsADirectoryError, "folder.png"),
        ("x.webp", torch.zeros(1, 1, 20000), ImageError, "write_image: cannot encode '.*x.webp'"),
    ],
)
def test_errors(name, image, error, text, tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(error, match=text):
        K.io.write_image(tmp_path / name, image)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.png"]  # nothing is left behind


@pytest.mark.parametrize(
    ("quality", "error"), [(101, ValueCheckError), (-1, ValueCheckError), (8.0, TypeCheckError), (True, TypeCheckError)]
)
def test_quality(quality, error, tmp_path):
    with pytest.raises(error, match="write_image: expected quality"):
        K.io.write_image(tmp_path / "x.jpg", X, quality)


def test_path_of_another_kind():
    with pytest.raises(TypeCheckError, match="expected path_file to be a str or a path, got int"):
        K.io.write_image(3, X)
