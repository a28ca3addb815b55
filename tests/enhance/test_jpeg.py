"""The codec: the operator, and comparisons with libjpeg."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import skimage.data
import torch

import kvision as K
from op_tests import OpTests, assert_close

E = K.enhance


class TestJpeg(OpTests):
    """Some pixels are outside [0, 1], where there is no gradient."""

    function = staticmethod(E.jpeg_codec_differentiable)
    module = E.JPEGCodecDifferentiable
    forward_arguments = ("jpeg_quality",)
    operators = ("jpeg", "jpeg_backward")
    variants = [
        {"jpeg_quality": 60.0},
        {
            "jpeg_quality": lambda x: 5 + 55 * torch.rand(x.shape[0]),
            "quantization_table_y": lambda x: 20 + 80 * torch.rand(x.shape[0], 8, 8),
            "quantization_table_c": lambda x: 20 + 80 * torch.rand(1, 8, 8),
        },
    ]
    channels = 3
    shape = (2, 3, 19, 70)
    small = (1, 3, 3, 4)
    max_size = 20
    # A coefficient is up to a hundred steps, and the gradient goes with the square of what is left of its last one.
    tolerances = {torch.float32: (1e-4, 5e-5)}

    def input(self, shape, dtype, device):
        return super().input(shape, dtype, device) * 1.2 - 0.1

    test_other_integers_become_float32 = None  # they are refused
    test_value_of_bytes = None

    def test_nan_stays_in_its_window(self, variant, device):
        """That is its block, and the adjacent chroma blocks."""
        x, kwargs = self.setup(variant, device, torch.float32, (1, 3, 64, 64))
        x[0, 1, 22, 23] = float("nan")
        nan = self.call(x, kwargs).isnan().any(1)[0]
        assert nan[16:24, 16:24].all() and not nan[:15].any() and not nan[:, 33:].any()
        assert torch.equal(nan, self.expected(x, kwargs).isnan().any(1)[0])

    test_wrong_kinds = None  # test_all.py; any number of leading axes is right


@pytest.mark.parametrize("quality", [10, 50, 90])
def test_real_jpeg(quality):
    """The same losses as libjpeg, which rounds harder: both results are far closer to each other than to the original."""
    image = np.ascontiguousarray(skimage.data.astronaut()[100:228, 150:278])
    data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    real = torch.from_numpy(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1].copy()).permute(2, 0, 1).float()
    x = torch.from_numpy(image).permute(2, 0, 1).float()
    ours = 255 * E.jpeg_codec_differentiable(x / 255, float(quality))
    assert (ours - real).abs().mean() < 0.6 * (x - real).abs().mean()


def test_the_error_falls_with_quality(device):
    x = torch.rand(5, 3, 32, 32, device=device)[:1].expand(5, -1, -1, -1)
    quality = torch.tensor([5.0, 20.0, 50.0, 80.0, 100.0], device=device)
    loss = (E.jpeg_codec_differentiable(x, quality) - x).square().mean((1, 2, 3))
    assert (loss.diff() < 0).all()


def test_sizes_that_are_no_multiples_of_blocks(device):
    for h, w in ((1, 1), (15, 17), (16, 33)):
        x = torch.rand(2, 3, h, w, device=device)
        y = E.jpeg_codec_differentiable(x, 70.0)
        assert y.shape == x.shape and -1e-4 < y.min() and y.max() < 1 + 1e-4
        assert_close(E.jpeg_codec_differentiable(x[0], 70.0), y[0])


def test_tables(device):
    x = torch.rand(2, 3, 16, 16, device=device)
    flat = torch.full((8, 8), 10.0, device=device, requires_grad=True)
    one = E.jpeg_codec_differentiable(x, 50.0, flat, flat)
    each = E.jpeg_codec_differentiable(x, 50.0, flat.expand(2, 8, 8), flat[None])
    assert_close(one, each)
    (one - x).square().sum().backward()
    assert flat.grad.isfinite().all() and flat.grad.abs().sum() > 0


def test_quality_has_a_finite_gradient_at_both_ends(device):
    quality = torch.tensor([0.0, 1e-30, 50.0, 100.0], device=device, requires_grad=True)
    y = E.jpeg_codec_differentiable(torch.rand(4, 3, 16, 16, device=device), quality)
    y.square().sum().backward()
    assert y.isfinite().all() and quality.grad.isfinite().all()


def test_tables_are_copied_once(device):
    """And are of use in every mode, whichever came first."""
    x = torch.rand(1, 3, 16, 16, device=device, requires_grad=True)
    with torch.inference_mode():
        E.jpeg_codec_differentiable(x, 50.0)
    E.jpeg_codec_differentiable(x, 50.0).sum().backward()
    torch.func.grad(lambda x: E.jpeg_codec_differentiable(x, 50.0).sum())(x)
    if device.type == "cuda":
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph), torch.no_grad():
            captured = E.jpeg_codec_differentiable(x, 50.0)
        graph.replay()
        assert_close(captured, E.jpeg_codec_differentiable(x, 50.0).detach())
