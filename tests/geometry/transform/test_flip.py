"""Flips, of any type, and crops of whole pixels, which are copies by the same kernel."""

import pytest
import torch

import kvision as K
from kvision.geometry.transform.crop import _crop_pixels
from op_tests import OpTests, instruction_set

G = K.geometry


class FlipTests(OpTests):
    operators = ("flip",)
    bytes = True
    operator_dtype = torch.float16  # on the CPU floats are left to torch
    max_size = 7
    tolerances = dict.fromkeys((torch.float64, torch.float32, torch.float16, torch.bfloat16), (0, 0))
    axes: tuple[int, ...]

    def test_wrong_kinds(self, variant, device):
        name = self.function.__name__
        for wrong, error in [([[1.0]], TypeError), (None, TypeError), (torch.rand((), device=device), ValueError)]:
            with pytest.raises(error, match=f"^{name}: "):
                self.function(wrong)

    @pytest.mark.parametrize("dtype", [torch.int64, torch.int16, torch.bool, torch.uint8, torch.float64], ids=str)
    def test_other_integers_become_float32(self, variant, dtype, device):
        """Nothing becomes of them: flips are of any type, and of any number of axes."""
        for shape in [(2, 3, 5, 37), (2, 2, 3, 4, 5), (3, 64, 48), (4, 5), (1, 1, 0, 4)]:
            x = (torch.rand(shape, device=device) * 100).to(dtype)
            result = self.function(x)
            assert result.dtype == dtype and torch.equal(result, x.flip(self.axes))


class TestHflip(FlipTests):
    function = staticmethod(G.hflip)
    module = G.Hflip
    axes = (-1,)


class TestVflip(FlipTests):
    function = staticmethod(G.vflip)
    module = G.Vflip
    axes = (-2,)


class TestRot180(FlipTests):
    function = staticmethod(G.rot180)
    module = G.Rot180
    axes = (-2, -1)


class TestWindow(OpTests):
    """The operator behind crops of whole pixels and their gradients."""

    function = staticmethod(lambda x, corner, size: _crop_pixels(x, corner, size))
    operators = ("crop",)
    bytes = True
    max_size = 7
    variants = [{"corner": [0, -1], "size": [2, 5]}, {"corner": [-1, 0], "size": [9, 4]}]
    tolerances = FlipTests.tolerances
    test_wrong_kinds = test_other_integers_become_float32 = None  # of public functions


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
def test_integer_crops_are_slices(dtype, device):
    x = (torch.rand(2, 3, 40, 56, device=device) * 255).to(dtype)
    for size in ((8, 16), (20, 40), (2, 2), (18, 30), (40, 56)):
        h, w = size
        y0, x0 = (40 - h) // 2, (56 - w) // 2
        result = G.center_crop(x, size)
        assert torch.equal(result, x[..., y0 : y0 + h, x0 : x0 + w]) and result.is_contiguous()
        last = x.contiguous(memory_format=torch.channels_last)
        assert torch.equal(G.center_crop(last, size), result)
        if dtype != torch.uint8:
            x.requires_grad_()
            weights = torch.rand_like(result)
            (grad,) = torch.autograd.grad(G.center_crop(x, size), x, weights)
            x.requires_grad_(False)
            assert (
                torch.equal(grad[..., y0 : y0 + h, x0 : x0 + w], weights)
                and grad.count_nonzero() == weights.count_nonzero()
            )
    assert G.center_crop(x, (40, 56)).data_ptr() != x.data_ptr()


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_images_larger_than_caches(isa, device, backend):
    """The CPU writes them past its caches: whole vectors, from the first aligned address of a row on."""
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the CPU's kernels")
    with instruction_set(isa):
        for dtype in (torch.float32, torch.float64, torch.float16, torch.uint8):
            x = (torch.rand(1, 3, 1201, 1203) * 255).to(dtype)
            assert torch.equal(G.hflip(x), x.flip(-1)) and torch.equal(G.rot180(x), x.flip(-2, -1))


BAD = [
    (lambda: G.hflip(torch.ones(())), ValueError, r"hflip: expected input of shape \(\*, H, W\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_one_row(device):
    row = torch.arange(5.0, device=device)
    assert torch.equal(G.hflip(row), row.flip(0)) and torch.equal(G.rot180(row), row.flip(0))
    assert torch.equal(G.vflip(row), row)
    with pytest.raises(ValueError, match=r"hflip: expected input of shape \(\*, H, W\), got \(\)"):
        G.hflip(row[0])
