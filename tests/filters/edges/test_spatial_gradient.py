import cv2
import kornia
import pytest
import torch

import kvision as K
from benchmarks.sample_calls.windows import variants
from op_tests import OpTests, assert_close


class TestSpatialGradient(OpTests):
    function = staticmethod(K.filters.spatial_gradient)
    module = K.filters.SpatialGradient
    operators = ("spatial_gradient", "spatial_gradient_backward")
    variants = variants("spatial_gradient")
    errors = [
        ({"mode": "scharr"}, ValueError, "mode must be one of sobel, diff"),
        ({"order": 3}, ValueError, "order must be one of 1, 2"),
    ]

    # The weights of the whole-number kernels of order 2 sum to 64.
    tolerances = {torch.float32: (2e-5, 2e-5)}

    @pytest.mark.parametrize("normalized", [True, False])
    @pytest.mark.parametrize("order", [1, 2])
    @pytest.mark.parametrize("mode", ["sobel", "diff"])
    def test_against_kornia(self, mode, order, normalized, device):
        x = torch.rand(2, 3, 31, 40, device=device)
        expected = kornia.filters.spatial_gradient(x, mode, order, normalized)
        assert_close(K.filters.spatial_gradient(x, mode, order, normalized), expected, atol=2e-5)

    @pytest.mark.parametrize("order, ksize, channels", [(1, 3, [(1, 0), (0, 1)]), (2, 5, [(2, 0), (1, 1), (0, 2)])])
    def test_against_opencv(self, order, ksize, channels, device):
        x = torch.rand(37, 41)
        options = {"ksize": ksize, "borderType": cv2.BORDER_REPLICATE}
        expected = [torch.from_numpy(cv2.Sobel(x.numpy(), cv2.CV_32F, *d, **options)) for d in channels]
        ours = K.filters.spatial_gradient(x[None, None].to(device), "sobel", order, normalized=False)
        assert_close(ours[0, 0].cpu(), torch.stack(expected), atol=1e-4)

    def test_true_derivatives_of_a_polynomial(self, device):
        y, x = torch.meshgrid(
            torch.arange(9.0, dtype=torch.float64), torch.arange(8.0, dtype=torch.float64), indexing="ij"
        )
        image = (1 + 2 * x + 3 * y + x**2 + 5 * x * y + 7 * y**2)[None, None].to(device)
        inside = (..., slice(2, -2), slice(2, -2))
        for mode in ("sobel", "diff"):
            gx, gy = K.filters.spatial_gradient(image, mode)[0, 0][inside]
            assert_close(gx.cpu(), (2 + 2 * x + 5 * y)[inside])
            assert_close(gy.cpu(), (3 + 5 * x + 14 * y)[inside])
            second = K.filters.spatial_gradient(image, mode, 2)[0, 0][inside]
            assert_close(second.mean((1, 2)).cpu(), torch.tensor([2.0, 5.0, 14.0], dtype=torch.float64))

    def test_pixels_under_a_zero_are_not_read(self, device):
        x = torch.rand(1, 1, 7, 7, device=device)
        x[..., 3, 3] = float("nan")
        for mode, order, spoilt in [
            ("sobel", 1, (6, 6)),
            ("diff", 1, (2, 2)),
            ("sobel", 2, (15, 16, 15)),
            ("diff", 2, (3, 4, 3)),
        ]:
            result = K.filters.spatial_gradient(x, mode, order)[0, 0].isnan().sum((1, 2))
            assert tuple(result.tolist()) == spoilt, (mode, order)


class TestSpatialGradient3d(OpTests):
    function = staticmethod(K.filters.spatial_gradient3d)
    module = K.filters.SpatialGradient3d
    operators = ("spatial_gradient3d", "spatial_gradient3d_backward")
    variants = variants("spatial_gradient3d")
    errors = [
        ({"order": 0}, ValueError, "order must be one of 1, 2"),
        ({"mode": "sobel"}, NotImplementedError, "not implemented in 3-D"),
    ]
    shape = (2, 3, 4, 13, 18)
    small = (1, 2, 3, 4, 5)

    def test_against_kornia(self, variant, device):
        for depth in (1, 2, 5):
            x = torch.rand(2, 3, depth, 9, 20, device=device)
            assert_close(K.filters.spatial_gradient3d(x, **variant), kornia.filters.spatial_gradient3d(x, **variant))
