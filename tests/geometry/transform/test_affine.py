"""Warps that compute their matrices: the operators, and their results against a matrix and a warp."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision._modes import INTERPOLATION, PADDING, WARP_FORMULA
from kvision.geometry.transform import matrices, sampling, warp3d
from op_tests import assert_close
from warp_tests import FormulaWarpTests, degrees, one, point

G = K.geometry
OPTIONS = INTERPOLATION["bilinear"], PADDING["fill"], True, True, False
OPTIONS3 = INTERPOLATION["bilinear"], PADDING["border"], True, False, False
QUADS = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])
CUBE = torch.tensor([[0.0, 1, 1, 0] * 2, [0.0, 0, 1, 1] * 2, [0.0] * 4 + [1.0] * 4]).T[None]


class TestRotate(FormulaWarpTests):
    function = staticmethod(G.rotate)
    operators = (
        *("warp_by_formula", "warp_image_backward", "warp_matrix_backward"),
        *("affine_matrix2d", "affine_matrix2d_backward"),
    )
    max_size = 7
    variants = [
        {"angle": one(degrees)},
        {"angle": degrees, "center": one(point), "mode": "bicubic", "padding_mode": "border"},
    ]
    errors = [
        ({"angle": lambda x: torch.ones(3)}, ValueError, "expected angle with a batch size of 1 or 2"),
        ({"angle": "3"}, TypeError, "angle to be a Tensor, or a number"),
        ({"center": lambda x: torch.ones(2, 3)}, ValueError, r"expected center of shape \(B, 2\)"),
        ({"mode": "linear"}, ValueError, "mode must be one of bilinear, nearest, bicubic; got 'linear'"),
    ]


def numbers(*sizes: int) -> Tensor:
    return torch.rand(sizes) + 0.5


CALLS = {
    "affine_matrix2d": ([30 * numbers(2), numbers(1, 2), numbers(2, 2), None, numbers(2), None], [1.0, 3.5, 2.0]),
    "translation_matrix2d": ([numbers(2, 2)], [0.25, -0.5]),
    "scale_matrix2d": ([numbers(1, 2), None], [3.5, 2.0]),
    "shear_factor_matrix2d": ([numbers(2, 2)], []),
    "crop_matrix": ([QUADS, numbers(2, 2)], [4.0, 3.0]),
    "affine_matrix3d": ([30 * numbers(2), 30 * numbers(1), 30 * numbers(2), None, numbers(1, 3), None], [1.0, 3.0, 2.0, 2.0]),
    "translation_matrix3d": ([numbers(2, 3)], [0.25, -0.5, 1.0]),
    "perspective_matrix3d": ([3 * CUBE + 0.2 * numbers(2, 8, 3), None], [4.0, 3.0, 2.0]),
}  # fmt: skip
ROWS = {"affine_matrix2d": (2,), "translation_matrix2d": (2,), "affine_matrix3d": (3,), "translation_matrix3d": (3,)}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("name", CALLS)
def test_equals_a_warp_by_its_matrix(name, dtype, device):
    """The same bits on the CPU; on CUDA the compiler may round a sum of double numbers otherwise."""
    tensors, plain = CALLS[name]
    wide = torch.float64 if dtype == torch.float64 else torch.float32
    inputs = [None if x is None else x.to(wide).to(device) for x in tensors]
    formula = getattr(matrices, name)
    rest = [None] * (6 - len(inputs))
    shears = [None] * (6 if name == "affine_matrix3d" else 0)
    matrix = formula(*inputs, *shears, *plain, *ROWS.get(name, ()))
    if name.endswith("3d"):
        if dtype == torch.uint8:
            pytest.skip("volumes are numbers")
        x = torch.rand(2, 2, 4, 5, 6).to(dtype).to(device)
        expected = warp3d._warp3d(x, matrix, [5, 4, 7], *OPTIONS3)
        result = warp3d._warp3d_by_formula(x, *inputs, *rest, WARP_FORMULA[name], plain, [5, 4, 7], *OPTIONS3)
    else:
        x = (torch.rand(2, 3, 8, 9) * (255 if dtype == torch.uint8 else 1)).to(dtype).to(device)
        expected = sampling.warp(x, matrix, None, None, [7, 10], *OPTIONS)
        result = sampling.warp_by_formula(x, *inputs, *rest, None, WARP_FORMULA[name], plain, [7, 10], *OPTIONS)
    if device.type == "cpu":
        assert torch.equal(result, expected)
    else:
        assert_close(result, expected)


@pytest.mark.parametrize("channels_last", [False, True])
def test_crops_between_pixels_and_their_gradient(channels_last, device):
    """Of numbers alone, without a tensor of the formula."""
    x = torch.rand(2, 3, 6, 7, dtype=torch.float64, device=device)
    if channels_last:
        x = x.contiguous(memory_format=torch.channels_last)
    x.requires_grad_()
    mean = (x[..., :-1, :] + x[..., 1:, :]) / 2
    expected = ((mean[..., :-1] + mean[..., 1:]) / 2)[..., 1:4, 1:5]
    result = G.center_crop(x, (3, 4))
    assert_close(result, expected)
    weight = torch.rand_like(result)
    for ours, theirs in zip(*(torch.autograd.grad((y * weight).sum(), x) for y in (result, expected))):
        assert_close(ours, theirs)
    volume = x[:1, :1, None].detach().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda v: G.center_crop3d(v, (1, 2, 2)), volume, nondet_tol=1e-12
    )  # sums by atomics


@pytest.mark.parametrize("wrong", [0, WARP_FORMULA["perspective_matrix3d"], 9, -1, 2**32 + 1])
def test_unknown_formulas(wrong, device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x = torch.rand(1, 1, 4, 4, device=device)
    with pytest.raises(RuntimeError, match="warp_by_formula: no formula of images has the number"):
        torch.ops.kvision.warp_by_formula(x, x[:, 0, 0, :2], *[None] * 6, wrong, [], [4, 4], *OPTIONS)


@pytest.mark.parametrize(
    "shapes, plain, message",
    [
        ([(1, 2), (1, 2)], [0.0, 0.0], "expected 0 to 1 tensors"),
        ([(1, 3)], [0.0, 0.0], r"expected tensor 1 of shape \(B, 2\)"),
        ([(3, 2)], [0.0, 0.0], "expected tensors with 1 or 2 rows, got 3"),
        ([(1, 2)], [0.0], "expected 2 scalars, got 1"),
        ([(1, 2)], [0.0] * 9, "expected 2 scalars, got 9"),
    ],
)
def test_wrong_inputs_of_a_formula(shapes, plain, message, device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    tensors = [torch.ones(s, device=device) for s in shapes]
    seven = [*tensors, *[None] * (7 - len(tensors))]  # with the index of images
    with pytest.raises(RuntimeError, match="^warp_by_formula: " + message):
        torch.ops.kvision.warp_by_formula(
            torch.rand(2, 1, 4, 4, device=device), *seven, WARP_FORMULA["translation_matrix2d"], plain, [4, 4], *OPTIONS
        )


QUAD = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])


@pytest.mark.parametrize("turns", range(-5, 6))
def test_quarter_turns_are_exact(turns, device):
    x = torch.rand(1, 2, 33, 33, device=device)
    assert torch.equal(G.rotate(x, torch.tensor([90.0 * turns], device=device)), x.rot90(turns, (2, 3)))


def test_numbers_are_parameters_of_all_images(device: torch.device) -> None:
    x = torch.rand(2, 3, 5, 6, dtype=torch.float64, device=device)

    def rows(*numbers: float) -> torch.Tensor:
        return torch.tensor([numbers], dtype=torch.float64, device=device)

    assert torch.equal(G.rotate(x, 31.7), G.rotate(x, rows(31.7)[0]))
    assert torch.equal(G.rotate(x, np.float32(30), (1, 2.5)), G.rotate(x, rows(30.0)[0], rows(1.0, 2.5)))
    assert torch.equal(G.translate(x, (1.3, -2)), G.translate(x, rows(1.3, -2.0)))
    assert torch.equal(G.scale(x, 1.7), G.scale(x, rows(1.7, 1.7)))
    assert torch.equal(G.scale(x[0], [1.7, 0.8]), G.scale(x[0], rows(1.7, 0.8)))
    assert torch.equal(G.shear(x, (0.3, 0.1)), G.shear(x, rows(0.3, 0.1)))
    assert torch.equal(G.Rotate(31.7)(x.float()), G.rotate(x.float(), 31.7))
    for module, call in (
        (G.Scale(1.7), G.scale(x, 1.7)),
        (G.Shear((0.3, 0.1)), G.shear(x, (0.3, 0.1), align_corners=True)),
    ):
        assert torch.equal(module.to(device)(x), call)


def test_images_and_single_images(device):
    x = torch.rand(2, 3, 7, 8, device=device)
    one = torch.tensor([[1.5, -0.5]], device=device)
    assert_close(G.translate(x, one)[1], G.translate(x[1], one[0]))
    assert_close(G.rotate(x, torch.tensor(20.0, device=device))[0], G.rotate(x[0], torch.tensor([20.0], device=device)))
    assert_close(G.scale(x, torch.tensor([2.0], device=device)), G.scale(x, torch.full((2, 2), 2.0, device=device)))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.uint8, torch.int32], ids=str)
def test_types(dtype, device):
    x = (torch.rand(1, 3, 12, 14, device=device) * 200).to(dtype)
    wide = x.float()
    stored = dtype if dtype != torch.int32 else torch.float32
    angle, box = torch.tensor([25.0], device=device), 2 * QUAD.to(device)
    for call in (
        lambda s: G.rotate(s, angle),
        lambda s: G.resize(s, (5, 20)),
        lambda s: G.crop_and_resize(s, box, (6, 6)),
        lambda s: G.center_crop(s, (5, 8)),
        lambda s: G.elastic_transform2d(s, torch.zeros(1, 2, 12, 14, device=device) + 0.1, (3, 3), (1.0, 1.0)),
    ):
        result = call(x)
        expected = call(wide)
        assert result.dtype == stored
        if dtype == torch.uint8:
            # Fixed point rounds to another level only next to the middle of two.
            assert (result.float() - expected).abs().max() <= 0.53
        else:
            assert_close(result, expected.to(stored))


IMAGE = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1)).double()
FUNCTIONS = {
    "rotate": (lambda x, a: G.rotate(x, a), (IMAGE, torch.tensor([17.0]))),
    "scale": (lambda x, s: G.scale(x, s), (IMAGE, torch.tensor([[1.27, 0.83]]))),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.rotate([1.0], torch.ones(1)), TypeError, "rotate: expected tensor to be a Tensor, got list"),
    (lambda: G.rotate(X[0, 0], torch.ones(1)), ValueError, r"rotate: expected tensor of shape \(B, C, H, W\)"),
    (lambda: G.rotate(X, torch.ones(3)), ValueError, "rotate: expected angle with a batch size of 1 or 2"),
    (lambda: G.translate(X, torch.ones(2, 3)), ValueError, r"translate: expected translation of shape \(B, 2\)"),
    (lambda: G.scale(X, "2"), TypeError, "scale: expected scale_factor to be a Tensor, or two numbers or one, got str"),
    (lambda: G.rotate(X, [30.0]), TypeError, "rotate: expected angle to be a Tensor, or a number, got list"),
    (lambda: G.rotate(X, True), TypeError, "rotate: expected angle to be a Tensor, or a number, got bool"),
    (lambda: G.translate(X, 3.0), TypeError, "translate: expected translation to be a Tensor, or two numbers, got float"),
    (lambda: G.shear(X, (1.0, "2")), TypeError, "shear: expected shear to be a Tensor, or two numbers, got tuple"),
    (lambda: G.shear(X, torch.ones(2, 2), "linear"), ValueError, "shear: mode must be one of"),
    (lambda: G.affine(X, torch.eye(3)[None]), ValueError, r"affine: expected matrix of shape \(B, 2, 3\)"),
    (lambda: G.Affine(), RuntimeError, "Affine: expected at least one of"),
    (lambda: G.Affine(torch.ones(1), torch.ones(2, 2)), RuntimeError, "Affine: expected parameters of one batch size"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_one_image_with_many_matrices(device):
    image, matrices_ = torch.rand(1, 3, 5, 6, device=device), torch.rand(8, 2, 3, device=device)
    expected = torch.cat([G.affine(image, m[None]) for m in matrices_])
    assert_close(G.affine(image, matrices_), expected)
    assert_close(G.affine(image[0], matrices_), expected)
