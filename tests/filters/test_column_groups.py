"""Which images take the kernels of csrc/core/stencils/column_groups.cuh. Every GPU has them."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from kvision import filters, geometry

pytestmark = pytest.mark.native

HALVES = (torch.float16, torch.bfloat16)
OTHERS = (torch.float32, torch.float64)
Call = Callable[[Tensor], Tensor]
# A call, and the pixels of the narrowest odd row that takes the kernel.
SEPARABLE: dict[str, tuple[Call, int]] = {
    "gauss 5": (lambda x: filters.gaussian_blur2d(x, 5, (1.5, 1.5)), 17),
    "gauss 11": (lambda x: filters.gaussian_blur2d(x, 11, (1.5, 1.5)), 25),
    "box 3": (lambda x: filters.box_blur(x, 3), 17),
}


def kernels_of(call: Call, x: Tensor) -> list[str]:
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    call(x)
    with torch.profiler.profile(activities=activities) as profile:
        call(x)
        torch.cuda.synchronize()
    return [event.name for event in profile.events() if event.device_type == torch.autograd.DeviceType.CUDA]


@pytest.mark.parametrize("name", SEPARABLE)
def test_which_images_take_groups_of_columns(name, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    call, fewest = SEPARABLE[name]
    for dtype in (*HALVES, *OTHERS):
        for width in (fewest - 2, fewest, 33, 36, 48):
            x = torch.ones(1, 2, 12, width, device=device).to(dtype)
            taken = any("separable_groups" in launched for launched in kernels_of(call, x))
            assert taken == (dtype in HALVES and width >= fewest and width % 4 != 0), (dtype, width)


@pytest.mark.parametrize("name", ["pyrdown", "antialiased"])
def test_which_images_take_groups_of_columns_near_half(name, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")

    def call(x: Tensor) -> Tensor:
        size = (x.shape[-2] // 2, x.shape[-1] // 2)
        return geometry.pyrdown(x) if name == "pyrdown" else geometry.resize(x, size, antialias=True)

    even = name == "pyrdown"  # of both sides one is odd
    for dtype in (*HALVES, torch.uint8, *OTHERS):
        for size, near_half in (((33, 65), True), ((33, 64), even), ((32, 65), True), ((33, 15), False)):
            x = torch.ones(1, 2, *size, device=device).to(dtype)
            taken = any("near_half_groups" in launched for launched in kernels_of(call, x))
            assert taken == (near_half and dtype not in OTHERS), (dtype, size)
