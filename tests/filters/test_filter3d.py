import kornia
import pytest
import scipy.ndimage
import torch

import kvision as K
from op_tests import OpTests, assert_close

BORDERS = ("constant", "reflect", "replicate", "circular")


def kernel(*sizes, shared=True):
    return lambda x: torch.rand(1 if shared else x.shape[0], *sizes) - 0.3


class TestFilter3d(OpTests):
    function = staticmethod(K.filters.filter3d)
    operators = ("filter3d", "filter3d_backward", "filter3d_kernel_backward")
    variants = [
        {"kernel": kernel(3, 3, 3)},
        {"kernel": kernel(3, 5, 4, shared=False), "border_type": "reflect"},
        {"kernel": kernel(2, 3, 1), "border_type": "circular"},
        {"kernel": kernel(1, 9, 3, shared=False), "border_type": "constant", "behaviour": "conv"},
    ]
    errors = [
        ({"kernel": kernel(3, 3)}, ValueError, r"expected kernel of shape \(B or 1, kD, kH, kW\)"),
        ({"kernel": kernel(3, 3, 3), "border_type": "zeros"}, ValueError, "border_type must be one of"),
        ({"kernel": kernel(11, 3, 3), "border_type": "reflect"}, ValueError, "'reflect' border of 5"),
    ]
    shape = (2, 2, 5, 9, 10)
    small = (1, 2, 3, 5, 5)
    max_size = 17
    tolerances = {torch.float32: (2e-5, 2e-5)}

    @pytest.mark.parametrize("border", BORDERS)
    @pytest.mark.parametrize("size", [(3, 3, 3), (5, 5, 5), (4, 2, 7)])
    def test_values_and_gradients(self, size, border, device):
        for shape in [(2, 2, 6, 8, 12), (1, 1, 5, 33, 41)]:
            x = torch.rand(shape, device=device)
            kwargs = {"kernel": torch.rand(shape[0], *size, device=device) - 0.5, "border_type": border}
            assert_close(K.filters.filter3d(x, **kwargs), self.expected(x, kwargs), atol=5e-5)
            self.check_gradients(x, kwargs)

    @pytest.mark.parametrize("border", BORDERS)
    def test_against_kornia(self, border, device):
        x, w = torch.rand(2, 3, 5, 9, 11, device=device), torch.rand(2, 3, 5, 3, device=device)
        expected = kornia.filters.filter3d(x, w, border, normalized=True)
        assert_close(K.filters.filter3d(x, w, border, normalized=True), expected)

    def test_against_scipy(self, device):
        x, w = torch.rand(6, 9, 11), torch.rand(3, 5, 3)
        expected = torch.from_numpy(scipy.ndimage.correlate(x.numpy(), w.numpy(), mode="nearest"))
        assert_close(K.filters.filter3d(x[None, None].to(device), w[None].to(device))[0, 0].cpu(), expected)

    def test_correlate_and_convolve(self, device):
        x, w = torch.rand(1, 2, 4, 5, 6, device=device), torch.rand(1, 3, 3, 3, device=device)
        assert_close(K.filters.correlate3d(x, w), K.filters.filter3d(x, w))
        assert_close(K.filters.convolve3d(x, w), K.filters.filter3d(x, w.flip(1, 2, 3)))
