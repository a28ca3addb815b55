"""Reading image files: real ones where the optional data is there, generated ones otherwise."""

from __future__ import annotations

import io
import sys
from importlib import metadata

import cv2
import kornia
import numpy as np
import PIL.Image
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import fresh
import kvision as K
from kvision import _hints
from kvision.core.exceptions import BaseError, ImageError, TypeCheckError
from kvision.io import ImageLoadType
from kvision.io._exif import orientation_of
from kvision.io._opencv import opencv

TYPES = {
    ImageLoadType.GRAY8: (1, torch.uint8),
    ImageLoadType.RGB8: (3, torch.uint8),
    ImageLoadType.RGBA8: (4, torch.uint8),
    ImageLoadType.GRAY32: (1, torch.float32),
    ImageLoadType.RGB32: (3, torch.float32),
}


def picture(channels, dtype=np.uint8, height=6, width=9):
    shape = (height, width, channels) if channels > 1 else (height, width)
    top = 1 if np.issubdtype(dtype, np.floating) else np.iinfo(dtype).max
    return (np.random.default_rng(channels).random(shape) * top).astype(dtype)


def save(path, rgb):
    """Write with OpenCV, which wants BGR."""
    order = {1: [0], 3: [2, 1, 0], 4: [2, 1, 0, 3]}
    lossless = (cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_LZW) if path.suffix == ".tif" else ()
    assert cv2.imwrite(str(path), rgb if rgb.ndim == 2 else rgb[..., order[rgb.shape[2]]], lossless)
    return path


def expected(rgb, kind):
    """The rules of load_image in float64, from (H, W) or (H, W, C) levels."""
    top = np.iinfo(rgb.dtype).max if rgb.dtype.kind == "u" else 1
    x = np.moveaxis(np.atleast_3d(rgb.astype(np.float64) / top), 2, 0)
    channels, dtype = TYPES[kind]
    if len(x) == 4 and channels < 4:
        x = x[:3] * x[3:] + (1 - x[3:])
    if channels == 1 and len(x) == 3:
        x = np.tensordot([0.299, 0.587, 0.114], x, 1)[None]
    elif channels > 1 and len(x) == 1:
        x = x.repeat(3, 0)
    if channels == 4 and len(x) == 3:
        x = np.concatenate([x, np.ones_like(x[:1])])
    return torch.from_numpy(x if dtype == torch.float32 else np.rint(x * 255))


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(("dtype", "suffix"), [(np.uint8, ".png"), (np.uint16, ".png"), (np.float32, ".tif")])
def test_every_type_of_every_file(kind, channels, dtype, suffix, tmp_path, device):
    rgb = picture(channels, dtype)
    got = K.io.load_image(save(tmp_path / f"x{suffix}", rgb), kind, device)
    assert (got.shape, got.dtype) == ((TYPES[kind][0], 6, 9), TYPES[kind][1])
    assert got.is_contiguous() and got.device.type == device.type
    # GRAY8 of 8-bit colors takes OpenCV's fixed-point weights, which differ where the sum is nearly half-way
    tolerance = 1 if kind is ImageLoadType.GRAY8 and channels == 3 else 0
    if kind in (ImageLoadType.GRAY32, ImageLoadType.RGB32):
        tolerance = 1e-6
    torch.testing.assert_close(got.cpu().double(), expected(rgb, kind).double(), rtol=0, atol=tolerance)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(("dtype", "suffix"), [(np.uint8, ".png"), (np.uint16, ".png"), (np.float32, ".tif")])
def test_unchanged_keeps_channels_and_dtype(channels, dtype, suffix, tmp_path, device):
    rgb = picture(channels, dtype)
    got = K.io.load_image(save(tmp_path / f"x{suffix}", rgb), ImageLoadType.UNCHANGED, device)
    assert (
        np.array_equal(got.cpu().numpy(), np.moveaxis(np.atleast_3d(rgb), 2, 0))
        and got.numpy(force=True).dtype == dtype
    )
    assert got.is_contiguous()


def test_16_bits_are_scaled_not_cut(tmp_path):
    levels = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    path = save(tmp_path / "ramp.png", levels)
    assert np.array_equal(K.io.load_image(path, ImageLoadType.GRAY8)[0], np.rint(levels / 257.0))
    assert np.array_equal(K.io.load_image(path, ImageLoadType.GRAY32)[0], levels.astype(np.float32) / 65535)


