import torch

import kvision as K
from benchmarks.sample_calls.windows import variants
from op_tests import OpTests, assert_close


class TestUnsharpMask(OpTests):
    function = staticmethod(K.filters.unsharp_mask)
    module = K.filters.UnsharpMask
    operators = ("unsharp_mask", "unsharp_mask_backward", "filter2d_separable_weights_backward")
    bytes = True
    small = (1, 2, 5, 6)
    tolerances = {torch.uint8: (0, 1)}  # a sum in another order may fall on the other side of a half
    variants = variants("unsharp_mask")
    errors = [
        ({"kernel_size": (3, 2)}, ValueError, "expected kernel_size to be odd"),
        ({"sigma": -1.0}, ValueError, "positive"),
        ({"border_type": "mirror"}, ValueError, "border_type must be one of"),
    ]

    def test_is_twice_the_image_less_its_blur(self, device):
        x = torch.rand(2, 3, 40, 150, device=device)
        for size in (3, 7, 31, 33):
            blurred = K.filters.gaussian_blur2d(x, size, 2.0)
            assert_close(K.filters.unsharp_mask(x, size, 2.0), 2 * x - blurred)

    def test_infinite_pixel_stays_in_its_window(self, device):
        x = torch.zeros(1, 1, 15, 15, device=device)
        x[..., 7, 7] = float("inf")
        wrong = ~K.filters.unsharp_mask(x, 5, 1.0).isfinite()
        assert wrong.sum() == 25 and wrong[..., 5:10, 5:10].all()
