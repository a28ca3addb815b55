import cv2
import hypothesis.strategies as st
import kornia
import numpy as np
import pytest
import scipy.ndimage
import torch

import kvision as K
from op_tests import OpTests, assert_close

BORDERS = ("constant", "reflect", "replicate", "circular")


def kernel(*shape):
    """Weights without any symmetry; a batch of 0 stands for that of the input."""
    return lambda x: torch.rand(shape[0] or x.shape[0], *shape[1:]) - 0.3


class TestFilter2dSeparable(OpTests):
    function = staticmethod(K.filters.filter2d_separable)
    operators = ("filter2d_separable", "filter2d_separable_backward", "filter2d_separable_weights_backward")
    bytes = True
    small = (1, 2, 5, 6)
    # Sums of 25 weights of either sign; a byte may fall on the other side of a half when summed in another order.
    tolerances = {torch.float32: (2e-5, 1e-5), torch.uint8: (0, 1)}
    variants = [
        {"kernel_x": kernel(1, 5), "kernel_y": kernel(1, 5)},
        {"kernel_x": kernel(0, 3), "kernel_y": kernel(1, 3), "border_type": "replicate"},
        {"kernel_x": kernel(1, 4), "kernel_y": kernel(0, 2), "normalized": True},
        {"kernel_x": kernel(1, 1), "kernel_y": kernel(1, 6), "border_type": "replicate"},
        {"kernel_x": kernel(0, 7), "kernel_y": kernel(0, 7), "border_type": "circular"},
        {"kernel_x": kernel(1, 3), "kernel_y": kernel(1, 3), "border_type": "constant"},
        {"kernel_x": kernel(1, 5), "kernel_y": kernel(1, 4), "padding": "valid"},
    ]
    errors = [
        ({"kernel_x": lambda x: torch.ones(3)}, ValueError, "expected kernel_x of shape"),
        ({"kernel_y": lambda x: torch.ones(3, 3)}, ValueError, "kernel batch of 1 or the 2 of the input"),
        ({"kernel_y": lambda x: torch.ones(1, 0)}, ValueError, "at least one tap"),
        ({"kernel_x": [1.0]}, TypeError, "expected kernel_x to be a Tensor"),
        ({"border_type": "mirror"}, ValueError, "border_type must be one of"),
        ({"padding": "full"}, ValueError, "padding must be one of"),
        ({"kernel_x": lambda x: torch.ones(1, 41)}, ValueError, "border of 20 pixels"),
        ({"kernel_x": lambda x: torch.ones(1, 41), "padding": "valid"}, ValueError, "no larger than the input"),
    ]

    def fuzz_arguments(self):
        sizes = st.integers(1, 12)
        return st.builds(
            lambda w, h, nx, ny, border, padding: {
                "kernel_x": kernel(nx, w),
                "kernel_y": kernel(ny, h),
                "border_type": border,
                "padding": padding,
            },
            sizes,
            sizes,
            st.integers(0, 1),
            st.integers(0, 1),
            st.sampled_from(BORDERS),
            st.sampled_from(("same", "valid")),
        )

    @pytest.mark.native
    @pytest.mark.parametrize("border", BORDERS)
    @pytest.mark.parametrize("size", [*range(3, 35, 2), 51])
    def test_every_size(self, size, border, device):
        """Every odd size up to 31 has a kernel of its own on CUDA; images larger and smaller than its strips."""
        if device.type == "cpu" and size not in (3, 5, 9, 31, 51):
            pytest.skip("one kernel serves all sizes on the CPU")
        for h, w in [(size // 2 + 1, size // 2 + 1), (size, size + 1), (52, 300), (150, 128), (39, 133)]:
            for dtype in (torch.float32, torch.float16):
                x = torch.rand(2, 1, h, w, device=device).to(dtype)
                kwargs = {
                    "kernel_x": torch.rand(2, size, device=device) - 0.3,
                    "kernel_y": torch.rand(1, size, device=device) - 0.3,
                    "border_type": border,
                }
                scale = float(kwargs["kernel_x"].abs().sum(1).max() * kwargs["kernel_y"].abs().sum())
                rtol, atol = {torch.float32: (2e-5, 2e-6), torch.float16: (2e-3, 1e-3)}[dtype]
                assert_close(self.call(x, kwargs), self.expected(x, kwargs), rtol, atol * scale)
                weight = torch.rand(x.shape, dtype=torch.float64, device=device).to(dtype) - 0.3
                actual = self.gradients(x, kwargs, [weight])
                wide = {k: v.double() if isinstance(v, torch.Tensor) else v for k, v in kwargs.items()}
                with K.backend("reference"):
                    expected = self.gradients(x.double(), wide, [weight.double()])
                assert_close(actual[0], expected[0].to(dtype), rtol, atol * scale)
                for a, e in zip(actual[1:], expected[1:]):
                    assert_close(a, e.float(), 1e-4, 1e-4 * float(e.abs().max()))

    @pytest.mark.parametrize("border", ["constant", "replicate", "circular"])
    def test_kernels_larger_than_the_image(self, border, device):
        kwargs = {"kernel_x": torch.rand(1, 9), "kernel_y": torch.rand(1, 99), "border_type": border}
        shape = (1, 2, 60 if border == "circular" else 7, 11)
        x = torch.rand(shape, device=device)
        kwargs = {k: v.to(device) if isinstance(v, torch.Tensor) else v for k, v in kwargs.items()}
        assert_close(self.call(x, kwargs), self.expected(x, kwargs), 2e-5, 1e-3)
        self.check_gradients(x, kwargs)

    def test_against_opencv_scipy_and_kornia(self, device):
        image = np.random.default_rng(0).random((37, 41), dtype=np.float32)
        row, column = np.float32([0.1, -0.4, 0.2, 0.5, 0.3]), np.float32([0.3, 0.6, -0.2])
        x, kx, ky = (torch.from_numpy(a).to(device) for a in (image[None, None], row[None], column[None]))
        ours = K.filters.filter2d_separable(x, kx, ky)
        assert_close(ours, kornia.filters.filter2d_separable(x, kx, ky))
        expected = cv2.sepFilter2D(image, -1, row, column, borderType=cv2.BORDER_REFLECT_101)
        assert_close(ours[0, 0].cpu(), torch.from_numpy(expected))
        expected = scipy.ndimage.correlate(image, column[:, None] * row, mode="mirror")
        assert_close(ours[0, 0].cpu(), torch.from_numpy(expected))

    def test_even_kernels_have_their_center_at_the_front(self, device):
        x = torch.arange(4.0, device=device).expand(1, 1, 4, 4)
        first = torch.tensor([[1.0, 0.0]], device=device)
        assert torch.equal(K.filters.filter2d_separable(x, first, first), x)

    def test_index_arithmetic_beyond_31_bits(self, device):
        if device.type != "cuda":
            pytest.skip("8 GB of pixels: on the GPU only")
        x = torch.zeros(1, 1, 2**16 + 2, 2**15 + 8, device=device, dtype=torch.float16)
        x[0, 0, -5:, -5:] = torch.rand(5, 5, device=device)
        for taps in (3, 4):  # the fast kernel and the other one
            k = torch.rand(1, taps, device=device)
            y = K.filters.filter2d_separable(x, k, k)
            assert torch.equal(
                y[..., -8:, -8:], K.filters.filter2d_separable(x[..., -12:, -12:].contiguous(), k, k)[..., 4:, 4:]
            )