def test_gray_is_opencvs_bit_for_bit(tmp_path):
    rgb = picture(3, height=200, width=300)
    got = K.io.load_image(save(tmp_path / "x.png", rgb), ImageLoadType.GRAY8)
    assert np.array_equal(got[0], cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))


def test_jpeg_as_opencv_reads_it(tmp_path):
    path = save(tmp_path / "x.jpg", picture(3, height=40, width=60))
    assert np.array_equal(K.io.load_image(path, ImageLoadType.RGB8).movedim(0, -1), cv2.imread(str(path))[..., ::-1])


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_agrees_with_kornia(channels, tmp_path):
    path = save(tmp_path / "x.png", picture(channels, height=40, width=60))
    for kind in TYPES:
        got = K.io.load_image(path, kind)
        want = kornia.io.load_image(path, kornia.io.ImageLoadType[kind.name])
        level = 1 if got.dtype == torch.uint8 else 1 / 255  # it rounds in between
        tolerance = level if channels == 4 and kind is not ImageLoadType.RGBA8 else level * 1e-4
        torch.testing.assert_close(got.double(), want.double(), rtol=0, atol=tolerance)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(
    ("suffix", "channels"), [(".jpg", 3), (".jpg", 1), (".png", 3), (".png", 4), (".webp", 4), (".tif", 3)]
)
def test_exif_orientation(orientation, suffix, channels, tmp_path):
    """An image is stored turned, with the tag that turns it back; every type must show it upright."""
    if suffix == ".webp" and cv2.__version__.startswith("4.12"):
        pytest.skip("OpenCV 4.12 does not read the EXIF block of WebP")
    upright = np.zeros((16, 32, channels), np.uint8)
    upright[..., -1] = 200
    upright[:8, :16, 0], upright[8:, 16:, channels // 2] = 250, 120
    stored = upright
    if orientation in (2, 3, 6, 7):
        stored = stored[:, ::-1]
    if orientation in (3, 4, 7, 8):
        stored = stored[::-1]
    if orientation >= 5:
        stored = stored.swapaxes(0, 1)
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    lossless = {".jpg": {"quality": 100, "subsampling": 0}, ".webp": {"lossless": True, "exact": True}}.get(suffix, {})
    path = tmp_path / f"turned{suffix}"
    PIL.Image.fromarray(np.ascontiguousarray(stored.squeeze())).save(path, exif=exif, **lossless)
    tolerance = 5 if suffix == ".jpg" else 1
    unchanged = K.io.load_image(path, ImageLoadType.UNCHANGED)
    torch.testing.assert_close(unchanged.movedim(0, -1).int(), torch.from_numpy(upright).int(), rtol=0, atol=tolerance)
    for kind in TYPES:
        got, want = K.io.load_image(path, kind).double(), expected(upright, kind).double()
        level = 1 if TYPES[kind][1] == torch.uint8 else 1 / 255
        torch.testing.assert_close(got, want, rtol=0, atol=tolerance * level)


def test_real_exif_photographs(data):
    """One landscape stored in four orientations, each compressed on its own."""
    folder = data / "photos" / "exif"
    reference = K.io.load_image(folder / "landscape_1.jpg")
    assert reference.shape == (3, 1200, 1800)
    for orientation in (3, 6, 8):
        path = folder / f"landscape_{orientation}.jpg"
        psnr = -10 * (K.io.load_image(path) - reference).square().mean().log10()
        assert psnr > 28, orientation
        unchanged = K.io.load_image(path, ImageLoadType.UNCHANGED)
        assert torch.equal(unchanged, K.io.load_image(path, ImageLoadType.RGB8))


PNGSUITE = {  # channels and dtype OpenCV decodes to
    "basn0g01": (1, torch.uint8),
    "basn0g08": (1, torch.uint8),
    "basn0g16": (1, torch.uint16),
    "basn2c08": (3, torch.uint8),
    "ibasn2c08": (3, torch.uint8),
    "basn2c16": (3, torch.uint16),
    "basn3p08": (3, torch.uint8),
    "basn4a08": (4, torch.uint8),
    "basn4a16": (4, torch.uint16),
    "basn6a08": (4, torch.uint8),
    "basn6a16": (4, torch.uint16),
    "ftbbn2c16": (4, torch.uint16),
    "ftbwn0g16": (4, torch.uint16),
}


@pytest.mark.parametrize("name", PNGSUITE)
def test_pngsuite(data, name):
    path = data / "photos" / "pngsuite" / f"{name}.png"
    unchanged = K.io.load_image(path, ImageLoadType.UNCHANGED)
    channels, dtype = PNGSUITE[name]
    assert (unchanged.shape, unchanged.dtype) == ((channels, 32, 32), dtype)
    for kind in TYPES:
        torch.testing.assert_close(
            K.io.load_image(path, kind).double(),
            expected(unchanged.movedim(0, -1).squeeze(-1).numpy(), kind).double(),
            rtol=0,
            atol=1e-6 if kind.name.endswith("32") else 1,
        )
    if dtype == torch.uint8 and name != "basn4a08":
        pillow = torch.from_numpy(np.array(PIL.Image.open(path).convert("RGBA"))).movedim(-1, 0)
        assert torch.equal(K.io.load_image(path, ImageLoadType.RGBA8), pillow)


def test_paths_and_devices(tmp_path, monkeypatch, device):
    path = save(tmp_path / "bild mit ümläut.PNG", picture(3))
    monkeypatch.chdir(tmp_path)
    whole = K.io.load_image(path)
    assert whole.dtype == torch.float32
    for same in (str(path), path.name, path.relative_to(tmp_path)):
        assert torch.equal(K.io.load_image(same), whole)
    torch.testing.assert_close(K.io.load_image(path, device=device).cpu(), whole)  # CUDA divides to another last bit
    assert torch.equal(K.io.load_image(path, ImageLoadType.RGB32, None), whole)


def test_content_decides_the_format(tmp_path):
    path = save(tmp_path / "x.png", picture(3))
    assert torch.equal(K.io.load_image(path.rename(tmp_path / "x.jpg")), K.io.load_image(tmp_path / "x.jpg"))


def encoded(suffix):
    return cv2.imencode(suffix, picture(3, height=64, width=64))[1].tobytes()


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".webp", ".bmp"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95])
def test_truncated_files(suffix, share, tmp_path, capfd):
    path, content = tmp_path / f"cut{suffix}", encoded(suffix)
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(ImageError, match=r"load_image: cannot decode '.*cut\.\w+': ") as caught:
        K.io.load_image(path)
    assert isinstance(caught.value, ValueError)


