"""Formulas: the operators that make a small matrix or vector of a sample, each against its reference."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

import kvision as K
import raw_calls
from composition_tests import on
from kvision import _ops
from op_tests import TOLERANCES, assert_close, instruction_set

SOURCE = Path(__file__).parents[2] / "csrc/geometry/formulas.h"
SQUARE = torch.tensor([[0.0, 0], [4, 0], [4, 3], [0, 3]], dtype=torch.float64)
CUBE = torch.tensor([[0.0, 1, 1, 0] * 2, [0.0, 0, 1, 1] * 2, [0.0] * 4 + [1.0] * 4], dtype=torch.float64).T
BATCH = 3


class Formula(NamedTuple):
    inputs: tuple[Callable[[], Tensor] | None, ...]  # each makes a row; None is not given
    plain: tuple[Any, ...] = ()


def vector(*sizes: int, scale: float = 1.0) -> Callable[[], Tensor]:
    """Numbers in [0.1, 1), scaled."""
    return lambda: scale * (0.9 * torch.rand(sizes, dtype=torch.float64) + 0.1)


def near(x: Tensor) -> Callable[[], Tensor]:
    return lambda: x + 0.2 * torch.rand_like(x)


NUMBER, DEGREES, SMALL = vector(), vector(scale=100), vector(scale=0.3)
EYE, EYE34 = torch.eye(3, dtype=torch.float64), torch.eye(3, 4, dtype=torch.float64)
FORMULAS = {
    "axis_angle_to_rotation_matrix": [Formula((vector(3, scale=2),))],
    "quaternion_exponential": [Formula((vector(3),), (0.5,))],
    "quaternion_to_axis_angle": [Formula((vector(4),))],
    "quaternion_logarithm": [Formula((vector(4),))],
    "quaternion_product": [Formula((vector(4),) * 2)],
    "normalize_quaternion": [Formula((vector(4),), (1e-12,)), Formula((vector(4),), (3.0,))],
    "quaternion_to_rotation_matrix": [Formula((vector(4),))],
    "rotation_matrix_to_quaternion": [Formula((near(EYE),)), Formula((near(-EYE),))],
    "cross_matrix": [Formula((vector(3),))],
    "compose_poses": [Formula((vector(4, 4),) * 2)],
    "invert_pose": [Formula((vector(4, 4),))],
    "relative_pose": [Formula((vector(4, 4),) * 2)],
    "rotation_matrix_to_axis_angle": [Formula((near(EYE),))],
    "angle_to_rotation_matrix": [Formula((DEGREES,))],
    "quaternion_from_euler": [Formula((NUMBER,) * 3)],
    "euler_from_quaternion": [Formula((NUMBER,) * 4)],
    "shear_matrix2d": [Formula((vector(2), SMALL, SMALL)), Formula((vector(2), None, SMALL))],
    "invert_affine2d": [Formula((near(EYE[:2]),))],
    "shear_matrix3d": [Formula((vector(3), *[SMALL] * 6)), Formula((vector(3), *[None] * 5, SMALL))],
    "perspective_matrix": [Formula((near(SQUARE), near(SQUARE)))],
    "quad_shapes": [Formula((near(SQUARE), near(SQUARE)))],
    "essential_from_fundamental": [Formula((vector(3, 3),) * 3)],
    "fundamental_from_essential": [Formula((vector(3, 3), near(EYE), near(EYE)))],
    "fundamental_from_projections": [Formula((vector(3, 4),) * 2)],
    "camera_motion": [Formula((vector(3, 3), vector(3, 1)) * 2)],
    "essential_from_motions": [Formula((vector(3, 3), vector(3, 1)) * 2)],
    "camera_of_projection": [Formula((near(EYE34),)), Formula((near(-EYE34),))],
    "affine_matrix2d": [
        Formula((DEGREES, vector(2), vector(2), SMALL, SMALL, vector(2)), (-1.0, 0.0, 0.0, 3)),
        Formula((DEGREES, None, vector(2), None, SMALL, None), (1.0, 3.5, 2.0, 2)),
        Formula((DEGREES, None, None, None, None, None), (1.0, 3.5, 2.0, 2)),
    ],
    "translation_matrix2d": [Formula((vector(2),), (0.0, 0.0, 2)), Formula((vector(2),), (0.5, -1.5, 3))],
    "scale_matrix2d": [Formula((vector(2), vector(2)), (0.0, 0.0)), Formula((vector(2), None), (3.5, 2.0))],
    "slant_matrix2d": [Formula((vector(2),))],
    "crop_matrix": [Formula((near(SQUARE), vector(2)), (4.0, 3.0)), Formula((near(SQUARE), None), (4.0, 1.0))],
    "affine_matrix3d": [
        Formula((*[DEGREES] * 3, *[vector(3)] * 3, *[SMALL] * 6), (-1.0, 0.0, 0.0, 0.0, 4)),
        Formula((*[DEGREES] * 3, *[None] * 9), (1.0, 3.5, 2.0, 1.0, 3)),
    ],
    "translation_matrix3d": [Formula((vector(3),), (0.5, 0.0, -1.5, 3)), Formula((vector(3),), (0.0, 0.0, 0.0, 4))],
    "perspective_matrix3d": [
        Formula((near(CUBE), near(2 * CUBE)), (0.0, 0.0, 0.0)),
        Formula((near(CUBE), None), (4.0, 3.0, 5.0)),
    ],
}
CASES = [pytest.param(name, f, id=f"{name}-{i}") for name, fs in FORMULAS.items() for i, f in enumerate(fs)]
every_formula = pytest.mark.parametrize("name, formula", CASES)


def rows(formula: Formula, batch: int, device: Any, dtype: torch.dtype = torch.float64) -> list[Tensor | None]:
    made = [None if f is None else torch.stack([f() for _ in range(batch)]) for f in formula.inputs]
    return [None if x is None else x.to(dtype).to(device) for x in made]


def tensors(args: list[Tensor | None]) -> list[Tensor]:
    return [x for x in args if x is not None]


def of_tensors(name: str, formula: Formula, args: list[Tensor | None]) -> Callable[..., Tensor]:
    def f(*values: Tensor) -> Tensor:
        rest = iter(values)
        return _ops.operators[name](*(None if x is None else next(rest) for x in args), *formula.plain)

    return f


def derivatives(name: str, formula: Formula, args: list[Tensor | None]) -> list[Tensor]:
    """The value and its gradients."""
    leaves = [x.detach().requires_grad_() for x in tensors(args)]
    y = of_tensors(name, formula, args)(*leaves)
    weights = torch.linspace(-1, 1, y.numel(), dtype=torch.float64, device=y.device).reshape(y.shape).to(y.dtype)
    return [y.detach(), *torch.autograd.grad((y * weights).sum(), leaves)]


def expected_of(name: str, formula: Formula, args: list[Tensor | None], dtype: torch.dtype) -> list[Tensor]:
    with K.backend("reference"):
        found = derivatives(name, formula, [x if x is None else x.double() for x in args])
    return [x.to(dtype) for x in found]


def check(actual: list[Tensor], expected: list[Tensor]) -> None:
    for a, e in zip(actual, expected, strict=True):
        scale = max(1.0, float(e.abs().max())) if e.numel() else 1.0
        relative, absolute = TOLERANCES[a.dtype]
        assert_close(a, e, 4 * relative, 4 * absolute * scale)


def test_all_are_here():
    listed = re.findall(r"^  _\((\w+), \w+,", SOURCE.read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(FORMULAS)


@pytest.mark.parametrize("dtype", _ops.FLOATS, ids=str)
@every_formula
def test_values_and_gradients(name, formula, dtype, device):
    args = rows(formula, BATCH, device, dtype)
    check(derivatives(name, formula, args), expected_of(name, formula, args, dtype))


@every_formula
def test_one_row_serves_all(name, formula, device):
    args = rows(formula, BATCH, device)
    for i in range(len(tensors(args))):
        where = [k for k, x in enumerate(args) if x is not None][i]
        given = [x[:1] if x is not None and k != where else x for k, x in enumerate(args)]
        check(derivatives(name, formula, given), expected_of(name, formula, given, torch.float64))


@pytest.mark.parametrize("isa", ["baseline", "avx2"])
@every_formula
def test_any_batch(name, formula, isa, device, backend):
    """Samples are computed four at a time."""
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the CPU's kernels")
    args = rows(formula, 9, device, torch.float32)
    with instruction_set(isa):
        whole = of_tensors(name, formula, args)(*tensors(args))
        for batch in (0, 1, 4, 7):
            some = [x if x is None else x[:batch] for x in args]
            check(derivatives(name, formula, some), expected_of(name, formula, some, torch.float32))
            assert torch.equal(of_tensors(name, formula, some)(*tensors(some)), whole[:batch])


@every_formula
def test_strides(name, formula, device):
    args = rows(formula, BATCH, device)
    spread = [None if x is None else x.repeat_interleave(2, 0)[::2] for x in args]
    spread = [x if x is None or x.dim() == 1 else x.repeat_interleave(2, -1)[..., ::2] for x in spread]
    f = of_tensors(name, formula, args)
    assert torch.equal(f(*tensors(spread)), f(*tensors(args)))


@every_formula
def test_derivatives(name, formula, device):
    leaves = [x.requires_grad_() for x in tensors(rows(formula, 2, device))]
    f = of_tensors(name, formula, rows(formula, 2, device))
    assert torch.autograd.gradcheck(f, leaves, fast_mode=True, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(f, leaves, fast_mode=True)


@every_formula
def test_as_operators(name, formula, device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    args = [*rows(formula, BATCH, device, torch.float32), *formula.plain]
    operator, backward = (getattr(torch.ops.kvision, n).default for n in (name, f"{name}_backward"))
    grad = torch.rand_like(operator(*args))
    for op, given in ((operator, args), (backward, [grad, *args])):
        torch.library.opcheck(op, tuple(given), test_utils=("test_schema", "test_faketensor"))
        if args[0].dim() > 1:
            wrong = [call for call in raw_calls.wrong_calls(op, given) if "without rows" not in call[0]]  # no samples
            taken = raw_calls.taken(op, wrong)
            assert not taken, "\n".join(taken)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_any_angle(dtype, device):
    """Sines, cosines and arc tangents, of large angles, in every octant and where these meet."""
    exact = torch.cat(
        [
            torch.linspace(-20, 20, 4001, dtype=torch.float64),
            torch.pi / 8 * torch.arange(-40, 41, dtype=torch.float64),
            torch.tensor([0.0, 1e-300, -1e-8, 12345.678, -9.9e5, 1.1e6, 3e15]),
        ]
    )
    angles = exact.to(dtype).to(device)
    zero = torch.zeros_like(angles)
    w, x, _, _ = K.geometry.quaternion_from_euler(angles, zero, zero)
    half = angles.double() / 2
    tolerance = 3e-16 if dtype == torch.float64 else 4e-8
    assert_close(w.double(), half.cos(), 0, tolerance)
    assert_close(x.double(), half.sin(), 0, tolerance)
    cosine, sine = half.cos().to(dtype), half.sin().to(dtype)
    log = K.geometry.quaternion_exp_to_log(torch.stack([cosine, sine, zero, zero], 1))[:, 0].double()
    angle = torch.atan2(sine.double(), cosine.double())
    known = sine != 0
    assert_close(log[known], angle[known], 0, 9e-16 if dtype == torch.float64 else 2e-7)
    for bad in (torch.inf, -torch.inf, torch.nan):
        assert K.geometry.quaternion_from_euler(*torch.full((3, 1), bad, device=device))[0].isnan().all()


ANGLE, PAIR = torch.tensor([30.0]), torch.tensor([[1.5, 2.0]])
BOX, BOX3D = 8 * SQUARE[None].float() / 4, 2 * CUBE[None].float()
LAUNCHES = {
    "rotate": (lambda x, a, p: K.geometry.rotate(x, a), 1),
    "rotate about": (lambda x, a, p: K.geometry.rotate(x, a, p), 1),
    "translate": (lambda x, a, p: K.geometry.translate(x, p), 1),
    "scale": (lambda x, a, p: K.geometry.scale(x, p), 1),
    "shear": (lambda x, a, p: K.geometry.shear(x, p), 1),
    "Affine": (lambda x, a, p: K.geometry.Affine(a, p, p, p, p)(x), 1),
    "crop_and_resize": (lambda x, a, p: K.geometry.crop_and_resize(x, on(x.device, BOX), (4, 5)), 1),
    "center_crop": (lambda x, a, p: K.geometry.center_crop(x, (4, 6)), 1),
    "rotate3d": (lambda x, a, p: K.geometry.rotate3d(x[None], a, a, a), 1),
    "crop_and_resize3d": (lambda x, a, p: K.geometry.crop_and_resize3d(x[None], on(x.device, BOX3D), (4, 5, 6)), 1),
    "center_crop3d": (lambda x, a, p: K.geometry.center_crop3d(x[None], (2, 4, 6)), 1),
    "get_affine_matrix2d": (lambda x, a, p: K.geometry.get_affine_matrix2d(p, p, p, a, a, a), 1),
    "get_perspective_transform": (lambda x, a, p: K.geometry.get_perspective_transform(x[0, :, :4, :2], x[0, :, 4:8, :2]), 3),
    "rotation_matrix_to_axis_angle": (lambda x, a, p: K.geometry.rotation_matrix_to_axis_angle(x[0, :, :3, :3]), 2),
}  # fmt: skip


@pytest.mark.parametrize("call", LAUNCHES)
def test_launches(call, device, backend):
    """A transform of images makes its matrix while it warps; parts of larger tensors are copied together first."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    from torch.utils._python_dispatch import TorchDispatchMode

    launched = []

    class Recorder(TorchDispatchMode):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            found = func(*args, **(kwargs or {}))
            values = found if isinstance(found, (tuple, list)) else [found]
            inputs = [a.untyped_storage().data_ptr() for a in args if isinstance(a, Tensor)]
            if any(v.untyped_storage().data_ptr() not in inputs for v in values):
                launched.append(str(func))
            return found

    f, most = LAUNCHES[call]
    given = [x.to(device) for x in (torch.rand(1, 3, 9, 9), ANGLE, PAIR)]
    f(*given)
    with Recorder():
        f(*given)
    assert len(launched) <= most, launched
