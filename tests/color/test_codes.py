"""Bytes of color conversions: 255ths of RGB, and the codes of OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

import kvision as K
from kvision.core.exceptions import TypeCheckError
from op_tests import assert_close

C = K.color
CODES = {
    "hls": (cv2.COLOR_RGB2HLS, cv2.COLOR_HLS2RGB),
    "hsv": (cv2.COLOR_RGB2HSV, cv2.COLOR_HSV2RGB),
    "lab": (cv2.COLOR_RGB2LAB, cv2.COLOR_LAB2RGB),
    "luv": (cv2.COLOR_RGB2LUV, cv2.COLOR_LUV2RGB),
    "xyz": (cv2.COLOR_RGB2XYZ, cv2.COLOR_XYZ2RGB),
    "ycbcr": (cv2.COLOR_RGB2YCrCb, cv2.COLOR_YCrCb2RGB),
}


@pytest.fixture(scope="module")
def array() -> np.ndarray:
    """Any colors, and rows of grays, black and white."""
    array = np.random.default_rng(0).integers(0, 256, (64, 256, 3), dtype=np.uint8)
    array[0] = np.arange(256)[:, None]
    array[1, :128], array[1, 128:] = 0, 255
    return array


def in_order(space: str, array: np.ndarray) -> np.ndarray:
    """Channels in the other library's order: OpenCV's is y, cr, cb."""
    return np.ascontiguousarray(array[..., [0, 2, 1]]) if space == "ycbcr" else array


def apart(space: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Levels between the codes, around the wheel of hues."""
    distance = np.abs(a.astype(int) - b)
    if space in ("hls", "hsv"):
        distance[..., 0] = np.minimum(distance[..., 0], 180 - distance[..., 0])
    return distance


@pytest.mark.parametrize("space", CODES)
def test_codes_are_opencvs(space, array, device):
    """Within one level. OpenCV interpolates Lab and Luv in tables, which are further off for one color of ten thousand."""
    code, inverse = CODES[space]
    theirs = in_order(space, cv2.cvtColor(array, code))
    ours = getattr(C, f"rgb_to_{space}")(K.image_to_tensor(array).to(device), opencv=True)
    rgb = getattr(C, f"{space}_to_rgb")(K.image_to_tensor(theirs).to(device), opencv=True)
    assert ours.dtype == rgb.dtype == torch.uint8
    their_rgb = cv2.cvtColor(in_order(space, theirs), inverse)
    allowed = 5e-4 if space in ("lab", "luv") else 0
    assert (apart(space, K.tensor_to_image(ours), theirs) > 1).mean() <= allowed
    assert (apart("rgb", K.tensor_to_image(rgb), their_rgb) > 1).mean() <= allowed


@pytest.mark.parametrize("name", [*(f"rgb_to_{space}" for space in CODES), "rgb_to_linear_rgb", "linear_rgb_to_rgb"])
def test_bytes_are_255ths(name, array, device):
    x = K.image_to_tensor(array).to(device)
    expected = getattr(C, name)(x.float() / 255)
    for layout in (torch.contiguous_format, torch.channels_last):
        y = getattr(C, name)(x[None].contiguous(memory_format=layout))
        assert y.dtype == torch.float32 and y.is_contiguous(memory_format=layout)
        assert_close(
            y[0], expected, 1e-5, 5e-4 if name in ("rgb_to_lab", "rgb_to_luv") else 1e-6
        )  # of levels up to 100


@pytest.mark.parametrize("space", CODES)
def test_codes_have_to_be_named(space):
    x = torch.zeros(3, 2, 2, dtype=torch.uint8)
    back = getattr(C, f"{space}_to_rgb")
    with pytest.raises(TypeCheckError, match=f"^{space}_to_rgb: .*floating point, or opencv=True for 8-bit codes"):
        back(x)
    for convert in (back, getattr(C, f"rgb_to_{space}")):
        with pytest.raises(TypeCheckError, match="expected image to be uint8 with opencv"):
            convert(x.float(), opencv=True)
    module = getattr(C, f"RgbTo{space.capitalize()}")(opencv=True)
    assert torch.equal(module(x), getattr(C, f"rgb_to_{space}")(x, opencv=True))
