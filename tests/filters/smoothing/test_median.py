import cv2
import kornia
import numpy as np
import pytest
import scipy.ndimage
import torch

import kvision as K
from benchmarks.sample_calls.windows import variants
from op_tests import OpTests, assert_close

BORDERS = {"reflect": "mirror", "replicate": "nearest", "circular": "wrap", "constant": "constant"}


class TestMedianBlur(OpTests):
    function = staticmethod(K.filters.median_blur)
    module = K.filters.MedianBlur
    operators = ("median_blur", "median_blur_backward")
    bytes = True
    variants = variants("median_blur")
    errors = [
        ({"kernel_size": 0}, ValueError, "at least 1"),
        ({"kernel_size": 3.0}, TypeError, "kernel_size to be an int or 2 ints"),
        ({"border_type": "mirror"}, ValueError, "border_type must be one of"),
        ({"kernel_size": 39}, ValueError, "use border_type='replicate'"),
    ]

    @pytest.mark.parametrize("border", BORDERS)
    @pytest.mark.parametrize("size", [1, 3, 5, 7, (3, 5), (7, 1)], ids=str)
    def test_against_scipy_and_kornia(self, size, border, device):
        x = torch.rand(2, 2, 19, 23)
        ours = K.filters.median_blur(x.to(device), size, border)
        pair = (size, size) if isinstance(size, int) else size
        expected = scipy.ndimage.median_filter(x.numpy(), (1, 1, *pair), mode=BORDERS[border])
        assert torch.equal(ours.cpu(), torch.from_numpy(expected))
        assert torch.equal(ours.cpu(), kornia.filters.median_blur(x, size, border))

    @pytest.mark.parametrize("dtype, sizes", [(np.float32, [3, 5]), (np.uint8, [3, 5, 7, 13])])
    def test_against_opencv(self, dtype, sizes, device):
        image = (np.random.default_rng(0).random((67, 81, 3)) * 255).astype(dtype)
        x = torch.from_numpy(image).permute(2, 0, 1)[None].to(device)
        for size in sizes:
            expected = torch.from_numpy(cv2.medianBlur(image, size)).permute(2, 0, 1)[None]  # its border is replicate
            assert torch.equal(K.filters.median_blur(x, size, "replicate").cpu(), expected)

    @pytest.mark.parametrize("size", [3, 5, 7])
    def test_every_order_of_few_values(self, size, device):
        """Networks are right for all inputs if they are for zeros and ones."""
        x = (torch.rand(4, 4, 64, 64) < torch.rand(4, 1, 1, 1)).float()
        expected = scipy.ndimage.median_filter(x.numpy(), (1, 1, size, size), mode="mirror")
        assert torch.equal(K.filters.median_blur(x.to(device), size).cpu(), torch.from_numpy(expected))

    @pytest.mark.parametrize("size", [3, 5, 4, 7])
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.bfloat16], ids=str)
    def test_nan_and_infinity(self, size, dtype, device):
        x = torch.rand(1, 2, 40, 90).to(dtype)
        x[0, 0, 5:9, 10:13] = torch.inf
        x[0, 0, 20:30, 10:13] = -torch.inf
        x[0, 1, 17, 70] = torch.nan
        x[0, 1, 0, 0] = -torch.tensor(torch.nan)
        for border in BORDERS:
            ours = K.filters.median_blur(x.to(device), size, border)
            assert not ours[0, 0].isnan().any()
            before, after = (size - 1) // 2, size // 2
            window = ours[0, 1, 17 - after : 18 + before, 70 - after : 71 + before]
            assert window.isnan().all()
            with K.backend("reference"):
                assert_close(ours, K.filters.median_blur(x.to(device), size, border), 0, 0)

    @pytest.mark.large
    @pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.uint8], ids=str)
    @pytest.mark.parametrize("width", [264, 257])
    @pytest.mark.parametrize("size", [3, 5])
    def test_many_images_of_small_types(self, size, width, dtype, device):
        """The values of float32: on CUDA pixels of these types are sorted in pairs, those of many images in wider strips."""
        x = (torch.rand(96, 3, 70, width, device=device) * 255).to(dtype)
        if dtype.is_floating_point:
            x[::7, 1, 33, 255:] = torch.nan
        expected = K.filters.median_blur(x.float(), size).to(dtype)
        assert_close(K.filters.median_blur(x, size), expected, 0, 0)

    @pytest.mark.parametrize("border", BORDERS)
    @pytest.mark.parametrize("size", [3, 5, 4, (2, 7)], ids=str)
    def test_ties_share_the_gradient_evenly(self, size, border, device):
        for shape in ((1, 2, 9, 11), (1, 1, 70, 75)):
            x = torch.randint(-1, 2, shape, device=device).float()
            self.check_gradients(x, {"kernel_size": size, "border_type": border})

    def test_gradient_of_a_flat_image(self, device):
        x = torch.ones(1, 1, 8, 8, device=device, requires_grad=True)
        K.filters.median_blur(x, 3, "circular").sum().backward()
        assert_close(x.grad, torch.ones_like(x))

    def test_gradient_goes_to_the_median(self, device):
        x = torch.tensor([[[[1.0, 9.0, 2.0, 3.0, 3.0]]]], device=device, requires_grad=True)
        y = K.filters.median_blur(x, (1, 3), "replicate")
        assert y.flatten().tolist() == [1, 2, 3, 3, 3]
        y.backward(torch.tensor([[[[1.0, 2.0, 4.0, 8.0, 16.0]]]], device=device))
        # the first window is 1 1 9: its pixel takes both shares of 1/2; the fourth is 2 3 3, the fifth 3 3 3
        assert_close(x.grad.flatten().cpu(), torch.tensor([1.0, 0, 2, 4 + 4 + 16 / 3, 4 + 32 / 3]))

    def test_infinities_have_a_gradient(self, device):
        x = torch.full((1, 1, 5, 5), -torch.inf, device=device)
        self.check_gradients(x, {"kernel_size": 3, "border_type": "replicate"})
        self.check_gradients(-x, {"kernel_size": 3, "border_type": "replicate"})
