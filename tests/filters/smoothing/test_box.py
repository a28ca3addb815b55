import cv2
import hypothesis.strategies as st
import kornia
import numpy as np
import pytest
import torch

import kvision as K
from benchmarks.sample_calls.windows import variants
from kvision import _check
from op_tests import OpTests, assert_close


class TestBoxBlur(OpTests):
    function = staticmethod(K.filters.box_blur)
    module = K.filters.BoxBlur
    operators = ("box_blur", "box_blur_backward")
    bytes = True
    variants = variants("box_blur")
    errors = [
        ({"kernel_size": 0}, ValueError, "expected kernel_size"),
        ({"kernel_size": (3, -1)}, ValueError, "expected kernel_size"),
        ({"kernel_size": 2.0}, TypeError, "expected kernel_size"),
        ({"kernel_size": (3, 3, 3)}, ValueError, "expected kernel_size"),
        ({"border_type": "mirror"}, ValueError, "border_type must be one of"),
        ({"kernel_size": 27}, ValueError, "border of 13 pixels"),
    ]

    def fuzz_arguments(self):
        size = st.integers(1, 40)
        return st.fixed_dictionaries(
            {"kernel_size": size | st.tuples(size, size), "border_type": st.sampled_from(_check.BORDERS)}
        )

    @pytest.mark.parametrize("size", [3, 5, (1, 7), 15, 31, (101, 33)])
    def test_bytes_against_opencv(self, size, device):
        image = np.random.default_rng(0).integers(0, 256, (120, 133, 3), dtype=np.uint8)
        ours = K.filters.box_blur(torch.from_numpy(image).permute(2, 0, 1)[None].to(device), size)
        ky, kx = size if isinstance(size, tuple) else (size, size)
        assert np.array_equal(ours[0].permute(1, 2, 0).cpu().numpy(), cv2.blur(image, (kx, ky)))

    @pytest.mark.parametrize("border", _check.BORDERS)
    @pytest.mark.parametrize("size", [3, (4, 5), (13, 8)])
    def test_against_kornia(self, size, border, device):
        x = torch.rand(2, 3, 31, 40, device=device)
        assert_close(K.filters.box_blur(x, size, border), kornia.filters.box_blur(x, size, border))

    @pytest.mark.parametrize("size", [(5, 5), (31, 31), (200, 257), (300, 400)], ids=str)
    def test_rounding_does_not_grow_along_the_image(self, size, device, backend):
        self.needs_native(backend)
        x = 1000 + torch.rand(1, 1, 1080, 1920, device=device)
        exact = K.filters.box_blur(x.double(), size)
        units = 8 if size[0] * size[1] < 100_000 else 24  # in the last place of 1000, for the largest sum
        assert_close(K.filters.box_blur(x, size).double(), exact, 0, units * 2.0**-14)

    def test_wide_images_of_every_layout(self, device):
        for border in _check.BORDERS:
            x = torch.rand(2, 3, 150, 300, device=device)
            for y in (x, x.contiguous(memory_format=torch.channels_last), x[..., 1:], x[..., 4:]):
                with K.backend("reference"):
                    expected = K.filters.box_blur(y.double(), (33, 31), border).float()
                assert_close(K.filters.box_blur(y, (33, 31), border), expected)
            self.check_gradients(x, {"kernel_size": (33, 31), "border_type": border})

    @pytest.mark.parametrize("bad", [float("nan"), float("inf")])
    @pytest.mark.parametrize("size", [5, 31])
    def test_bad_pixels_stay_inside_their_window(self, bad, size, device):
        x = torch.rand(1, 1, 100, 110, device=device, requires_grad=True)
        with torch.no_grad():
            x[0, 0, 50, 60] = bad
        y = K.filters.box_blur(x, size)
        r = size // 2
        inside = torch.zeros_like(y, dtype=torch.bool)
        inside[..., 50 - r : 51 + r, 60 - r : 61 + r] = True
        assert torch.equal(~y.isfinite(), inside)
        (grad,) = torch.autograd.grad(y, x, x.detach())
        assert torch.equal(~grad.isfinite(), inside)

    def test_one_pixel_is_the_image(self, device):
        x = torch.rand(2, 3, 5, 6, device=device)
        assert torch.equal(K.filters.box_blur(x, 1), x)

    def test_index_arithmetic_beyond_31_bits(self, device):
        if device.type != "cuda":
            pytest.skip("8 GB of pixels: on the GPU only")
        x = torch.zeros(1, 1, 2**16 + 2, 2**15 + 8, device=device, dtype=torch.float16)
        x[0, 0, -40:, -40:] = torch.rand(40, 40, device=device)
        for size in (5, 11):
            y = K.filters.box_blur(x, size)
            assert_close(y[..., -8:, -8:], K.filters.box_blur(x[..., -64:, -64:].contiguous(), size)[..., -8:, -8:])
