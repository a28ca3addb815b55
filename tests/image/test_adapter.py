"""Images of NumPy, PIL, OpenCV and files as tensors, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import torch

import kvision as K

PHOTO = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
GRAY = PHOTO[..., 0]
FIRST = torch.from_numpy(PHOTO).movedim(-1, 0)


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (GRAY, FIRST[:1]),
        (PHOTO, FIRST),
        (PHOTO[None], FIRST[None]),
        (PHOTO[::-1, ::2], FIRST.flip(1)[..., ::2]),
        (GRAY.astype(">u2"), FIRST[:1].to(torch.uint16)),
        (PIL.Image.fromarray(PHOTO), FIRST),
        (PIL.Image.fromarray(GRAY), FIRST[:1]),
        (PIL.Image.fromarray(GRAY > 99), FIRST[:1] > 99),
        (PIL.Image.fromarray(GRAY.astype(np.uint16)), FIRST[:1].to(torch.uint16)),
        (PIL.Image.fromarray(GRAY.astype(np.float32)), FIRST[:1].float()),
        (FIRST, FIRST),
        ([PHOTO, PIL.Image.fromarray(PHOTO), FIRST], FIRST.expand(3, -1, -1, -1)),
        ((GRAY, GRAY), FIRST[:1].expand(2, -1, -1, -1)),
    ],
    ids=lambda x: type(x).__name__,
)
def test_values_type_and_axes(image: Any, expected: torch.Tensor) -> None:
    x = K.to_tensor(image)
    assert isinstance(x, torch.Tensor) and x.dtype == expected.dtype and torch.equal(x, expected)


def test_arrays_are_copied() -> None:
    for array in (GRAY.copy(), PHOTO.copy()):
        x = K.to_tensor(array)
        assert x.is_contiguous()
        x.zero_()
        assert array.any()
    x = torch.ones(1, 2, 2)
    K.to_numpy(x)[:] = 0
    assert x.all()


def test_lists_of_other_sizes_or_types_stay_lists() -> None:
    for other in (PHOTO[:4], PHOTO.astype(np.float32)):
        images = K.to_tensor([PHOTO, other])
        assert isinstance(images, list) and [x.shape[1] for x in images] == [5, len(other)]
    video = K.to_tensor([[PHOTO, PHOTO], [PHOTO, PHOTO]])
    assert isinstance(video, torch.Tensor) and video.shape == (2, 2, 3, 5, 7)


@pytest.mark.parametrize("mode", ["P", "CMYK", "YCbCr", "HSV", "RGBX"])
def test_modes_become_rgb(mode: str) -> None:
    picture = PIL.Image.fromarray(PHOTO).convert(mode)
    expected = np.asarray(picture.convert("RGB"))
    assert torch.equal(K.to_tensor(picture), torch.from_numpy(expected.copy()).movedim(-1, 0))


def test_lab_is_no_rgb() -> None:
    picture = PIL.Image.frombytes("LAB", (7, 5), PHOTO.tobytes())
    try:
        expected = np.asarray(picture.convert("RGB"))
    except ValueError:  # an earlier PIL, which has no conversion
        with pytest.raises(ValueError, match="LAB"):
            K.to_tensor(picture)
    else:
        assert torch.equal(K.to_tensor(picture), torch.from_numpy(expected.copy()).movedim(-1, 0))


def test_palettes_keep_alpha() -> None:
    opaque = PIL.Image.fromarray(PHOTO)
    half = opaque.copy()
    half.putalpha(128)
    one = opaque.quantize(4)
    one.info["transparency"] = 0
    for picture in (half.quantize(4), one):
        expected = torch.from_numpy(np.array(picture.convert("RGBA"))).movedim(-1, 0)
        assert picture.mode == "P" and expected[3].min() < 255 and torch.equal(K.to_tensor(picture), expected)


def test_scaling_by_the_range_of_types() -> None:
    levels = torch.from_numpy(GRAY)[None]
    for numpy_type, largest in ((np.uint8, 255), (np.uint16, 65535), (np.int32, 2**31 - 1)):
        for dtype in (torch.float32, torch.float64, torch.float16):
            x = K.to_tensor(GRAY.astype(numpy_type), dtype)
            assert isinstance(x, torch.Tensor) and x.dtype == dtype
            torch.testing.assert_close(x.double(), (levels.double() / largest).to(dtype).double(), rtol=2e-7, atol=0)
    assert torch.equal(K.to_tensor(levels.double() / 255, torch.uint8), levels)
    assert torch.equal(K.to_tensor(GRAY > 99, torch.float32), (levels > 99).float())


def test_bgr_is_the_order_of_opencv() -> None:
    cv2 = pytest.importorskip("cv2")
    blue_first = cv2.cvtColor(PHOTO, cv2.COLOR_RGB2BGR)
    assert torch.equal(K.to_tensor(blue_first, bgr=True), FIRST)
    assert np.array_equal(K.to_numpy(FIRST, bgr=True), blue_first)
    with_alpha = cv2.cvtColor(PHOTO, cv2.COLOR_RGB2BGRA)
    assert torch.equal(K.to_tensor(with_alpha, bgr=True)[:3], FIRST)
    assert torch.equal(K.to_tensor(GRAY, bgr=True), FIRST[:1])
    with pytest.raises(ValueError, match="to_tensor: expected images of 1, 3 or 4 channels with bgr, got 2"):
        K.to_tensor(PHOTO[..., :2], bgr=True)


def test_paths(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    PIL.Image.fromarray(PHOTO).save(path)
    assert torch.equal(K.to_tensor(path), FIRST) and torch.equal(K.to_tensor([str(path)])[0], FIRST)
    torch.testing.assert_close(K.to_tensor(path, torch.float32), FIRST / 255)


@pytest.mark.parametrize("shape", [(1, 5, 7), (3, 5, 7), (4, 5, 7), (2, 1, 5, 7), (2, 3, 5, 7)], ids=str)
def test_there_and_back(shape: tuple[int, ...], device: torch.device) -> None:
    x = torch.rand(shape, generator=torch.Generator().manual_seed(0)).to(device)
    assert torch.equal(K.to_tensor(K.to_numpy(x)), x.cpu())
    levels = K.to_tensor(x, torch.uint8)
    assert isinstance(levels, torch.Tensor)
    assert torch.equal(K.to_tensor(K.to_pil(levels)), levels.cpu()) and torch.equal(
        K.to_tensor(K.to_pil(x)), levels.cpu()
    )


def test_numpy_results() -> None:
    assert K.to_numpy(FIRST[:1]).shape == (5, 7) and K.to_numpy(FIRST[0]).shape == (5, 7)
    assert K.to_numpy([FIRST, PHOTO])[1].shape == (5, 7, 3)
    assert K.to_numpy(FIRST.bfloat16().requires_grad_()).dtype == np.float32
    assert np.array_equal(K.to_numpy(FIRST / 255, torch.uint8), PHOTO)


def test_pil_keeps_the_values_of_masks() -> None:
    for values, mode in (
        (torch.tensor([[[0, 20]]]), "I"),
        (torch.tensor([[[0, 65535]]], dtype=torch.int32), "I"),
        (torch.tensor([[[0, 65535]]], dtype=torch.uint16), "I;16"),
        (torch.tensor([[[0, 20]]], dtype=torch.uint8), "L"),
        (torch.tensor([[[False, True]]]), "1"),
    ):
        picture = K.to_pil(values)
        assert picture.mode == mode and np.array_equal(np.asarray(picture), values[0].numpy())
    assert [picture.mode for picture in K.to_pil(torch.rand(2, 4, 3, 3))] == ["RGBA", "RGBA"]
    assert K.to_pil(PHOTO).getpixel((2, 1)) == tuple(PHOTO[1, 2])


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: K.to_tensor(3), TypeError, "to_tensor: expected images to be a Tensor, an array, .* got int"),
        (lambda: K.to_tensor([GRAY, None]), TypeError, r"to_tensor: expected images\[1\] to be .* got NoneType"),
        (lambda: K.to_tensor([]), ValueError, "to_tensor: expected images to hold at least one image, got an empty list"),
        (lambda: K.to_tensor(GRAY[0]), ValueError, r"to_tensor: expected images of shape \(H, W\), .* got \(7,\)"),
        (lambda: K.to_tensor(GRAY, torch.int32), TypeError, "to_tensor: expected dtype to be uint8 or a floating-point"),
        (lambda: K.to_tensor(GRAY, bgr=1), TypeError, "to_tensor: expected bgr to be a bool"),
        (lambda: K.to_tensor("none.png"), FileNotFoundError, "none.png"),
        (lambda: K.to_numpy(torch.zeros(2)), ValueError, r"to_numpy: expected images of shape .* got \(2,\)"),
        (lambda: K.to_pil(torch.zeros(5, 2, 2)), ValueError, "to_pil: expected images of 1 to 4 channels, got 5"),
        (lambda: K.to_pil(torch.full((1, 2, 2), 2**31)), ValueError, "to_pil: expected integers of at most 32 bits"),
        (lambda: K.filters.sobel(PHOTO), TypeError, "sobel: .* got ndarray; kvision.to_tensor converts images"),
        (lambda: K.filters.sobel(K.to_pil(PHOTO)), TypeError, "sobel: .* got Image; kvision.to_tensor converts PIL"),
        (lambda: K.color.rgb_to_hsv(torch.rand(2, 5, 7, 3)), ValueError, r"; permute\(0, 3, 1, 2\) puts channels first$"),
        (lambda: K.filters.sobel(torch.rand(5, 7, 4)), ValueError, r"got \(5, 7, 4\); permute\(2, 0, 1\) puts channels"),
        (lambda: K.color.rgb_to_hsv(torch.rand(2, 4, 5, 3)), ValueError, r"got \(2, 4, 5, 3\)$"),
        (lambda: K.augmentation.RandomPlanckianJitter(p=1.0)(torch.rand(1, 5, 7, 3)), ValueError, r"; permute\(0, 3, 1, 2\)"),
        (lambda: K.normalize(torch.rand(1, 5, 7, 3), torch.zeros(3), torch.ones(3)), ValueError, r"; permute\(0, 3, 1, 2\)"),
        (lambda: K.filters.in_range(torch.rand(1, 5, 7, 3), (0, 0, 0), (1, 1, 1)), ValueError, r"; permute\(0, 3, 1, 2\)"),
        (lambda: K.io.write_image("x.png", torch.rand(5, 7, 3)), ValueError, r"; permute\(2, 0, 1\) puts channels first"),
        (lambda: K.to_pil(torch.rand(5, 7, 3)), ValueError, r"got 5; permute\(2, 0, 1\) puts channels first"),
        (lambda: K.filters.sobel("photo.jpg"), TypeError, "sobel: .* got str; kvision.to_tensor reads files"),
        (lambda: K.filters.sobel(Path("photo")), TypeError, "sobel: .* got Posix.*; kvision.to_tensor reads files"),
        (lambda: K.filters.sobel("reflect"), TypeError, "sobel: .* got str$"),
        (lambda: K.filters.sobel([FIRST]), TypeError, "sobel: .* got a list of 1 images; stack them, as kvision.to_tensor"),
    ],
)  # fmt: skip
def test_errors(call: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        call()
