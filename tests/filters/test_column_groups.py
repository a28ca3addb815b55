"""Which images take the kernels of csrc/core/stencils/column_groups.cuh. Every GPU has them."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from kvision import filters, geometry, morphology

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
VECTORS = {"gauss 5": 8, "gauss 11": 4, "box 3": 8}  # rows of so many pixels take strips


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
            assert taken == (dtype in HALVES and width >= fewest and width % VECTORS[name] != 0), (dtype, width)


def test_which_images_take_groups_of_columns_of_sobel(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for dtype in (*HALVES, *OTHERS):
        for width in (15, 17, 36, 48):
            x = torch.ones(1, 2, 12, width, device=device).to(dtype)
            taken = any("sobel_groups" in launched for launched in kernels_of(filters.sobel, x))
            assert taken == (dtype in HALVES and width >= 16), (dtype, width)


STORES: dict[str, Call] = {
    "sobel": filters.sobel,
    "median 3": lambda x: filters.median_blur(x, 3),
    "median 5": lambda x: filters.median_blur(x, 5),
    "gauss 5": lambda x: filters.gaussian_blur2d(x, 5, (1.5, 1.5)),
    "gauss 11": lambda x: filters.gaussian_blur2d(x, 11, (1.5, 1.5)),
    "dilation": lambda x: morphology.dilation(x, torch.ones(3, 3, dtype=x.dtype, device=x.device)),
    "dilation by a cross": lambda x: morphology.dilation(
        x, torch.tensor([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=x.dtype, device=x.device)
    ),
    "pyrdown": lambda x: geometry.pyrdown(x),
    "center crop": lambda x: geometry.center_crop(x, (x.shape[-2] // 2, x.shape[-1] // 2)),
}


@pytest.mark.parametrize("name", STORES)
@pytest.mark.parametrize("dtype", HALVES, ids=str)
def test_stores_of_half_types_do_not_depend_on_alignment(name, dtype, device):
    """Rows of a plane begin at other addresses in a batch than alone, so that other threads store their ends."""
    call = STORES[name]
    for height, width in ((6, 25), (8, 33), (12, 65), (40, 299), (25, 130), (9, 500), (7, 1030), (6, 256)):
        x = torch.rand(2, 3, height, width, generator=torch.Generator().manual_seed(width)).to(device, dtype)
        y = call(x)
        for plane in ((slice(0, 1), slice(0, 1)), (slice(1, 2), slice(2, 3))):
            assert torch.equal(call(x[plane].clone()), y[plane]), (height, width)
        layout = call(x.contiguous(memory_format=torch.channels_last))
        torch.testing.assert_close(layout, y, rtol=2e-2, atol=2e-2)


@pytest.mark.parametrize("dtype", HALVES, ids=str)
def test_which_bytes_rows_of_sobel_are_multiples_of(dtype, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for width, first, multiple in (
        (48, 0, 16),
        (48, 4, 8),
        (36, 0, 8),
        (500, 4, 8),
        (36, 1, 0),
        (34, 0, 0),
        (33, 0, 0),
    ):
        memory = torch.ones(12 * width + first, device=device).to(dtype)
        names = kernels_of(filters.sobel, memory[first:].view(1, 1, 12, width))
        kernel = next(name for name in names if "sobel_groups" in name)
        assert kernel.split("sobel_groups", 1)[1].split("(", 1)[0].endswith(f" {multiple}>"), kernel


@pytest.mark.parametrize("dtype", HALVES, ids=str)
def test_sobel_of_rows_that_begin_anywhere(dtype, device):
    for height, width in ((37, 513), (12, 33), (26, 260), (1, 19), (2, 17), (9, 500), (25, 256), (3, 16)):
        count = 6 * height * width
        memory = torch.rand(count + 7, generator=torch.Generator().manual_seed(width)).to(dtype)
        for first in (0, 1, 2, 4, 7):  # at the beginning of the memory, and at its end
            x = memory[first : first + count].view(2, 3, height, width)
            y = filters.sobel(memory.to(device)[first : first + count].view_as(x)).cpu().float()
            close = 1e-3 if dtype == torch.float16 else 8e-3
            torch.testing.assert_close(y, filters.sobel(x).float(), rtol=close, atol=close)


@pytest.mark.parametrize("name", ["pyrdown", "antialiased"])
def test_which_images_take_groups_of_columns_near_half(name, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")

    def call(x: Tensor) -> Tensor:
        size = (x.shape[-2] // 2, x.shape[-1] // 2)
        return geometry.pyrdown(x) if name == "pyrdown" else geometry.resize(x, size, antialias=True)

    for dtype in (*HALVES, torch.uint8, *OTHERS):
        for size, near_half in (((33, 65), True), ((33, 64), True), ((32, 65), True), ((33, 15), False)):
            x = torch.ones(1, 2, *size, device=device).to(dtype)
            taken = any("near_half_groups" in launched for launched in kernels_of(call, x))
            assert taken == (near_half and dtype not in OTHERS), (dtype, size)


@pytest.mark.parametrize("operator", ["dilation", "erosion"])
def test_which_images_take_groups_of_columns_of_dilation(operator, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    element = torch.ones(3, 3, device=device)
    for dtype in (*HALVES, *OTHERS):
        for width in (15, 16, 33, 48):
            x = torch.ones(1, 2, 12, width, device=device).to(dtype)
            names = kernels_of(lambda x: getattr(morphology, operator)(x, element.to(x.dtype)), x)
            taken = any("dilation_3x3_groups" in launched for launched in names)
            assert taken == (dtype in HALVES and width >= 16), (dtype, width)


@pytest.mark.parametrize("operator", ["dilation", "erosion"])
@pytest.mark.parametrize("dtype", HALVES, ids=str)
def test_dilation_of_rows_that_begin_anywhere(operator, dtype, device):
    elements = (torch.ones(3, 3), torch.tensor([[0.0, 1, 0], [1, 1, 1], [0, 1, 0]]))
    for height, width in ((37, 513), (12, 33), (26, 264), (9, 500), (5, 19)):
        count = 6 * height * width
        memory = torch.randn(count + 7, generator=torch.Generator().manual_seed(width)).to(dtype)
        memory[width] = torch.nan
        for first in (0, 1, 2, 4, 7):  # at the beginning of the memory, and at its end
            x = memory[first : first + count].view(2, 3, height, width)
            on_device = memory.to(device)[first : first + count].view_as(x)
            for element in elements:
                for options in ({}, {"border_type": "constant", "border_value": 0.3}):
                    call = getattr(morphology, operator)
                    y = call(on_device, element.to(device, dtype), **options).cpu()
                    expected = call(x, element.to(dtype), **options)
                    assert torch.equal(y.nan_to_num(9), expected.nan_to_num(9)), (height, width, first, options)


@pytest.mark.parametrize(("size", "fewest"), [(3, 16), (5, 8)])
def test_which_images_take_groups_of_columns_of_medians(size, fewest, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for dtype in (*HALVES, *OTHERS):
        for width in (fewest - 1, fewest, 33, 48):
            x = torch.ones(1, 2, 12, width, device=device).to(dtype)
            names = kernels_of(lambda x: filters.median_blur(x, size), x)
            taken = any("median_groups" in launched for launched in names)
            assert taken == (dtype in HALVES and width >= fewest), (dtype, width)


@pytest.mark.parametrize("size", [3, 5])
@pytest.mark.parametrize("dtype", HALVES, ids=str)
def test_medians_of_rows_that_begin_anywhere(size, dtype, device):
    for height, width in ((37, 513), (12, 33), (26, 264), (9, 500), (5, 19)):
        count = 6 * height * width
        memory = torch.randn(count + 7, generator=torch.Generator().manual_seed(width)).to(dtype)
        for first in (0, 1, 2, 4, 7):  # at the beginning of the memory, and at its end
            x = memory[first : first + count].view(2, 3, height, width)
            y = filters.median_blur(memory.to(device)[first : first + count].view_as(x), size).cpu()
            assert torch.equal(y, filters.median_blur(x, size)), (height, width, first)
