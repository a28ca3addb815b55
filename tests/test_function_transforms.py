"""torch.func's transforms of public functions: compiled ones equal eager ones, and batches of any size have Jacobians."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.fx.experimental.proxy_tensor import make_fx

import kvision as K
from benchmarks.sample_calls import SampleCall, Size, sample_calls
from op_tests import THOROUGH, assert_close, weighted_sums

SIZES = ((4, 6), (8, 10), (24, 32))
CALLS = {call.name: call for call in sample_calls() if call.axes}
IN_PLACE = ("draw_convex_polygon", "draw_line", "draw_point2d", "draw_rectangle")
FAILED = (
    "filters.canny",
    "geometry.ARKitQTVecs_to_ColmapQTVecs",
)  # whose compiled tangents once ended in an error, or torch
OF_VALUES = ("crop_by_boxes", "crop_by_boxes3d", "crop_by_indices")  # the size of the result depends on values


def some(names: list[str], share: int) -> list[str]:
    """Every one, or in shorter runs than HYPOTHESIS_PROFILE=thorough one of `share`, always the same ones."""
    if THOROUGH:
        return names
    return sorted(random.Random(0).sample(names, len(names) // share))


def flat(value: Any) -> list[Tensor]:
    if isinstance(value, Tensor):
        return [value] if value.is_floating_point() else []
    return [tensor for part in value for tensor in flat(part)] if isinstance(value, (list, tuple)) else []


Values = dict[str, Tensor]


def sums_of(call: SampleCall, batch: int, device: torch.device) -> tuple[Callable[[Values], Tensor], Values]:
    """A few sums of the results as a function of the floating-point arguments, and these in float64 where all take it."""
    for height, width in SIZES:
        tensors = call.tensors(Size(batch, 3, height, width), device)
        try:
            call.call(K, tensors)
            break
        except ValueError:
            continue
    else:
        pytest.skip(f"takes no batch of {batch}")
    named = {k: v for k, v in tensors.items() if v.is_floating_point() and k[0] != "_"}
    wide = {k: v.double() for k, v in named.items()}

    def sums(values: dict[str, Tensor]) -> Tensor:
        parts = [weighted_sums(y) for y in flat(call.call(K, {**tensors, **values}))]
        return torch.cat(parts) if parts else torch.zeros(0)

    try:
        sums(wide)
    except (TypeError, RuntimeError):
        wide = named
    return sums, wide


def needs_gradient(call: SampleCall, sums: Any, values: dict[str, Tensor]) -> None:
    if call.name.split(".")[1] in IN_PLACE:
        pytest.skip("writes into its image, as Kornia's does")
    if not values or not sums({k: v.clone().requires_grad_() for k, v in values.items()}).requires_grad:
        pytest.skip("not differentiable")


@pytest.mark.derivatives
@pytest.mark.parametrize("batch", [0, 1, 2])
@pytest.mark.parametrize("name", some(list(CALLS), 10))
def test_jacrev(name: str, batch: int, device: torch.device) -> None:
    call = CALLS[name]
    sums, values = sums_of(call, batch, device)
    needs_gradient(call, sums, values)
    leaves = {k: v.clone().requires_grad_() for k, v in values.items()}
    rows = [
        torch.autograd.grad(y, list(leaves.values()), retain_graph=True, allow_unused=True, materialize_grads=True)
        for y in sums(leaves)
    ]
    expected = {k: torch.stack(parts) for k, parts in zip(leaves, zip(*rows))}
    wide = all(v.dtype == torch.float64 for v in values.values())
    jacobian = torch.func.jacrev(sums)(values)
    for k, v in expected.items():
        scale = v.nan_to_num(posinf=0, neginf=0).abs().max().item() if v.numel() else 0
        assert_close(jacobian[k], v, 1e-7 if wide else 1e-4, (1e-9 if wide else 1e-5) * max(scale, 1))


# Second derivatives of no samples map over no tangents; of few samples they are those of a formula.
WITHOUT_SAMPLES = (
    "enhance.shift_rgb",
    "filters.get_motion_kernel3d",
    "geometry.conv_soft_argmax2d",
    "losses.l1_ssim_loss",
    "losses.ssim3d_loss",
    "losses.ssim_loss",
    "metrics.mean_absolute_disparity_error",
    "metrics.root_mean_squared_disparity_error",
)
NO_ONE_VALUE = (
    "geometry.find_essential",  # candidates have no sign and no order
    "geometry.photometric_depth_loss",  # NaN: its views see nothing
)


@pytest.mark.derivatives
@pytest.mark.parametrize(
    ("name", "batch"),
    [*((name, 0) for name in WITHOUT_SAMPLES), *((n, b) for n in some(list(CALLS), 60) for b in (0, 1, 2))],
)
def test_jacfwd_and_hessian(name: str, batch: int, device: torch.device) -> None:
    """In float64: in float32 whitening of fewer samples than features is conditioned too badly for second derivatives."""
    if name in NO_ONE_VALUE:
        pytest.skip("no one value")
    sums, values = sums_of(CALLS[name], batch, device)
    needs_gradient(CALLS[name], sums, values)
    pairs = [(torch.func.jacfwd(sums)(values), torch.func.jacrev(sums)(values))]
    if sum(v.numel() for v in values.values()) <= 300:
        total = lambda x: sums(x).sum()  # noqa: E731
        hessians = torch.func.hessian(total)(values), torch.func.jacrev(torch.func.jacrev(total))(values)
        pairs += [(hessians[0][k], hessians[1][k]) for k in values]
    wide = all(v.dtype == torch.float64 for v in values.values())
    for actual, expected in pairs:
        for k, v in expected.items():
            scale = v.nan_to_num(posinf=0, neginf=0).abs().max().item() if v.numel() else 0
            assert actual[k].shape == v.shape
            assert_close(actual[k], v, 1e-6 if wide else 1e-3, (1e-8 if wide else 1e-4) * max(scale, 1))


@pytest.mark.tracing
@pytest.mark.parametrize("transform", ["jvp", "grad"])
@pytest.mark.parametrize("name", sorted({*some(list(CALLS), 40), *FAILED}))
def test_compiled_transforms(name: str, transform: str, device: torch.device) -> None:
    """One graph of a call and its derivative, in either mode."""
    if transform == "jvp" and "zca" in name:
        pytest.skip("breaks the graph, where the eager call is right")
    if name == "geometry.undistort_points" and not THOROUGH:
        pytest.skip("a graph of twenty steps takes minutes")
    call = CALLS[name]
    sums, values = sums_of(call, 2, device)
    needs_gradient(call, sums, values)
    tangents = {k: torch.randn_like(v) for k, v in values.items()}

    def derivative(values: dict[str, Tensor], tangents: dict[str, Tensor]) -> Any:
        if transform == "jvp":
            return torch.func.jvp(sums, (values,), (tangents,))
        return list(torch.func.grad(lambda x: sums(x).square().sum())(values).values())

    torch._dynamo.reset()
    compiled = torch.compile(derivative, backend="aot_eager", fullgraph=True)
    for actual, expected in zip(compiled(values, tangents), derivative(values, tangents), strict=True):
        scale = expected.nan_to_num(posinf=0, neginf=0).abs().max().item()
        assert_close(actual, expected, 1e-5, 1e-6 * max(scale, 1))


# --- the ways to make a graph of forward mode; in torch.func, torch.jit.trace reads no sizes ----------------------------


def directional(x: Tensor, tangent: Tensor) -> Tensor:
    return torch.func.jvp(lambda x: K.filters.sobel(x), (x,), (tangent,))[1]


def of_dual_tensors(x: Tensor, tangent: Tensor) -> Tensor:
    with forward_ad.dual_level():
        return forward_ad.unpack_dual(K.filters.sobel(forward_ad.make_dual(x, tangent))).tangent


class Directional(torch.nn.Module):
    def forward(self, x: Tensor, tangent: Tensor) -> Tensor:
        return directional(x, tangent)


def exported(strict: bool) -> Callable[..., Any]:
    return lambda f, *example: torch.export.export(Directional(), example, strict=strict).module()


GRAPHS = {
    "compile": lambda f, *example: torch.compile(f, backend="aot_eager", fullgraph=True),
    "make_fx": lambda f, *example: make_fx(f)(*example),
    "export": exported(False),
    "strict export": exported(True),
}


@pytest.mark.tracing
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("way", GRAPHS)
def test_graphs_of_forward_mode(way: str, device: torch.device) -> None:
    x, other, tangent = (torch.rand(2, 1, 5, 6, device=device) for _ in range(3))
    torch._dynamo.reset()
    for f in (directional, of_dual_tensors) if way in ("compile", "make_fx") else (directional,):
        graph = GRAPHS[way](f, x, tangent)
        assert_close(graph(other, tangent), directional(other, tangent))


@pytest.mark.tracing
def test_compiled_hessian_and_gradients_of_samples(device: torch.device) -> None:
    def loss(x: Tensor) -> Tensor:
        return K.filters.sobel(x).square().sum()

    def derivatives(x: Tensor) -> tuple[Tensor, ...]:
        samples = x[:, None]
        return (
            torch.func.hessian(loss)(x),
            torch.func.vmap(torch.func.grad(loss))(samples),
            torch.func.vmap(loss)(samples),
        )

    x = torch.rand(2, 1, 3, 4, dtype=torch.float64, device=device)
    torch._dynamo.reset()
    assert_close(torch.compile(derivatives, backend="aot_eager", fullgraph=True)(x), derivatives(x))


def test_operators_called_directly(device: torch.device) -> None:
    """torch.ops.kvision in either mode, in and outside of torch.func, of a map whose gradient is not linear."""
    x, tangent = torch.rand(2, 2, 1, 5, 6, dtype=torch.float64, device=device)

    def derivatives(f: Callable[[Tensor], Tensor]) -> list[Tensor]:
        leaf = x.clone().requires_grad_()
        with forward_ad.dual_level():
            duals = [f(forward_ad.make_dual(value, tangent)) for value in (x, leaf)]
            tangents = [forward_ad.unpack_dual(y).tangent for y in duals]
        gradient = torch.autograd.grad(f(leaf).square().sum(), leaf)[0]
        transformed = torch.func.jvp(f, (x,), (tangent,))[1], torch.func.grad(lambda x: f(x).square().sum())(x)
        mapped = torch.func.vmap(torch.func.grad(lambda x: f(x[None]).sum()))(x)
        return [*tangents, gradient, *transformed, mapped, torch.func.hessian(lambda x: f(x).sum())(x)]

    actual = derivatives(lambda x: torch.ops.kvision.sobel(x, True, 1e-6))
    assert_close(actual, derivatives(K.filters.sobel))


@pytest.mark.parametrize("name", ["essential_from_fundamental", "photometric_normal_equations"])
@pytest.mark.parametrize("batch", [0, 2])
def test_hessian(name: str, batch: int, device: torch.device) -> None:
    """Of a formula, and of an operator whose results have no gradient."""
    call = CALLS[f"geometry.{name}"]
    sums, values = sums_of(call, batch, device)
    for key, blocks in torch.func.hessian(lambda x: sums(x).sum())(values).items():
        expected = torch.func.jacrev(torch.func.jacrev(lambda x: sums(x).sum()))(values)[key]
        for other, block in blocks.items():
            assert block.shape == values[key].shape + values[other].shape
            assert_close(block, expected[other], 1e-6, 1e-6)


def test_a_level_of_forward_mode_changes_no_other_call(device: torch.device) -> None:
    """A level is open in all threads; only tensors that carry tangents are differentiated."""
    points = torch.rand(2, 2, 9, 2, device=device)
    calls = [
        lambda: K.geometry.find_fundamental(*points),
        lambda: K.geometry.angle_to_rotation_matrix(points[0]),
        lambda: K.geometry.cart2pol(*points[0].unbind(-1))[1],
        lambda: K.geometry.So2.exp(points[0, :, 0, :1]).z,
    ]
    expected = [call() for call in calls]
    with forward_ad.dual_level():
        for call, y in zip(calls, expected):
            actual = call()
            assert torch.equal(actual, y) and type(actual) is type(y)
    stop = threading.Event()

    def differentiate() -> None:
        while not stop.is_set():
            torch.func.jvp(K.filters.sobel, (torch.rand(1, 1, 8, 8),), (torch.rand(1, 1, 8, 8),))

    thread = threading.Thread(target=differentiate)
    thread.start()
    try:
        for _ in range(25):
            for call, y in zip(calls, expected):
                assert torch.equal(call(), y)
    finally:
        stop.set()
        thread.join()
