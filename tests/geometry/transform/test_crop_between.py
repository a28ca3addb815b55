"""Center crops between pixels on CUDA: which take the kernel of means, and results where rows begin anywhere."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kvision import geometry

pytestmark = pytest.mark.native

TYPES = (torch.float32, torch.float16, torch.bfloat16, torch.uint8)


def takes_means(x: Tensor, size: tuple[int, int], **options: str) -> bool:
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    geometry.center_crop(x, size, **options)
    with torch.profiler.profile(activities=activities) as profile:
        geometry.center_crop(x, size, **options)
        torch.cuda.synchronize()
    names = [event.name for event in profile.events() if event.device_type == torch.autograd.DeviceType.CUDA]
    return any("crop_between_groups" in name for name in names)


def test_which_crops_take_the_kernel(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for dtype in TYPES:
        x = torch.ones(2, 3, 21, 33, device=device).to(dtype)
        for size, between in (((10, 20), True), ((11, 20), True), ((10, 21), True), ((11, 21), False)):
            assert takes_means(x, size) == between, (dtype, size)
        assert takes_means(x, (10, 6)) == (dtype == torch.float32)  # narrower than a group of columns
        assert not takes_means(x, (10, 40))
        assert not takes_means(x, (10, 20), mode="bicubic")
        assert not takes_means(x.contiguous(memory_format=torch.channels_last), (10, 20))
    assert not takes_means(torch.ones(2, 3, 21, 33, dtype=torch.float64, device=device), (10, 20))


@pytest.mark.parametrize("dtype", TYPES, ids=str)
def test_rows_that_begin_anywhere(dtype, device):
    close = {torch.float32: 1e-6, torch.float16: 1e-3, torch.bfloat16: 8e-3, torch.uint8: 1}[dtype]
    for (height, width), size in (
        ((37, 515), (20, 64)),
        ((12, 33), (11, 32)),
        ((64, 65), (64, 64)),
        ((65, 64), (64, 64)),
        ((300, 43), (99, 30)),
    ):
        count = 6 * height * width
        memory = torch.rand(count + 5, generator=torch.Generator().manual_seed(width))
        memory = (memory * 255).to(dtype) if dtype == torch.uint8 else memory.to(dtype)
        for first in range(6):  # at the beginning of the memory, and at its end
            x = memory[first : first + count].view(2, 3, height, width)
            y = geometry.center_crop(memory.to(device)[first : first + count].view_as(x), size).cpu()
            expected = geometry.center_crop(x, size)
            assert (y.float() - expected.float()).abs().max() <= close, (height, width, first)
