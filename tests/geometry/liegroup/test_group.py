"""Lie groups against Kornia, against the matrix exponential, and by the identities that define their maps."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.liegroup import Se2, Se3, Sim3, So2, So3

GROUPS = {"So2": So2, "So3": So3, "Se2": Se2, "Se3": Se3, "Sim3": Sim3}
SIZES = {"So2": (), "So3": (3,), "Se2": (3,), "Se3": (6,), "Sim3": (7,)}
ANGLES = [0.0, 1e-8, 1e-3, 0.5, 0.999, 1.001, 2.0, 3.0, math.pi - 1e-6]


def tangent(name: str, angle: float, leading: tuple[int, ...] = (), dtype: torch.dtype = torch.float64) -> Tensor:
    """Tangent vectors whose rotation is by `angle`."""
    generator = torch.Generator().manual_seed(7)
    v = torch.randn((*leading, *SIZES[name]), generator=generator, dtype=dtype)
    if name == "So2":
        return torch.full_like(v, angle)
    if name == "Se2":
        v[..., 2] = angle
    elif name == "Sim3":
        v[..., 3:6] *= angle / v[..., 3:6].norm(dim=-1, keepdim=True)
    else:
        v[..., -3:] *= angle / v[..., -3:].norm(dim=-1, keepdim=True)
    return v


def matrix_of(element: Any) -> Tensor:
    return element.matrix().detach()


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_the_matrix_exponential(name: str, angle: float, device: torch.device) -> None:
    group, v = GROUPS[name], tangent(name, angle, (2, 4)).to(device)
    torch.testing.assert_close(matrix_of(group.exp(v)), torch.linalg.matrix_exp(group.hat(v)), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("angle", ANGLES)
def test_log_inverts_exp(name: str, angle: float, device: torch.device) -> None:
    v = tangent(name, angle, (3,)).to(device)
    torch.testing.assert_close(GROUPS[name].exp(v).log().detach(), v, rtol=1e-8, atol=1e-8)
    single = v.float()
    torch.testing.assert_close(GROUPS[name].exp(single).log().detach(), single, rtol=3e-4, atol=3e-4)


@pytest.mark.parametrize("name", GROUPS)
def test_hat_and_vee(name: str, device: torch.device) -> None:
    v = tangent(name, 1.3, (2, 3)).to(device)
    assert torch.equal(GROUPS[name].vee(GROUPS[name].hat(v)), v)


@pytest.mark.parametrize("name", GROUPS)
def test_group_laws(name: str, device: torch.device) -> None:
    torch.manual_seed(0)
    group = GROUPS[name]
    a, b = (group.random(5, device=device, dtype=torch.float64) for _ in range(2))
    identity = matrix_of(group.identity(5, device=device, dtype=torch.float64))
    torch.testing.assert_close(matrix_of(a * b), matrix_of(a) @ matrix_of(b))
    torch.testing.assert_close(matrix_of(a * a.inverse()), identity)
    torch.testing.assert_close(matrix_of(group.from_matrix(matrix_of(a))), matrix_of(a))
    torch.testing.assert_close(matrix_of(a[2]), matrix_of(a)[2])
    torch.testing.assert_close(matrix_of(a[1:3]), matrix_of(a)[1:3])
    n = identity.shape[-1] if name.startswith("So") else identity.shape[-1] - 1
    points = torch.randn(5, n, dtype=torch.float64, device=device)
    moved = (matrix_of(a)[:, :n, :n] @ points[..., None])[..., 0]
    moved = moved if name.startswith("So") else moved + matrix_of(a)[:, :n, n]
    torch.testing.assert_close((a * points).detach(), moved)


@pytest.mark.parametrize("name", GROUPS)
def test_adjoint_moves_tangent_vectors(name: str, device: torch.device) -> None:
    torch.manual_seed(0)
    group = GROUPS[name]
    g, v = group.random(4, device=device, dtype=torch.float64), tangent(name, 0.4, (4,)).to(device)
    if name == "So2":
        assert torch.equal(g.adjoint(), torch.eye(2, dtype=torch.float64, device=device).expand(4, 2, 2))
        return
    moved = (g.adjoint() @ v[..., None])[..., 0]
    torch.testing.assert_close(matrix_of(g * group.exp(v)), matrix_of(group.exp(moved) * g))


@pytest.mark.parametrize("name", ("So3", "Se3", "Sim3"))
@pytest.mark.parametrize("angle", [*ANGLES, 4.0, 6.0])
def test_jacobians(name: str, angle: float, device: torch.device) -> None:
    group, v = GROUPS[name], tangent(name, angle).to(device)
    step = 1e-6
    for side in ("left", "right"):
        columns = []
        for d in torch.eye(len(v), dtype=v.dtype, device=device) * step:
            forward, backward = group.exp(v + d), group.exp(v - d)
            between = forward * backward.inverse() if side == "left" else backward.inverse() * forward
            columns.append(between.log().detach() / (2 * step))
        jacobian = getattr(group, f"{side}_jacobian")(v)
        torch.testing.assert_close(jacobian, torch.stack(columns, -1), rtol=1e-6, atol=1e-6)
        inverse = getattr(group, f"{side}_jacobian_inverse")(v)
        torch.testing.assert_close(
            inverse @ jacobian, torch.eye(len(v), dtype=v.dtype, device=device), rtol=1e-7, atol=1e-7
        )


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("angle", [0.0, 0.5, 0.9999, 2.0])
def test_gradients_of_any_order(name: str, angle: float, device: torch.device) -> None:
    if name == "Sim3" and angle > 0.5:
        pytest.skip("one smooth formula for all angles")
    group, v = GROUPS[name], tangent(name, angle, (1,)).to(device).requires_grad_()

    def through(v: Tensor) -> Tensor:
        return group.exp(v).matrix()

    def there_and_back(v: Tensor) -> Tensor:
        return group.exp(v).log()

    for f in (through, there_and_back):
        assert torch.autograd.gradcheck(f, (v,))
        assert torch.autograd.gradgradcheck(f, (v,))


@pytest.mark.parametrize("name", ("So3", "Se3", "Sim3"))
@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0])
def test_gradients_of_jacobians(name: str, angle: float, device: torch.device) -> None:
    v = tangent(name, angle, (1,)).to(device).requires_grad_()
    for kind in ("left_jacobian", "left_jacobian_inverse", "right_jacobian"):
        assert torch.autograd.gradcheck(getattr(GROUPS[name], kind), (v,))


def test_gradients_are_finite_at_half_turns(device: torch.device) -> None:
    for angle in (math.pi, math.pi - 1e-9, 0.0):
        for name in GROUPS:
            v = tangent(name, angle, dtype=torch.float32).to(device).requires_grad_()
            (grad,) = torch.autograd.grad(GROUPS[name].exp(v).log().sum(), v)
            assert grad.isfinite().all(), (name, angle)


@pytest.mark.parametrize("name", GROUPS)
def test_interpolation_is_a_geodesic(name: str, device: torch.device) -> None:
    torch.manual_seed(1)
    group = GROUPS[name]
    a = group.random(3, device=device, dtype=torch.float64)
    v = tangent(name, 1.2, (3,)).to(device)
    b = a.retract(v)
    for t in (0.0, 0.25, 1.0):
        torch.testing.assert_close(matrix_of(a.interpolate(b, t)), matrix_of(a.retract(t * v)))
    each = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64, device=device)
    torch.testing.assert_close(matrix_of(a.interpolate(b, each))[1], matrix_of(a.interpolate(b, 0.5))[1])
    with pytest.raises(TypeError, match=f"{name}.interpolate: expected other to be a {name}, got str"):
        a.interpolate("b", 0.5)


def test_parameters_are_found_by_optimizers(device: torch.device) -> None:
    torch.manual_seed(0)
    source = torch.randn(20, 3, device=device)
    truth = Se3.exp(torch.tensor([0.3, -0.2, 0.5, 0.6, -0.4, 0.3], device=device)).requires_grad_(False)
    pose = Se3.identity(device=device)
    optimizer = torch.optim.Adam(pose.parameters(), 0.02)
    for _ in range(150):
        optimizer.zero_grad()
        loss = (pose * source - truth * source).square().mean()
        loss.backward()
        optimizer.step()
    assert loss < 1e-3, "rotation and translation move"

    v = torch.zeros(6, device=device, requires_grad=True)
    moved = Se3.exp(v) * torch.ones(3, device=device)
    assert torch.autograd.grad(moved.sum(), v)[0].abs().sum() > 0  # the graph goes through the element


def test_gauss_newton_on_the_group_converges_where_the_additive_one_does_not(device: torch.device) -> None:
    """Both align points from the same pose, a full turn about z, where an axis times an angle has a singular Jacobian."""
    generator = torch.Generator().manual_seed(0)
    source = torch.randn(30, 3, generator=generator, dtype=torch.float64).to(device)
    truth = Se3.exp(torch.tensor([0.3, -0.2, 0.5, 1.2, -0.4, 0.3], dtype=torch.float64, device=device))
    target = (truth * source).detach()
    start = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 2 * math.pi - 1e-3], dtype=torch.float64, device=device)

    def residuals(pose: Se3) -> Tensor:
        return (pose * source - target).reshape(-1)

    def solve(J: Tensor, r: Tensor) -> Tensor:
        return -torch.linalg.lstsq(J, r.detach()[:, None]).solution[:, 0]

    pose = Se3.exp(start)
    for _ in range(10):
        moved = (pose * source).detach()
        # exp(d) * p moves by [I, -hat(p)] d.
        J = torch.cat([torch.eye(3, dtype=moved.dtype, device=device).expand_as(So3.hat(moved)), -So3.hat(moved)], -1)
        pose = Se3.exp(solve(J.flatten(0, 1), residuals(pose))) * pose
    assert residuals(pose).abs().max() < 1e-9

    v = start
    for _ in range(10):
        v = v + solve(torch.func.jacrev(lambda v: residuals(Se3.exp(v)))(v), residuals(Se3.exp(v)))
    assert residuals(Se3.exp(v)).abs().max() > 0.1


def test_transforms_and_compile(device: torch.device) -> None:
    v = tangent("Se3", 0.7, (4,), torch.float32).to(device)

    def f(v: Tensor) -> Tensor:
        return (Se3.exp(v).inverse() * torch.ones(3, device=device)).sum(-1)

    each = torch.stack([f(row) for row in v]).detach()
    torch.testing.assert_close(torch.func.vmap(f)(v).detach(), each)
    gradient = torch.func.grad(lambda v: f(v).sum())(v)
    v.requires_grad_()
    torch.testing.assert_close(gradient, torch.autograd.grad(f(v).sum(), v)[0])
    _, tangent_out = torch.func.jvp(f, (v.detach(),), (torch.ones_like(v),))
    torch.testing.assert_close(tangent_out.detach(), gradient.sum(-1), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: So3(torch.zeros(4)), TypeError, "So3: expected q to be a Quaternion, got Tensor"),
        (lambda: So2(torch.zeros(4)), TypeError, "So2: expected z to be a complex Tensor, got torch.float32"),
        (lambda: Se3(torch.zeros(4), torch.zeros(3)), TypeError, "Se3: expected rotation to be an So3 or a Quaternion"),
        (
            lambda: Se3(So3.identity(), torch.zeros(2)),
            ValueError,
            r"Se3: expected translation of shape \(\*, 3\), got \(2,\)",
        ),
        (lambda: Se2(So3.identity(), torch.zeros(2)), TypeError, "Se2: expected rotation to be an So2, got So3"),
        (lambda: Se3.exp(torch.zeros(5)), ValueError, r"Se3.exp: expected v of shape \(\*, 6\), got \(5,\)"),
        (lambda: So3.exp([0, 0, 1]), TypeError, "So3.exp: expected v to be a Tensor, got list"),
        (lambda: So3.identity(3) * torch.zeros(4, 3), ValueError, "So3: expected points whose leading axes broadcast"),
        (lambda: So3.identity() * torch.zeros(2), ValueError, r"So3: expected points of shape \(\*, 3\), got \(2,\)"),
    ],
)
def test_errors(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()


# --- Kornia ----------------------------------------------------------------------------------------------------------


def test_against_kornia(device: torch.device) -> None:
    kornia = pytest.importorskip("kornia.geometry.liegroup")
    torch.manual_seed(3)
    for name, group in GROUPS.items():
        if name == "Sim3":
            continue  # Kornia has none
        theirs = getattr(kornia, name)
        v = tangent(name, 0.8, (4,), torch.float32).to(device)
        a, b = group.exp(v), theirs.exp(v)
        torch.testing.assert_close(a.matrix(), b.matrix(), rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(a.log(), b.log(), rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(a.adjoint(), b.adjoint(), rtol=1e-5, atol=1e-6)
        torch.testing.assert_close((a * a).matrix(), (b * b).matrix(), rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(a.inverse().matrix(), b.inverse().matrix(), rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(group.hat(v), theirs.hat(v))
        points = torch.randn(4, 3 if name.endswith("3") else 2, device=device)
        torch.testing.assert_close(a * points, b * points, rtol=1e-5, atol=1e-5)
    v = tangent("So3", 0.8, (4,), torch.float32).to(device)
    torch.testing.assert_close(So3.Jr(v), kornia.So3.Jr(v), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(So3.Jl(v), kornia.So3.Jl(v), rtol=1e-5, atol=1e-6)
    x = torch.rand(3, device=device)
    for axis in "xyz":
        torch.testing.assert_close(
            getattr(Se3, f"rot_{axis}")(x).matrix(),
            getattr(kornia.Se3, f"rot_{axis}")(x).matrix(),
            rtol=1e-5,
            atol=1e-6,
        )
        torch.testing.assert_close(
            getattr(Se3, f"trans_{axis}")(x).matrix(), getattr(kornia.Se3, f"trans_{axis}")(x).matrix()
        )
    qxyz = torch.cat([K.geometry.Quaternion.random(5).data, torch.rand(5, 3)], -1).to(device)
    torch.testing.assert_close(Se3.from_qxyz(qxyz).matrix(), kornia.Se3.from_qxyz(qxyz).matrix(), rtol=1e-5, atol=1e-6)
