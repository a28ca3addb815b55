"""Warps that make their matrices themselves: the operators, and that they give what a matrix and a warp do."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.transform import matrices, sampling, warp3d
from op_tests import assert_close, recorded
from warp_tests import WarpTests, one

G = K.geometry
HOW, HOW3 = ("bilinear", "fill", True, True, False), ("bilinear", "border", True, False, False)
QUADS = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])
CUBE = torch.tensor([[0.0, 1, 1, 0] * 2, [0.0, 0, 1, 1] * 2, [0.0] * 4 + [1.0] * 4]).T[None]


def degrees(x: Tensor) -> Tensor:
    return 23.7 + 11.3 * torch.arange(len(x), dtype=torch.float64)


def point(x: Tensor) -> Tensor:
    return torch.tensor([[5.31, 3.17]], dtype=torch.float64) + torch.arange(len(x))[:, None]


def middle(x: Tensor) -> Tensor:
    return torch.tensor([[2.31, 1.17, 0.61]], dtype=torch.float64)


class ByFormulaTests(WarpTests):
    def test_opcheck(self, device, backend):
        """Of the operator alone: those of its gradient are checked where they are tested."""
        self.needs_native(backend)
        x, kwargs = self.setup(self.variants[0], device, torch.float32)
        with recorded() as calls:
            self.call(x, kwargs)
        for name, args in calls:
            torch.library.opcheck(getattr(torch.ops.kvision, name).default, (args[0].requires_grad_(), *args[1:]))


class TestRotate(ByFormulaTests):
    function = staticmethod(G.rotate)
    operators = (
        *("warp_by_formula", "warp_image_gradient", "warp_matrix_gradient"),
        *("affine_matrix2d", "affine_matrix2d_backward"),
    )
    max_size = 7
    variants = [
        {"angle": one(degrees)},
        {"angle": degrees, "center": one(point), "mode": "bicubic", "padding_mode": "border"},
    ]
    errors = [
        ({"angle": lambda x: torch.ones(3)}, ValueError, "expected angle with 1 or 2 rows"),
        ({"angle": 3.0}, TypeError, "angle to be a Tensor"),
        ({"center": lambda x: torch.ones(2, 3)}, ValueError, r"expected center of shape \(B, 2\)"),
        ({"mode": "linear"}, ValueError, "mode must be one of bilinear, nearest, bicubic; got 'linear'"),
    ]


class TestRotate3d(ByFormulaTests):
    function = staticmethod(G.rotate3d)
    operators = (
        *("warp3d_by_formula", "warp3d_volume_gradient", "warp3d_matrix_gradient"),
        *("affine_matrix3d", "affine_matrix3d_backward"),
    )
    bytes = False
    variants = [{"yaw": one(degrees), "pitch": degrees, "roll": one(degrees), "center": middle}]
    shape = (2, 3, 4, 9, 11)
    small = (1, 1, 3, 4, 3)
    max_size = 3


def numbers(*sizes: int) -> Tensor:
    return torch.rand(sizes) + 0.5


CALLS = {
    "affine_matrix2d": ([30 * numbers(2), numbers(1, 2), numbers(2, 2), None, numbers(2), None], [1.0, 3.5, 2.0]),
    "translation_matrix2d": ([numbers(2, 2)], [0.25, -0.5]),
    "scale_matrix2d": ([numbers(1, 2), None], [3.5, 2.0]),
    "slant_matrix2d": ([numbers(2, 2)], []),
    "crop_matrix": ([QUADS, numbers(2, 2)], [4.0, 3.0]),
    "affine_matrix3d": ([30 * numbers(2), 30 * numbers(1), 30 * numbers(2), None, numbers(1, 3), None], [1.0, 3.0, 2.0, 2.0]),
    "translation_matrix3d": ([numbers(2, 3)], [0.25, -0.5, 1.0]),
    "perspective_matrix3d": ([3 * CUBE + 0.2 * numbers(2, 8, 3), None], [4.0, 3.0, 2.0]),
}  # fmt: skip
ROWS = {"affine_matrix2d": (2,), "translation_matrix2d": (2,), "affine_matrix3d": (3,), "translation_matrix3d": (3,)}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("name", CALLS)
def test_gives_what_a_matrix_and_a_warp_do(name, dtype, device):
    """The same bits on the CPU; on CUDA the compiler may round a sum of double numbers otherwise."""
    tensors, plain = CALLS[name]
    wide = torch.float64 if dtype == torch.float64 else torch.float32
    given = [None if x is None else x.to(wide).to(device) for x in tensors]
    formula = getattr(matrices, name)
    rest = [None] * (6 - len(given))
    shears = [None] * (6 if name == "affine_matrix3d" else 0)
    matrix = formula(*given, *shears, *plain, *ROWS.get(name, ()))
    if name.endswith("3d"):
        if dtype == torch.uint8:
            pytest.skip("volumes are numbers")
        x = torch.rand(2, 2, 4, 5, 6).to(dtype).to(device)
        expected = warp3d._warp3d(x, matrix, [5, 4, 7], *HOW3)
        found = warp3d._warp3d_by_formula(x, *given, *rest, name, plain, [5, 4, 7], *HOW3)
    else:
        x = (torch.rand(2, 3, 8, 9) * (255 if dtype == torch.uint8 else 1)).to(dtype).to(device)
        expected = sampling.warp(x, matrix, None, [7, 10], *HOW)
        found = sampling.warp_by_formula(x, *given, *rest, name, plain, [7, 10], *HOW)
    if device.type == "cpu":
        assert torch.equal(found, expected)
    else:
        assert_close(found, expected)


@pytest.mark.parametrize("channels_last", [False, True])
def test_crops_between_pixels_and_their_gradient(channels_last, device):
    """Of numbers alone, without a tensor of the formula."""
    x = torch.rand(2, 3, 6, 7, dtype=torch.float64, device=device)
    if channels_last:
        x = x.contiguous(memory_format=torch.channels_last)
    x.requires_grad_()
    mean = (x[..., :-1, :] + x[..., 1:, :]) / 2
    expected = ((mean[..., :-1] + mean[..., 1:]) / 2)[..., 1:4, 1:5]
    found = G.center_crop(x, (3, 4))
    assert_close(found, expected)
    weight = torch.rand_like(found)
    for ours, theirs in zip(*(torch.autograd.grad((y * weight).sum(), x) for y in (found, expected))):
        assert_close(ours, theirs)
    volume = x[:1, :1, None].detach().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda v: G.center_crop3d(v, (1, 2, 2)), volume, nondet_tol=1e-12
    )  # sums by atomics


@pytest.mark.parametrize("wrong", ["", "warp", "perspective_matrix3d", "perspective_matrix", "affine_matrix2d "])
def test_unknown_formulas(wrong, device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x = torch.rand(1, 1, 4, 4, device=device)
    with pytest.raises(RuntimeError, match="warp_by_formula: no formula of images is called"):
        torch.ops.kvision.warp_by_formula(x, x[:, 0, 0, :2], *[None] * 5, wrong, [], [4, 4], *HOW)


@pytest.mark.parametrize(
    "given, plain, message",
    [
        ([(1, 2), (1, 2)], [0.0, 0.0], "expected 0 to 1 tensors"),
        ([(1, 3)], [0.0, 0.0], r"expected tensor 1 of shape \(B, 2\)"),
        ([(3, 2)], [0.0, 0.0], "expected tensors with 1 or 2 rows, got 3"),
        ([(1, 2)], [0.0], "expected 2 numbers, got 1"),
        ([(1, 2)], [0.0] * 9, "expected 2 numbers, got 9"),
    ],
)
def test_wrong_inputs_of_a_formula(given, plain, message, device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    tensors = [torch.ones(s, device=device) for s in given]
    six = [*tensors, *[None] * (6 - len(tensors))]
    with pytest.raises(RuntimeError, match="^warp_by_formula: " + message):
        torch.ops.kvision.warp_by_formula(
            torch.rand(2, 1, 4, 4, device=device), *six, "translation_matrix2d", plain, [4, 4], *HOW
        )
