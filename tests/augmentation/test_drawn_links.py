"""Draws and the links of a chain by one kernel: results equal those of the separate operators."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from drawn_tests import assert_equal_params, has_kernels, random_images, record_kernel
from kvision import _backend
from kvision.augmentation import drawn_links
from kvision.augmentation.engine.stages import Resampled
from op_tests import assert_close


def elastic(**options: Any) -> Any:
    return A.RandomElasticTransform((31, 31), (6.0, 5.0), (1.0, 1.4), **{"p": 1.0, **options})


CHAINS: dict[str, Callable[[], list[Any]]] = {
    "a map between matrices": lambda: [A.RandomAffine(20.0, p=0.7), elastic(), A.RandomCrop((16, 20))],
    "a map first": lambda: [elastic(same_on_batch=True), A.RandomRotation(30.0, p=1.0), A.Resize((31, 27))],
    "maps of two sizes": lambda: [elastic(), A.RandomCrop((16, 22)), elastic(align_corners=True)],
    "by chance": lambda: [A.RandomPerspective(0.3), elastic(p=0.5), A.RandomVerticalFlip()],
    "matrices": lambda: [A.RandomAffine(20.0, p=1.0), A.Resize((12, 14), antialias=True)],
    "a color step behind": lambda: [elastic(), A.RandomRotation(30.0), A.RandomInvert()],
}


@pytest.fixture
def kernel_calls(monkeypatch: pytest.MonkeyPatch) -> tuple[list[Any], list[bool]]:
    return record_kernel(monkeypatch, drawn_links, "_draw_links")


def images(device: torch.device, dtype: torch.dtype = torch.float32) -> Tensor:
    return random_images((9, 3, 24, 28), device, dtype)


def sequence(name: str) -> Any:
    return A.AugmentationSequential(*CHAINS[name](), data_keys=["input", "mask"], resample="once")


@pytest.mark.parametrize("seed", [None, 5, "each"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("name", CHAINS)
def test_kernel_equals_separate_operators(name, dtype, seed, device, backend, kernel_calls):
    calls, serves = kernel_calls
    x = images(device, dtype)
    seed = torch.arange(len(x), device=device) if seed == "each" else seed
    results = []
    for fused in (False, True):
        serves.append(fused)
        torch.manual_seed(1)
        augment = sequence(name)
        augment(x, x, seed=seed)
        outputs = augment(x, x, seed=seed)  # finds its plan
        assert isinstance(augment._record.stages[0], Resampled)
        results.append((*outputs, augment.transform_matrix, augment._params, torch.get_rng_state()))
    assert len(calls) == (2 if has_kernels(device, backend) else 0)
    (y, mask, matrix, params, state), (fused, fused_mask, fused_matrix, fused_params, fused_state) = results
    # On CUDA the kernels may round the matrices differently, so that sampling coordinates differ by rounding errors.
    on_cuda = device.type == "cuda"
    tolerance = {torch.float32: 1e-4, torch.float16: 2e-3, torch.uint8: 1.0}[dtype] if on_cuda else 0.0
    assert_close(fused, y, 0.0, tolerance)
    assert (fused_mask != mask).float().mean() <= (1e-3 if on_cuda else 0)
    assert_close(fused_matrix, matrix, 0.0, 1e-5 if on_cuda else 0.0)
    assert torch.equal(state, fused_state)
    assert_equal_params(fused_params, params)


def test_gradients_of_images_pass_the_kernel(device, backend, kernel_calls):
    """What is drawn has no gradient: the kernel serves images that want one, with the same gradient."""
    calls, serves = kernel_calls
    x = images(device).requires_grad_()
    mask = x.detach()
    grads = []
    for fused in (False, True):
        serves.append(fused)
        y, _ = sequence("a map between matrices")(x, mask, seed=2)
        grads.append(torch.autograd.grad(y.square().sum(), x)[0])
    assert bool(calls) == has_kernels(device, backend)
    assert_close(grads[1], grads[0], 0.0, 1e-3 if device.type == "cuda" else 0.0)


class Doubled(A.RandomElasticTransform):
    def displacements(self, *args: Any) -> Tensor:
        return 2 * super().displacements(*args)


@pytest.mark.parametrize("case", ["reference", "vmap", "float64", "no samples", "a user's map", "learned", "spline"])
def test_calls_that_the_kernel_does_not_serve(case, device, kernel_calls):
    calls, _ = kernel_calls
    x = images(device)
    rotation = A.RandomRotation(30.0, p=1.0)
    if case == "a user's map":
        twice = A.ImageSequential(rotation, Doubled((31, 31), (6.0, 5.0), (1.0, 1.4), p=1.0), resample="once")
        y = twice(x, seed=1)
        assert not calls
        strong = A.RandomElasticTransform((31, 31), (6.0, 5.0), (2.0, 2.8), p=1.0)
        assert_close(y, A.ImageSequential(rotation, strong, resample="once")(x, seed=1), 0.0, 1e-4)
        return
    if case == "learned":
        degrees = torch.nn.Parameter(torch.tensor([10.0, 20.0], device=device))
        augment = A.ImageSequential(A.RandomRotation(degrees, p=1.0), elastic(), resample="once")
        assert torch.autograd.grad(augment(x, seed=1).sum(), degrees)[0].abs().min() > 0
    elif case == "spline":
        A.ImageSequential(rotation, A.RandomThinPlateSpline(0.1, p=1.0), elastic(), resample="once")(x)
    elif case == "reference":
        with K.backend("reference"):
            sequence("a map first")(x, x)
    elif case == "vmap":
        augment = A.ImageSequential(*CHAINS["a map first"](), resample="once")
        torch.func.vmap(lambda one: augment(one[None], seed=1))(x)
    elif case == "float64":
        assert sequence("a map first")(x.double(), x)[0].dtype == torch.float64
    else:
        assert sequence("a map first")(x[:0], x[:0])[0].shape == (0, 3, 31, 27)
    assert not calls


def test_plans_are_checked(device):
    if device.type in _backend.unserved:
        pytest.skip("plans are checked by the kernel, which is not there")
    augment, x = sequence("maps of two sizes"), images(device)
    augment(x, x, seed=0)
    (plan,) = [p for p in augment._plans._plans.values() if hasattr(p, "drawn")]
    own_plan, own_numbers = plan.drawn._packed()
    keys = torch.zeros(1, dtype=torch.int64)

    def call(plan: Tensor, numbers: Tensor) -> Any:
        return torch.ops.kvision.draw_links(x, keys, None, plan, numbers)

    def changed(at: int, value: int) -> Tensor:
        plan = own_plan.clone()
        plan[at] = value
        return plan

    columns, matrix, *fields = call(own_plan, own_numbers)
    assert columns.shape[0] == 9 and matrix.shape == (9, 3, 3)
    assert [tuple(field.shape) for field in fields] == [(9, 2, 24, 28), (9, 2, 16, 22)]
    for plan, numbers, message in (
        (own_plan[:-3], own_numbers, "ends early"),
        (own_plan[:1], own_numbers, "ends early"),
        (own_plan.int(), own_numbers, "int64 and float64"),
        (own_plan, own_numbers.float(), "int64 and float64"),
        (own_plan, own_numbers[:-1], "expected at least"),
        (changed(-8, 0), own_numbers, "pixels"),
        (changed(-6, 1), own_numbers, "no key"),
        (changed(-1, 0), own_numbers, "window|kernel"),
    ):
        with pytest.raises(RuntimeError, match=f"draw_links: .*({message})"):
            call(plan, numbers)
