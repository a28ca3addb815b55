import kornia
import pytest
import scipy.ndimage
import skimage.data
import torch

import kvision as K
from kvision import _ops
from op_tests import OpTests, assert_close


class TestCanny(OpTests):
    function = staticmethod(K.filters.canny)
    module = K.filters.Canny
    compiler = "inductor"
    operators = (
        "color_program",
        "color_program_backward",
        "gaussian_blur2d",
        "gaussian_blur2d_backward",
        "canny_suppress",
        "sobel_backward",
        "canny_hysteresis",
    )
    variants = [
        {"hysteresis": False},
        {},
        {"low_threshold": 0.4, "high_threshold": 1.1},
        {"kernel_size": 3, "sigma": (0.8, 0.6)},
    ]

    def test_value_of_bytes(self, variant, device, backend):
        if variant.get("high_threshold", 0) <= 1:
            return super().test_value_of_bytes(variant, device, backend)
        with pytest.raises(
            ValueError, match="canny: expected low_threshold above 0 and up to high_threshold, got 102.0 and 1.1"
        ):
            self.call(*self.setup(variant, device, torch.uint8))

    # The direction of a gradient, which its derivative divides by the magnitude, loses digits where derivatives cancel.
    tolerances = {torch.float32: (1e-4, 1e-5)}
    errors = [
        (
            {"low_threshold": 0.5, "high_threshold": 0.1},
            ValueError,
            "expected low_threshold above 0 and up to high_threshold",
        ),
        ({"low_threshold": 0.0}, ValueError, "expected low_threshold above 0"),
        ({"low_threshold": float("nan")}, ValueError, "low_threshold"),
        ({"kernel_size": 4}, ValueError, "odd"),
    ]

    def check(self, actual, expected):
        """Ridges and thresholds are comparisons: rounding may turn a few of them, and each turn shows in both outputs."""
        (magnitude, edges), (expected_magnitude, expected_edges) = actual, expected
        assert (magnitude.dtype, magnitude.shape) == (expected_magnitude.dtype, expected_magnitude.shape)
        both = (magnitude > 0) & (expected_magnitude > 0)
        tolerance = {torch.float64: (1e-9, 1e-9), torch.float32: (1e-4, 1e-5)}.get(magnitude.dtype, (2e-2, 2e-2))
        assert_close(magnitude[both], expected_magnitude[both], *tolerance)
        turned = ((magnitude > 0) != (expected_magnitude > 0)).sum() + (edges != expected_edges).sum()
        assert turned <= (0 if magnitude.dtype == torch.float64 else 2 + edges.numel() // 100), int(turned)

    def test_vmap(self, variant, device, backend):
        self.needs_native_hysteresis(variant, backend)
        super().test_vmap(variant, device)

    def test_func_grad_and_jvp(self, variant, device, backend):
        self.needs_native_hysteresis(variant, backend)
        super().test_func_grad_and_jvp(variant, device)

    def needs_native_hysteresis(self, variant, backend):
        if variant.get("hysteresis", True):
            self.needs_native(backend)  # the reference looks at the edges, which vmap hides

    def test_wrong_channels(self, device):
        with pytest.raises(K.core.exceptions.ImageError, match="^canny: expected input with 1 or 3 channels"):
            K.filters.canny(torch.rand(1, 2, 8, 8, device=device))

    # Two channels are no Canny image: these tests of the shared suite use one or three.
    small = (1, 1, 5, 6)
    empty = ((0, 3),)

    def input(self, shape, dtype, device):
        b, c, *size = shape
        return super().input((b, c if c in (0, 3) else 1, *size), dtype, device)

    def test_against_kornia_on_photographs(self, device):
        photos = [
            skimage.data.astronaut()[:256, :256],
            skimage.data.coffee()[:256, :256],
            skimage.data.chelsea()[:256, :256],
        ]
        x = torch.stack([K.image_to_tensor(p) for p in photos]).float().div(255).to(device)
        for hysteresis in (False, True):
            magnitude, edges = K.filters.canny(x, hysteresis=hysteresis)
            expected_magnitude, expected_edges = kornia.filters.canny(x, hysteresis=hysteresis)
            assert (edges != expected_edges).float().mean() < 2e-3
            both = (magnitude > 0) & (expected_magnitude > 0)
            assert_close(magnitude[both], expected_magnitude[both], 1e-3, 1e-4)

    def test_edges_carry_no_gradient(self, device):
        magnitude, edges = K.filters.canny(torch.rand(1, 1, 8, 8, device=device, requires_grad=True))
        assert magnitude.requires_grad and not edges.requires_grad


class TestHysteresis:
    """The operator alone, against SciPy's labels."""

    def keep(self, edges):
        return _ops.operators["canny_hysteresis"](edges)

    def expected(self, plane):
        labels, _ = scipy.ndimage.label(plane > 0, structure=[[1] * 3] * 3)
        strong = set(labels[plane == 1]) - {0}
        return torch.from_numpy(sum(((labels == s) for s in strong), labels < 0)).float()

    @pytest.mark.parametrize("weak, strong", [(0.5, 0.01), (0.42, 0.002), (0.2, 0.2), (0.9, 0.001), (0.0, 0.3)])
    def test_random_edges(self, weak, strong, device):
        draw = torch.rand(3, 2, 61, 97)
        edges = 0.5 * (draw < weak + strong).float() + 0.5 * (draw < strong).float()
        kept = self.keep(edges.to(device)).cpu()
        for image, result in zip(edges.flatten(0, 1), kept.flatten(0, 1)):
            assert torch.equal(result, self.expected(image.numpy()))

    def test_a_long_chain(self, device):
        """A spiral of weak pixels with one strong end: half of the image hangs on one pixel."""
        n = 95
        edges = torch.zeros(n, n)
        y, x, dy, dx = 0, 0, 0, 1
        while True:
            edges[y, x] = 0.5
            ahead = (y + dy, x + dx, y + 2 * dy, x + 2 * dx)
            if not (0 <= ahead[0] < n and 0 <= ahead[1] < n) or (
                0 <= ahead[2] < n and 0 <= ahead[3] < n and edges[ahead[2], ahead[3]] > 0
            ):
                dy, dx = dx, -dy
                ny, nx = y + 2 * dy, x + 2 * dx
                if not (0 <= ny < n and 0 <= nx < n) or edges[ny, nx] > 0:
                    break
            y, x = y + dy, x + dx
        assert not self.keep(edges[None, None].to(device)).any()
        edges[0, 0] = 1
        assert torch.equal(self.keep(edges[None, None].to(device)).cpu()[0, 0], (edges > 0).float())

    @pytest.mark.parametrize("shape", [(1, 1, 1, 1), (2, 1, 1, 70), (1, 3, 70, 1), (0, 1, 4, 4)])
    def test_thin_images(self, shape, device):
        edges = torch.full(shape, 0.5, device=device)
        assert not self.keep(edges).any()
        if edges.numel():
            edges[..., -1, -1] = 1
            assert self.keep(edges).all()


def test_advice_for_small_images():
    message = r"canny: expected input .*, got \(1, 3, 2, 9\); use a smaller kernel_size for images this small"
    with pytest.raises(ValueError, match=message):
        K.filters.canny(torch.rand(1, 3, 2, 9))
    K.filters.canny(torch.rand(1, 3, 2, 9), kernel_size=3)


def test_thresholds_of_bytes(device):
    """At most 1 they are fractions of 255, above in bytes."""
    levels = torch.randint(0, 256, (1, 1, 24, 24), dtype=torch.uint8, device=device)
    _, edges = K.filters.canny(levels, 0.5, 1.0)
    _, expected = K.filters.canny(levels.float() / 255, 0.5, 1.0, eps=1e-6 / 255**2)
    assert torch.equal(edges, expected) and 0 < edges.mean() < 0.5
    assert torch.equal(K.filters.canny(levels, 127.5, 255.0)[1], edges)
    with pytest.raises(ValueError, match="low_threshold above 0 and up to high_threshold"):
        K.filters.canny(levels, 1.0, 100.0)
