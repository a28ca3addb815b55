"""YCbCr and YUV: OpenCV's values, chroma at half the resolution."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

import kvision as K
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError
from op_tests import OpTests, assert_close

C = K.color
SPLITS = [(C.rgb_to_yuv420, C.yuv420_to_rgb, C.RgbToYuv420, C.Yuv420ToRgb, 2)]
SPLITS += [(C.rgb_to_yuv422, C.yuv422_to_rgb, C.RgbToYuv422, C.Yuv422ToRgb, 1)]


def test_opencv_with_the_chroma_in_its_order(device):
    array = np.random.default_rng(0).random((20, 30, 3), np.float32)
    x = K.image_to_tensor(array).to(device)
    ours = K.tensor_to_image(C.rgb_to_ycbcr(x)[[0, 2, 1]])
    np.testing.assert_allclose(ours, cv2.cvtColor(array, cv2.COLOR_RGB2YCrCb), atol=1e-5)
    np.testing.assert_allclose(
        K.tensor_to_image(C.rgb_to_yuv(x)), cv2.cvtColor(array, cv2.COLOR_RGB2YUV) - [0, 0.5, 0.5], atol=1e-3
    )


def test_all_conversions_have_the_same_luma(device):
    x = torch.rand(2, 3, 4, 5, dtype=torch.float64, device=device)
    for y in (C.rgb_to_y(x), C.rgb_to_ycbcr(x)[:, :1], C.rgb_to_yuv(x)[:, :1]):
        assert_close(y, C.rgb_to_grayscale(x))


def test_ycbcr_is_clamped(device):
    x = torch.tensor([[1.0, 1.0, 0.5], [0.0, 0.0, 0.5]], device=device).T[..., None]
    y = C.ycbcr_to_rgb(x)
    assert y.max() == 1 and y.min() == 0


@pytest.mark.parametrize("split, join, splitter, joiner, rows", SPLITS)
def test_planes(split, join, splitter, joiner, rows, device):
    kornia = pytest.importorskip("kornia")
    x = torch.rand(2, 2, 3, 6, 8, dtype=torch.float64, device=device)
    y, uv = split(x)
    assert y.shape == (2, 2, 1, 6, 8) and uv.shape == (2, 2, 2, 6 // rows, 4)
    whole = C.rgb_to_yuv(x)
    assert_close(y, whole[..., :1, :, :])
    cells = whole[..., 1:, :, :].unflatten(-2, (-1, rows)).unflatten(-1, (-1, 2))
    assert_close(uv, cells.mean((-3, -1)))
    assert_close((y, uv), tuple(getattr(kornia.color, split.__name__)(x)))
    assert_close(splitter()(x), (y, uv))

    joined = join(y, uv)
    assert_close(joined, getattr(kornia.color, join.__name__)(y, uv))
    assert_close(joiner()(y, uv), joined)
    assert_close(join(y[0, 0], uv[0, 0]), joined[0, 0])
    flat = torch.full((1, 3, 4, 4), 0.3, dtype=torch.float64, device=device)
    assert_close(join(*split(flat)), flat)


class TestSharedChroma(OpTests):
    """Splitting and joining are each other's gradient."""

    function = staticmethod(lambda input, rows: {1: C.rgb_to_yuv422, 2: C.rgb_to_yuv420}[rows](input))
    operators = ("split_chroma", "join_chroma")
    variants = [{"rows": 1}, {"rows": 2}]
    channels = 3
    shape = (2, 3, 14, 18)
    small = (1, 3, 2, 4)
    max_size = 20

    def input(self, shape, dtype, device):
        """Of even height and width."""
        return super().input((*shape[:-2], *(n + n % 2 for n in shape[-2:])), dtype, device)

    test_nan_stays_in_its_window = None  # of two channels

    test_wrong_kinds = None  # test_errors below; any number of leading axes is right


@pytest.mark.parametrize("split, join, splitter, joiner, rows", SPLITS)
def test_joining(split, join, splitter, joiner, rows, device):
    x = torch.rand(1, 3, 2, 4, dtype=torch.float64, device=device)
    planes = [p.requires_grad_() for p in split(x)]
    assert torch.autograd.gradcheck(join, planes) and torch.autograd.gradgradcheck(join, planes)
    stack = torch.rand(3, 2, 3, 4, 6, device=device)
    planes = split(stack)
    assert_close(torch.func.vmap(join)(*planes), join(*planes))
    y, uv = (p.half() for p in planes)
    assert_close(join(y, uv), join(y.float(), uv.float()).half())
    assert join(*split(stack[..., :0])).shape == (3, 2, 3, 4, 0)


@pytest.mark.parametrize("split, join, splitter, joiner, rows", SPLITS)
def test_errors(split, join, splitter, joiner, rows, device):
    x = torch.rand(2, 3, 4, 6, device=device)
    y, uv = split(x)
    for call, error, text in [
        (lambda: split([x]), TypeCheckError, "expected image to be a Tensor"),
        (lambda: split(x[:, :2]), ShapeError, r"expected image of shape \(\*, 3, H, W\)"),
        (lambda: split(x[..., :5]), ShapeError, "expected image with even .*W, got"),
        (lambda: join(x, uv), ShapeError, r"expected imagey of shape \(\*, 1, H, W\)"),
        (lambda: join(y, None), TypeCheckError, "expected imageuv to be a Tensor"),
        (lambda: join(y, y), ShapeError, r"expected imageuv of shape \(\*, 2, H, W\)"),
        (lambda: join(y[..., :5], uv), ShapeError, "expected imagey with even .*W, got"),
        (lambda: join(y, uv[..., :2]), ShapeError, "expected imageuv of shape"),
        (lambda: join(y, uv[:1]), ShapeError, "expected imageuv of shape"),
        (lambda: join(y, uv.to("meta")), DeviceError, "expected all tensors on one device"),
    ]:
        with pytest.raises(error, match=f"^(rgb_to_yuv42.|yuv42._to_rgb): {text}"):
            call()
    odd_rows = x[:, :, :3]
    if rows == 2:
        with pytest.raises(ShapeError, match="even H and W"):
            split(odd_rows)
    else:
        assert split(odd_rows)[1].shape == (2, 2, 3, 3)