@given(st.binary(max_size=300), st.sampled_from(["", ".jpg", ".png", ".tif", ".webp"]), st.integers(0, 400))
def test_random_bytes_load_or_raise_image_error(tmp_path_factory, junk, suffix, position):
    """Arbitrary bytes, and good files with some of them written over."""
    content = bytearray(encoded(suffix)[:4000] if suffix else b"")
    content[position : position + len(junk)] = junk
    path = tmp_path_factory.getbasetemp() / "junk"
    path.write_bytes(content)
    try:
        assert K.io.load_image(path, ImageLoadType.RGB8).dtype == torch.uint8
    except ImageError as error:
        assert str(path) in str(error)


@given(st.binary(max_size=80))
def test_any_bytes_are_an_orientation(junk):
    for head in (b"", b"II*\0\x08\0\0\0", b"MM\0*\0\0\0\x08", b"Exif\0\0MM\0*\0\0\0\x08"):
        assert 1 <= orientation_of(head + junk) <= 8


def test_unreadable_paths(tmp_path):
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("no image at all")
    for name, error, text in [
        ("missing.png", FileNotFoundError, "No such file or directory: '.*missing.png'"),
        ("missing/x.png", FileNotFoundError, "missing/x.png"),
        (".", IsADirectoryError, f"Is a directory: '{tmp_path}'"),
        ("text.png/x.png", NotADirectoryError, "text.png/x.png"),
        ("empty.png", ImageError, "load_image: cannot decode '.*empty.png': the file is empty"),
        ("text.png", ImageError, "load_image: cannot decode '.*text.png': it is in no format that OpenCV reads"),
    ]:
        with pytest.raises(error, match=text):
            K.io.load_image(tmp_path / name)


def test_no_name_of_a_file_reaches_opencv(tmp_path, monkeypatch):
    """OpenCV crashes at names that are no valid text."""
    names = []
    reader = cv2.haveImageReader
    monkeypatch.setattr(cv2, "haveImageReader", lambda name: names.append(name) or reader(name))
    (tmp_path / "text.png").write_text("no image at all")
    cut = cv2.imencode(".png", np.zeros((50, 50), np.uint8))[1][:60]
    (tmp_path / "cut.png").write_bytes(cut.tobytes())
    for name, reason in (("text.png", "in no format"), ("cut.png", "damaged or cut short")):
        with pytest.raises(ImageError, match=reason):
            K.io.load_image(tmp_path / name)
    assert len(names) == 2 and not any(str(tmp_path) in name for name in names)


