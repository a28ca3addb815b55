import kornia
import pytest
import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls.windows import variants
from op_tests import OpTests, assert_close

OPERATORS = ("bilateral_blur", "bilateral_blur_backward", "bilateral_blur_sigma_sums")


def sigma_color(x: Tensor) -> Tensor:
    return torch.linspace(0.2, 0.5, x.shape[0])


def sigma_space(x: Tensor) -> Tensor:
    return torch.tensor([[1.5, 0.8]])


class TestBilateralBlur(OpTests):
    function = staticmethod(K.filters.bilateral_blur)
    module = K.filters.BilateralBlur
    operators = OPERATORS
    bytes = True
    max_size = 17  # two vectors of AVX2 and one pixel; windows reach four pixels
    tolerances = {torch.uint8: (0, 1)}  # a sum in another order may fall on the other side of a half
    variants = variants("bilateral_blur")
    errors = [
        ({"kernel_size": 4}, ValueError, "kernel_size to be odd"),
        ({"kernel_size": "5"}, TypeError, "kernel_size"),
        ({"sigma_color": 0.0}, ValueError, "sigma_color"),
        ({"sigma_color": float("nan")}, ValueError, "sigma_color"),
        ({"sigma_color": "0.1"}, TypeError, "sigma_color"),
        ({"sigma_color": lambda x: torch.ones(5)}, ValueError, "sigma_color with a batch size of 1 or 2"),
        ({"sigma_space": -1.0}, ValueError, "sigma_space"),
        ({"sigma_space": lambda x: torch.ones(1, 3)}, ValueError, "sigma_space"),
        ({"border_type": "mirror"}, ValueError, "border_type must be one of"),
        ({"kernel_size": 41}, ValueError, "larger than its 'reflect' border"),
        ({"color_distance_type": "l3"}, ValueError, "color_distance_type must be one of l1, l2; got 'l3'"),
    ]

    @pytest.mark.parametrize("channels", [1, 2, 4, 7])
    @pytest.mark.parametrize("distance", ["l1", "l2"])
    def test_any_number_of_channels(self, channels, distance, device):
        x = torch.rand(2, channels, 11, 21, device=device)
        self.check_gradients(
            x, {"kernel_size": 5, "sigma_color": 0.4, "sigma_space": 1.5, "color_distance_type": distance}
        )

    @pytest.mark.parametrize("kernel_size", [1, (1, 9), (31, 3), (13, 33)])
    def test_sizes_of_the_window(self, kernel_size, device):
        x = torch.rand(1, 3, 40, 37, device=device)
        kwargs = {"kernel_size": kernel_size, "sigma_color": 0.4, "sigma_space": 3.0}
        self.check(self.call(x, kwargs), self.expected(x, kwargs))
        self.check_gradients(x, kwargs)

    def test_wide_images(self, device):
        """Wider than a tile of the GPU and a strip of any CPU."""
        x = torch.rand(1, 3, 37, 300, device=device)
        kwargs = {"kernel_size": 5, "sigma_color": 0.4, "sigma_space": 1.5}
        self.check(self.call(x, kwargs), self.expected(x, kwargs))
        self.check_gradients(x, kwargs)

    def test_sigmas_that_are_not_positive_spoil_their_images(self, device):
        x = torch.rand(2, 3, 8, 9, device=device)
        y = K.filters.bilateral_blur(x, 3, torch.tensor([0.1, -0.1], device=device), (1.0, 1.0))
        assert y[0].isfinite().all() and y[1].isnan().all()
        y = K.filters.bilateral_blur(x, 3, 0.1, torch.tensor([[1.0, 0.0], [1.0, 1.0]], device=device))
        assert y[0].isnan().all() and y[1].isfinite().all()

    def test_tiny_sigma_color_keeps_the_image(self, device):
        x = torch.rand(1, 3, 8, 9, device=device)
        assert_close(K.filters.bilateral_blur(x, 5, 1e-30, (1.5, 1.5)), x)

    def test_numbers_and_tensors_agree(self, device):
        x = torch.rand(2, 3, 9, 10, device=device)
        numbers = K.filters.bilateral_blur(x, 5, 0.25, (1.5, 0.75))
        color, space = torch.tensor([0.25], device=device), torch.tensor([[1.5, 0.75]], device=device)
        assert_close(K.filters.bilateral_blur(x, 5, color, space), numbers)

    @pytest.mark.parametrize("distance", ["l1", "l2"])
    @pytest.mark.parametrize("border", ["reflect", "replicate", "constant", "circular"])
    def test_against_kornia(self, border, distance, device):
        x = torch.rand(2, 3, 21, 30, device=device)
        args = (x, (5, 7), 0.2, (1.5, 1.1), border, distance)
        assert_close(K.filters.bilateral_blur(*args), kornia.filters.bilateral_blur(*args))

    def test_second_derivatives_in_float32(self, device):
        """Where a GPU's gradient reads the totals that the forward pass kept."""
        x = torch.rand(1, 3, 9, 10, device=device, requires_grad=True)

        def second() -> Tensor:
            y = K.filters.bilateral_blur(x, 5, 0.3, (1.5, 1.1))
            (gradient,) = torch.autograd.grad(y.square().sum(), x, create_graph=True)
            return torch.autograd.grad(gradient.square().sum(), x)[0]

        with K.backend("reference"):
            expected = second()
        assert_close(second(), expected, 1e-4, 1e-4 * float(expected.abs().max()))

    def test_bytes_are_the_rounded_float_result(self, device):
        x = torch.randint(0, 256, (2, 3, 21, 30), dtype=torch.uint8, device=device)
        wide = K.filters.bilateral_blur(x.double(), 5, 30.0, (1.5, 1.5))
        difference = (K.filters.bilateral_blur(x, 5, 30.0, (1.5, 1.5)).double() - wide).abs()
        assert difference.max() <= 0.5 + 1e-4


class TestJointBilateralBlur(OpTests):
    function = staticmethod(K.filters.joint_bilateral_blur)
    module = K.filters.JointBilateralBlur
    forward_arguments = ("guidance",)
    operators = OPERATORS
    bytes = True
    max_size = 17  # two vectors of AVX2 and one pixel; windows reach four pixels
    tolerances = {torch.uint8: (0, 1)}  # a sum in another order may fall on the other side of a half
    variants = [
        {"guidance": lambda x: guide(x, 3), "kernel_size": 5, "sigma_color": 0.3, "sigma_space": (1.5, 1.0)},
        {
            "guidance": lambda x: guide(x, 1),
            "kernel_size": (3, 5),
            "sigma_color": 0.3,
            "sigma_space": 1.5,
            "border_type": "circular",
            "color_distance_type": "l2",
        },
        {
            "guidance": lambda x: guide(x, 2),
            "kernel_size": 3,
            "sigma_color": sigma_color,
            "sigma_space": sigma_space,
            "border_type": "replicate",
        },
    ]


def guide(x: Tensor, channels: int) -> Tensor:
    return torch.rand(x.shape[0], channels, *x.shape[2:])
