"""normalize_min_max: the shared suite, ranges, and planes that one block does not hold."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from kvision.enhance.min_max import _normalize_min_max
from op_tests import OpTests, assert_close

E = K.enhance


class TestNormalizeMinMax(OpTests):
    function = staticmethod(E.normalize_min_max)
    operators = ("normalize_min_max", "normalize_min_max_backward")
    variants = [{}, {"min_val": -1.0, "max_val": 3.0, "eps": 0.01}]
    errors = [({"min_val": "0"}, TypeError, "min_val"), ({"eps": -1.0}, ValueError, "eps")]
    max_size = 21
    # In planes of few pixels the gradient of a pixel, many times larger where the range is small, and that of the range cancel.
    tolerances = {torch.float32: (2e-5, 2e-5)}

    def test_wrong_kinds(self, variant, device):
        """Images of two axes and more."""
        x, kwargs = self.setup(variant, device, torch.float32)
        for wrong, error in [
            (None, TypeError),
            (x.to(torch.complex64), TypeError),
            (x[0, 0, 0], ValueError),
            (x[..., :0], ValueError),
        ]:
            with pytest.raises(error, match="^normalize_min_max: "):
                self.call(wrong, kwargs)

    @pytest.mark.native
    @pytest.mark.large
    @pytest.mark.parametrize("size", [(256, 256), (301, 333)], ids=str)
    @pytest.mark.parametrize("planes", [1, pytest.param(70, marks=pytest.mark.gpu)])
    def test_large_planes(self, size, planes, device):
        """Planes of one chunk or several, of whole vectors or not; flat and NaN planes, and ties, are among them."""
        x = (torch.rand(planes + 2, 1, *size, device=device) * 300).round() / 255
        x[0] = 0.3
        x[1, 0, 5, 6] = torch.nan
        self.check(self.call(x, {}), self.expected(x, {}))
        self.check_gradients(x, {})


def test_range_of_every_plane(device):
    x = torch.rand(2, 3, 4, 5, device=device) * torch.tensor([1.0, 10.0, 100.0], device=device).view(3, 1, 1)
    y = E.normalize_min_max(x, -1.0, 3.0)
    assert_close(y.amin((2, 3)), torch.full((2, 3), -1.0, device=device))
    assert_close(y.amax((2, 3)), torch.full((2, 3), 3.0, device=device), 0, 1e-4)
    assert_close(E.normalize_min_max(x[0, 0]), E.normalize_min_max(x)[0, 0])


def test_flat_planes_become_the_minimum(device):
    x = torch.full((1, 1, 3, 3), 0.5, device=device, requires_grad=True)
    y = E.normalize_min_max(x)
    y.sum().backward()
    assert_close(y.detach(), torch.zeros_like(y))
    assert x.grad.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16], ids=str)
def test_planes_of_one_value_may_stay(dtype, device):
    """Their pixels and their gradient; results are clamped where that is asked for."""
    x = torch.rand(2, 3, 7, 9, dtype=dtype, device=device) * 1e4
    x[0, 1] = 0.3
    x[1, 2, 0, 0] = torch.nan
    x.requires_grad_()
    y = _normalize_min_max(x, 0.0, 1.0, 1e-6, True, True)[0]
    weights = torch.rand_like(y)
    (gradient,) = torch.autograd.grad((y * weights).sum(), x)
    assert torch.equal(y[0, 1], x[0, 1]) and torch.equal(gradient[0, 1], weights[0, 1])
    assert y[1, 2].isnan().all() and y[0, [0, 2]].amax() <= 1
    expected = _normalize_min_max.reference(x, 0.0, 1.0, 1e-6, True, True)[0]
    assert_close(y, expected, 2e-3, 2e-3)