def test_other_numbers_load_unchanged_only(tmp_path):
    path = tmp_path / "depth.tif"
    values = np.arange(-6, 6, dtype=np.int16).reshape(3, 4)
    PIL.Image.fromarray(values.astype(np.int32)).save(path)
    unchanged = K.io.load_image(path, ImageLoadType.UNCHANGED)
    assert unchanged.dtype == torch.int32 and np.array_equal(unchanged[0], values)
    with pytest.raises(ImageError, match=r"depth\.tif' to RGB32: it holds 1 channels of torch\.int32; load it"):
        K.io.load_image(path)


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ((None,), "load_image: expected path_file to be a str or a path, got NoneType"),
        ((3,), "path_file .* got int"),
        (("x.png", "rgb8"), "load_image: expected desired_type to be an ImageLoadType, got 'rgb8'"),
        (("x.png", 2), "got 2"),
    ],
)
def test_wrong_arguments(args, text):
    with pytest.raises(TypeCheckError, match=text) as caught:
        K.io.load_image(*args)
    assert isinstance(caught.value, TypeError) and isinstance(caught.value, BaseError)


def test_opencv_is_imported_when_needed():
    code = (
        "import sys, kvision\n"
        "assert not {'cv2', 'skimage', 'PIL'} & sys.modules.keys()\n"
        "sys.modules['cv2'] = None\n"
        "try: kvision.io.load_image(sys.argv[1])\n"
        "except ImportError as error: print(error)"
    )
    done = fresh.run(code, __file__)
    assert done.returncode == 0 and "pip install opencv-python-headless" in done.stdout, done.stderr


def test_the_first_use_names_several_flavors_of_opencv(monkeypatch, tmp_path):
    versions = {"opencv-python": "4.12.0.88", "opencv-python-headless": "5.0.0.93"}

    def version(name):
        if name not in versions:
            raise metadata.PackageNotFoundError(name)
        return versions[name]

    monkeypatch.setattr(metadata, "version", version)
    named = "opencv-python 4.12.0.88 and opencv-python-headless 5.0.0.93 overwrite one another's files"
    opencv.cache_clear()
    with pytest.warns(UserWarning, match=named) as found:
        K.io.write_image(tmp_path / "a.png", torch.zeros(3, 4, 4))
        K.io.load_image(tmp_path / "a.png")
    assert [warning.filename for warning in found] == [__file__]
    assert any(named in step for step in K.info._next_steps())
    del versions["opencv-python"]
    assert not _hints.advice_on_opencv()


def test_sample_images(monkeypatch, tmp_path):
    photos = K.io.get_sample_images()
    assert [tuple(photo.shape) for photo in photos] == [(3, 512, 512), (3, 300, 451), (3, 400, 600), (3, 427, 640)]
    assert all(photo.dtype == torch.float32 and 0 <= photo.min() < photo.max() <= 1 for photo in photos)
    path = save(tmp_path / "mine.png", picture(3))
    batch = K.io.get_sample_images((32, 48), ["camera", "logo", "horse", path])
    assert batch.shape == (4, 3, 32, 48)
    assert isinstance(K.io.get_sample_images((32, 48), ["moon"], as_list=True), list)
    with pytest.raises(FileNotFoundError, match="no_such_photo"):
        K.io.get_sample_images(paths=["no_such_photo"])
    with pytest.raises(TypeCheckError, match="sequence of names or paths, got 'moon'"):
        K.io.get_sample_images(paths="moon")
    monkeypatch.setitem(sys.modules, "skimage", None)
    monkeypatch.setitem(sys.modules, "skimage.data", None)
    with pytest.raises(ImportError, match=r"'moon' comes with scikit-image.*pip install scikit-image"):
        K.io.get_sample_images(paths=["moon"])


def test_jpeg_without_metadata_and_pillow_buffers(tmp_path):
    """A file from memory, gray JPEG, as another library wrote it."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(picture(1, height=32, width=32)).save(buffer, "JPEG", quality=100)
    (tmp_path / "gray.jpg").write_bytes(buffer.getvalue())
    assert K.io.load_image(tmp_path / "gray.jpg", ImageLoadType.UNCHANGED).shape == (1, 32, 32)
