"""The kernel for programs of one step on CUDA: which images take it, and results where planes begin anywhere."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest
import torch
from torch import Tensor

from kvision import color, enhance

pytestmark = pytest.mark.native

Call = Callable[[Tensor], Tensor]
CALLS: dict[str, Call] = {
    "gray": color.rgb_to_grayscale,
    "brightness": partial(enhance.adjust_brightness, factor=0.1),
    "hsv": color.rgb_to_hsv,
    "rgb": color.hsv_to_rgb,
    "ycbcr": color.rgb_to_ycbcr,
}
OF_BYTES = ("gray", "brightness")  # that have bytes as their result
NOT_OF_BYTES = ("rgb",)
IN_ANY_LAYOUT = ("brightness",)
FLOATS = (torch.float32, torch.float16, torch.bfloat16)


def takes_one_step(call: Call, x: Tensor) -> bool:
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    call(x)
    with torch.profiler.profile(activities=activities) as profile:
        call(x)
        torch.cuda.synchronize()
    return any("run_one_step" in e.name for e in profile.events() if e.device_type == torch.autograd.DeviceType.CUDA)


@pytest.mark.parametrize("name", CALLS)
def test_which_images_take_the_kernel(name, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    call = CALLS[name]
    for height, width in ((13, 17), (16, 32)):
        ones = torch.ones(2, 3, height, width, device=device)
        for dtype in FLOATS:
            x = ones.to(dtype)
            assert takes_one_step(call, x), dtype
            last = x.contiguous(memory_format=torch.channels_last)
            assert takes_one_step(call, last) == (name in IN_ANY_LAYOUT), dtype
        if name not in NOT_OF_BYTES:
            assert takes_one_step(call, ones.byte()) == (name in OF_BYTES)
        assert not takes_one_step(call, ones.double())


def test_parameters_that_are_tensors_take_the_kernel_of_any_program(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    factor = torch.tensor([0.1, 0.2], device=device)
    x = torch.ones(2, 3, 13, 17, device=device)
    assert not takes_one_step(partial(enhance.adjust_brightness, factor=factor), x)


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("dtype", [*FLOATS, torch.uint8], ids=str)
def test_planes_that_begin_anywhere(name, dtype, device):
    call = CALLS[name]
    if dtype == torch.uint8 and name not in OF_BYTES:
        pytest.skip("has its own kernel")
    close = {torch.float32: 1e-5, torch.float16: 2e-3, torch.bfloat16: 1.6e-2, torch.uint8: 1}[dtype]
    for height, width in ((37, 513), (12, 33), (64, 64), (3, 1), (9, 500)):
        count = 6 * height * width
        memory = torch.rand(count + 17, generator=torch.Generator().manual_seed(width))
        memory = (memory * 255).to(dtype) if dtype == torch.uint8 else memory.to(dtype)
        for first in (0, 1, 2, 3, 7, 13, 17):  # at the beginning of the memory, and at its end
            x = memory[first : first + count].view(2, 3, height, width)
            on_device = memory.to(device)[first : first + count].view_as(x)
            y, expected = call(on_device).cpu().float(), call(x).float()
            far = (y - expected).abs() > close * expected.abs().clamp(min=1)
            assert not far.any(), (height, width, first)
