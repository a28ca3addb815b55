"""Draws and the pass that reads them by one kernel: results equal those of the separate operators."""

import pytest
import torch

import kvision as K
from drawn_tests import (
    UNSERVED,
    assert_equal_params,
    call_unserved,
    has_kernels,
    random_images,
    record_kernel,
)
from kvision import _backend
from kvision.augmentation import drawn_pass
from op_tests import assert_close

A = K.augmentation

MAKE = {
    "crop, flip, jitter, normalize": lambda **options: A.AugmentationSequential(
        A.RandomResizedCrop((12, 10)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=0.7),
        A.Normalize((0.5, 0.4, 0.3), (0.2, 0.3, 0.4)),
        **options,
    ),
    "affine, blur, invert": lambda **options: A.ImageSequential(
        A.RandomAffine(30.0, (0.1, 0.1), p=0.6), A.RandomGaussianBlur(3, (0.5, 1.0)), A.RandomInvert(), **options
    ),
    "affine": lambda **options: A.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=0.7, **options),
    "perspective": lambda **options: A.RandomPerspective(0.4, p=0.7, **options),
    "color jitter": lambda **options: A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=0.7, **options),
    "fill": lambda **options: A.RandomCrop((9, 20), padding=4, fill=0.5, **options),
}


@pytest.fixture
def kernel_calls(monkeypatch):
    return record_kernel(monkeypatch, drawn_pass, "_draw_warp_and_color")


def images(device, dtype=torch.float32, batch=37):
    return random_images((batch, 3, 16, 18), device, dtype)


@pytest.mark.parametrize("seed", [None, 5, "each"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("name", MAKE)
def test_kernel_equals_separate_operators(name, dtype, seed, device, backend, kernel_calls):
    calls, serves = kernel_calls
    x = images(device, dtype)
    seed = torch.arange(len(x), device=device) if seed == "each" else seed
    results = []
    for fused in (False, True):
        serves.append(fused)
        torch.manual_seed(1)
        augment = MAKE[name]()
        y = [augment(x, seed=seed), augment(x, seed=seed)][1]  # the second call finds its plan
        results.append((y, augment.transform_matrix, augment._params, torch.get_rng_state()))
    assert bool(calls) == (name != "fill" and has_kernels(device, backend))
    (y, matrix, params, state), (fused, fused_matrix, fused_params, fused_state) = results
    # The kernels may round the matrices differently, so sampling coordinates differ by rounding errors.
    tolerance = {torch.float32: 2e-5, torch.float16: 2e-3, torch.uint8: 1.0}[dtype] if device.type == "cuda" else 0.0
    assert_close(fused, y, 0.0, tolerance)
    assert_close(fused_matrix, matrix, 0.0, 1e-5 if device.type == "cuda" else 0.0)
    assert torch.equal(state, fused_state)
    assert_equal_params(fused_params, params)


@pytest.mark.parametrize("case", [*UNSERVED, "subclass"])
def test_calls_that_the_kernel_does_not_serve(case, device, kernel_calls, backend):
    calls, _ = kernel_calls
    augment, x = MAKE["affine"](), images(device)
    if case in UNSERVED:
        call_unserved(case, augment, x)
    else:
        augment(torch.nn.Parameter(x, requires_grad=False))
    assert not calls
    augment(x)
    assert bool(calls) == has_kernels(device, backend)


def test_plans_are_checked(device):
    if device.type in _backend.unserved:
        pytest.skip("plans are checked by the kernel, which is not there")
    own_plan, own_numbers = MAKE["affine"]()._plan(images(device), False).drawn._packed()
    keys = torch.zeros(1, dtype=torch.int64)
    x = images(device)

    def call(plan, numbers):
        return torch.ops.kvision.draw_warp_and_color(x, keys, None, plan, numbers)

    call(own_plan, own_numbers)
    for plan, numbers, message in (
        (own_plan[:-20], own_numbers, "ends early"),
        (own_plan[:1], own_numbers, "ends early"),
        (own_plan.int(), own_numbers, "int64 and float64"),
        (own_plan, own_numbers.float(), "int64 and float64"),
        (own_plan, own_numbers[:3], "expected at least"),
        (own_plan, own_numbers[:-5], "expected"),
    ):
        with pytest.raises(RuntimeError, match=f"draw_warp_and_color: .*{message}|warp_and_color: .*{message}"):
            call(plan, numbers)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.uint8], ids=str)
def test_posterize_rounds_to_the_type_of_the_images(dtype, device):
    """All levels by all numbers of bits, as a step of a pass and as the function."""
    levels = torch.arange(256, device=device).reshape(1, 1, 16, 16).expand(27, 3, 16, 16)
    x = levels.to(dtype) if dtype == torch.uint8 else (levels / 255).to(dtype)
    augment = A.RandomPosterize((0, 8), p=0.8)
    y = augment(x)
    chosen, bits = augment._params["batch_prob"] > 0.5, augment._params["bits_factor"]
    assert 0 < chosen.sum() < 27
    assert torch.equal(y, K.enhance.posterize(x, torch.where(chosen, bits, 8).to(device)))
    assert torch.equal(augment(x, params=augment._params), y)
