"""Images with exact 0, 1, equal channels and numbers so small that their reciprocal overflows: every function stays finite.

Of the numbers in [0, 1] among a sample call's arguments a third become nasty ones. Results and gradients are finite, and
those of float64, whose exponents reach further. `HYPOTHESIS_PROFILE=thorough` tests all functions, else it is a tenth.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls import Size
from benchmarks.sweep import all_calls, flat
from op_tests import THOROUGH, TOLERANCES

pytestmark = pytest.mark.sweep

CALLS = {call.name: call for call in all_calls()}
SIZE = Size(2, 3, 32, 40)
NASTY = torch.tensor([0, 1, 0.5, 1e-39, 2e-39, 3e-39, torch.finfo(torch.float32).tiny])
LARGEST = 1e30  # of the gradients in float64 that float32 has to reach

# What has no finite result or gradient, as documented.
INFINITE = {
    "contrib.distance_transform": "the gradient of the logarithm of a mask that is neither 0 nor 1",
    "geometry.find_essential": "rows of NaN for the solutions that do not exist",
    "geometry.point_line_distance": "infinite from a line without a direction",
    "geometry.get_tps_transform": "points that coincide",
    **dict.fromkeys(
        ("geometry.undistort_points_affine", "geometry.undistort_points_kannala_brandt"), "a focal length of 0"
    ),
    "losses.kl_div_loss_2d": "infinite where only the prediction is 0",
}
# What float32 computes less precisely of any numbers, or takes another branch of.
IMPRECISE = {
    **dict.fromkeys(
        ("feature.HardNet", "feature.HyNet", "feature.SOSNet", "feature.TFeat", "feature.OriNet", "feature.KeyNet"),
        "its weights are float32",
    ),
    "feature.match_adalam": "float64 frames are refused",
    **dict.fromkeys(("feature.SIFTDescriptor", "feature.DenseSIFTDescriptor"), "the angle of a gradient near 0"),
    **dict.fromkeys(
        ("geometry.find_homography_dlt_iterated", "geometry.find_homography_lines_dlt_iterated"), "ill-conditioned"
    ),
    "augmentation.RandomSnow": "the hue is at a corner or beside it",
    **dict.fromkeys(
        ("geometry.crop_and_resize", "geometry.shear"), "the gradient of bilinear sampling beside pixel centers"
    ),
    **dict.fromkeys(
        [f"losses.mutual_information_loss{d}" for d in ("", "_2d", "_3d")], "differences of sums of logarithms"
    ),
    "geometry.photometric_normal_equations": "sums of thousands of products",
    "metrics.aepe": "distances whose squares underflow have no gradient",
}
NOT_CALLED = {
    **dict.fromkeys(
        (
            "augmentation.AtLeastOneBBoxRandomCrop",
            "augmentation.CropNonEmptyMaskIfExists",
            "augmentation.RandomCrop",
            "augmentation.RandomCrop3D",
        ),
        "larger than the images here",
    ),
    **dict.fromkeys(
        ("image.draw_convex_polygon", "image.draw_line", "image.draw_point2d", "image.draw_rectangle"),
        "writes to its argument",
    ),
}


def names() -> list[str]:
    every = [name for name in CALLS if name not in NOT_CALLED]
    if THOROUGH:
        return every
    return random.Random(0).sample(every, len(every) // 10)


def nasty(x: Tensor) -> Tensor:
    if not x.is_floating_point() or x.numel() == 0 or x.min() < 0 or x.max() > 1:
        return x
    made = torch.where(torch.rand(x.shape) < 1 / 3, NASTY[torch.randint(len(NASTY), x.shape)], x)
    if made.dim() > 2 and made.shape[-3] == 3:
        made[..., 2, :2, :] = made[..., 0, :2, :]  # two rows of ties
        made[..., 1, :1, :] = made[..., 0, :1, :]
    return made


def results_and_gradients(call: Any, tensors: dict[str, Tensor]) -> Iterator[tuple[str, Tensor]]:
    leaves = {k: v.detach().requires_grad_(v.is_floating_point()) for k, v in tensors.items()}
    torch.manual_seed(1)  # of what the call draws
    results = flat(call.call(K, leaves))
    yield from ((f"result {i}", y.detach()) for i, y in enumerate(results))
    inputs = {k: v for k, v in leaves.items() if v.requires_grad}
    if inputs and (results := [y for y in results if y.requires_grad]):
        generator = torch.Generator().manual_seed(2)
        weights = [(torch.rand(y.shape, generator=generator) - 0.3).to(y) for y in results]
        gradients = torch.autograd.grad(results, list(inputs.values()), weights, allow_unused=True)
        yield from ((f"gradient of {k}", g) for k, g in zip(inputs, gradients) if g is not None)


@pytest.mark.parametrize("name", names())
def test_nasty_values(name, device):
    call = CALLS[name]
    tensors = {k: nasty(v).to(device) for k, v in call.tensors(SIZE).items()}
    actual = list(results_and_gradients(call, tensors))
    if name not in INFINITE:
        assert not [what for what, y in actual if not y.isfinite().all()]
    if name in INFINITE or name in IMPRECISE:
        return
    wide = {k: v.double() if v.is_floating_point() else v for k, v in tensors.items()}
    rtol, atol = TOLERANCES[torch.float32]
    for (what, a), (_, e) in zip(actual, results_and_gradients(call, wide), strict=True):
        within = e.abs() < LARGEST
        a, e = a.double()[within], e.double()[within]
        scale = max(1.0, float(e.abs().max())) if e.numel() else 1.0
        torch.testing.assert_close(
            a, e, rtol=10 * rtol, atol=10 * atol * scale, msg=lambda m, what=what: f"{what}: {m}"
        )
