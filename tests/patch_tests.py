"""Inherited tests of operators on square gray patches."""

import pytest
import torch

import kvision as K
from op_tests import OpTests, assert_close


def of_patches(module):
    """A module of patches as a function of them, which has its name in errors."""

    def function(x, **arguments):
        side = x.shape[-1] if isinstance(x, torch.Tensor) and x.dim() else 16
        return module(side, **arguments)(x)

    function.__name__ = module.__name__
    return function


class SquarePatchTests(OpTests):
    channels = 1
    shape = (3, 1, 12, 12)
    small = (1, 1, 7, 7)

    def setup(self, variant, device, dtype=torch.float64, shape=None):
        shape = tuple(shape or self.shape)
        return super().setup(variant, device, dtype, (*shape[:-1], shape[-2]))

    @pytest.mark.sweep
    def test_all_small_sizes(self, variant, sizes, device):
        ran = 0
        for n in range(1, 34) if sizes == "all" else (1, 2, 3, 5, 8, 9, 17, 32, 33):
            x, kwargs = self.setup(variant, device, torch.float32, (2, 1, n, n))
            try:
                expected = self.expected(x, kwargs)
            except K.core.exceptions.ShapeError:
                with pytest.raises(K.core.exceptions.ShapeError):
                    self.call(x, kwargs)
                continue
            ran += 1
            self.check(self.call(x, kwargs), expected)
            self.check_gradients(x, kwargs)
        assert ran > 3

    @pytest.mark.parametrize("bad", [torch.nan, torch.inf])
    def test_nan_stays_in_its_window(self, variant, bad, device):
        """Its gradients are left out."""
        x, kwargs = self.setup(variant, device, torch.float32)
        x[0, 0, 6, 7] = bad
        expected = self.expected(x, kwargs)
        leaf = x.requires_grad_()
        output = self.call(leaf, kwargs)
        assert output.isfinite().all()
        self.check(output, expected)
        (grad,) = torch.autograd.grad(output.sum(), leaf)
        assert grad.isfinite().all()

    def test_flat_patches_have_gradient_zero(self, variant, device):
        for dtype in (torch.float32, torch.float16):
            x = torch.full((2, *self.shape[1:]), 0.3, device=device, dtype=dtype, requires_grad=True)
            output = self.call(x, variant)
            assert output.isfinite().all()
            (grad,) = torch.autograd.grad(output.sum(), x)
            assert torch.equal(grad, torch.zeros_like(grad))

    def test_large_patches(self, variant, device):
        """Patches that do not fit into shared memory on CUDA."""
        x, kwargs = self.setup(variant, device, torch.float32, (1, 1, 100, 100))
        self.check(self.call(x, kwargs), self.expected(x, kwargs))
        self.check_gradients(x, kwargs)

    def test_patches_of_another_size(self, variant, device):
        with pytest.raises(K.core.exceptions.ShapeError, match="13, 13"):
            type(self).kind(13, **variant)(torch.rand(1, 1, 12, 12, device=device))

    @pytest.mark.native  # torch's convolutions round by the size of the batch
    def test_patches_do_not_depend_on_each_other(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        assert torch.equal(self.call(x, kwargs)[1:2], self.call(x[1:2], kwargs))

    def test_is_invariant_to_contrast_and_brightness(self, variant, device):
        x, kwargs = self.setup(variant, device)
        assert_close(self.call(100 * x + 3, kwargs), self.call(x, kwargs), 1e-5, 1e-5)
