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


class TestLaplacian(OpTests):
    function = staticmethod(K.filters.laplacian)
    module = K.filters.Laplacian
    operators = ("laplacian", "laplacian_backward")
    bytes = True
    variants = variants("laplacian")
    # Unnormalized, the sum of up to 31 x 31 pixels is near n times the center, and their rounding is left.
    tolerances = {torch.float32: (2e-5, 2e-4)}
    errors = [
        ({"kernel_size": 4}, ValueError, "odd"),
        ({"kernel_size": 1}, ValueError, "kernel_size"),
        ({"kernel_size": "3"}, TypeError, "kernel_size"),
        ({"border_type": "mirror"}, ValueError, "border_type must be one of"),
        ({"kernel_size": 27}, ValueError, "border of 13 pixels"),
    ]

    def fuzz_arguments(self):
        size = st.integers(1, 15).map(lambda n: 2 * n + 1)
        return st.fixed_dictionaries(
            {
                "kernel_size": size | st.tuples(size, size),
                "border_type": st.sampled_from(_check.BORDERS),
                "normalized": st.booleans(),
            }
        )

    def input(self, shape, dtype, device):
        x = super().input(shape, dtype, device)
        return x // 4 if dtype == torch.uint8 else x  # so that not all bytes saturate

    @pytest.mark.parametrize("size", [3, 5, (3, 7)])
    def test_bytes_against_opencv(self, size, device):
        ky, kx = size if isinstance(size, tuple) else (size, size)
        kernel = np.ones((ky, kx), dtype=np.float32)
        kernel[ky // 2, kx // 2] = 1 - ky * kx
        image = np.random.default_rng(0).integers(0, 256, (67, 79, 3), dtype=np.uint8)
        x = torch.from_numpy(image).permute(2, 0, 1)[None].to(device)
        for normalized in (False, True) if size == 3 else (False,):  # 1/16 is exact, others round in their own ways
            ours = K.filters.laplacian(x, size, normalized=normalized)[0].permute(1, 2, 0).cpu().numpy()
            theirs = cv2.filter2D(image, -1, kernel / (16 if normalized else 1))
            assert np.array_equal(ours, theirs)

    @pytest.mark.parametrize("border", _check.BORDERS)
    @pytest.mark.parametrize("size", [3, (5, 3), 11])
    def test_against_kornia(self, size, border, device):
        x = torch.rand(2, 3, 31, 40, device=device)
        for normalized in (False, True):
            assert_close(
                K.filters.laplacian(x, size, border, normalized),
                kornia.filters.laplacian(x, size, border, normalized),
                2e-5,
                1e-4 if size == 11 and not normalized else 1e-5,
            )

    def test_against_opencv(self, device):
        image = np.random.default_rng(0).random((37, 41), dtype=np.float32)
        kernel = np.ones((3, 3), dtype=np.float32)
        kernel[1, 1] = -8
        ours = K.filters.laplacian(torch.from_numpy(image)[None, None].to(device), 3, normalized=False)[0, 0].cpu()
        assert_close(ours, torch.from_numpy(cv2.filter2D(image, -1, kernel)), 1e-5, 1e-5)

    def test_flat_image_gives_zero(self, device):
        x = torch.full((1, 2, 12, 13), 0.25, device=device)
        for size in (3, 5, 9, (1, 3)):
            assert torch.equal(K.filters.laplacian(x, size), torch.zeros_like(x))

    def test_rounding_stays_that_of_one_window(self, device):
        x = 1000 + torch.rand(1, 1, 1080, 1920, device=device)
        for size in (3, 31):
            exact = K.filters.laplacian(x.double(), size)
            assert_close(K.filters.laplacian(x, size).double(), exact, 0, 1e-3)

    def test_nan_stays_inside_its_window(self, device):
        x = torch.rand(1, 1, 60, 70, device=device)
        x[0, 0, 30, 40] = float("nan")
        for r in (1, 2, 7):
            inside = torch.zeros_like(x, dtype=torch.bool)
            inside[..., 30 - r : 31 + r, 40 - r : 41 + r] = True
            assert torch.equal(K.filters.laplacian(x, 2 * r + 1).isnan(), inside)
