"""Kernels for images of bytes on CUDA: which images take them, and results where rows and planes begin anywhere."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest
import torch
from torch import Tensor

from kvision import color, enhance, filters, morphology

pytestmark = pytest.mark.native

Call = Callable[[Tensor], Tensor]


def dilation(x: Tensor) -> Tensor:
    return morphology.dilation(x, torch.ones(3, 3, device=x.device))


def erosion(x: Tensor) -> Tensor:
    return morphology.erosion(x, torch.ones(3, 3, device=x.device), border_type="constant", border_value=99.6)


def cross(x: Tensor) -> Tensor:
    element = torch.tensor([[0.0, 1, 0], [1, 1, 1], [0, 1, 0]], device=x.device)
    return morphology.dilation(x, element, 7 * element)


# Calls that go down groups of eight columns, the kernel, and how many pixels on either side the window reaches.
GROUPS: dict[str, tuple[Call, str, int]] = {
    "dilation": (dilation, "dilation_3x3_groups", 1),
    "median 3": (partial(filters.median_blur, kernel_size=3), "median_groups", 1),
    "gauss 5": (partial(filters.gaussian_blur2d, kernel_size=5, sigma=(1.5, 1.5)), "separable_groups", 2),
    "gauss 3": (partial(filters.gaussian_blur2d, kernel_size=3, sigma=(1.5, 1.5)), "separable_groups", 1),
    "sharpness": (partial(enhance.sharpness, factor=1.7), "run_groups", 1),
}
POINTWISE: dict[str, tuple[Call, str]] = {
    "gray": (color.rgb_to_grayscale, "run_one_step"),
    "brightness": (partial(enhance.adjust_brightness, factor=0.1), "run_one_step"),
    "gamma": (partial(enhance.adjust_gamma, gamma=0.7), "run_bytes"),
    "equalize": (enhance.equalize, "equalize_bytes"),
    "clahe": (enhance.equalize_clahe, "map_cells"),
    "hsv": (color.rgb_to_hsv, "run"),
    "xyz": (color.rgb_to_xyz, "run"),
}
OTHERS: dict[str, Call] = {
    "erosion": erosion,
    "gauss 11": partial(filters.gaussian_blur2d, kernel_size=11, sigma=(1.5, 1.5)),
    "cross": cross,
    "median 5": partial(filters.median_blur, kernel_size=5),
    **{
        f"box {size} {border}": partial(filters.box_blur, kernel_size=size, border_type=border)
        for size in (3, 5, 7)
        for border in ("constant", "reflect", "replicate", "circular")
    },
    "laplacian": partial(filters.laplacian, kernel_size=3),
    "hue": partial(enhance.adjust_hue, factor=0.1),
    "sobel": filters.sobel,
    "gradient": filters.spatial_gradient,
}


def kernels_of(call: Call, x: Tensor) -> str:
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    call(x)
    with torch.profiler.profile(activities=activities) as profile:
        call(x)
        torch.cuda.synchronize()
    return " ".join(e.name for e in profile.events() if e.device_type == torch.autograd.DeviceType.CUDA)


@pytest.mark.parametrize("name", GROUPS)
def test_which_images_take_groups_of_columns(name, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    call, kernel, reach = GROUPS[name]
    fewest = 8 + 2 * reach
    for width in (fewest - 1, fewest, 33):
        x = torch.ones(1, 3, 12, width, dtype=torch.uint8, device=device)
        assert (kernel in kernels_of(call, x)) == (width >= fewest), width
        assert kernel not in kernels_of(call, x.contiguous(memory_format=torch.channels_last))
        assert kernel not in kernels_of(call, x.float())


@pytest.mark.parametrize("name", [*GROUPS, "box 3 reflect"])
def test_which_bytes_rows_are_multiples_of(name, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    call, kernel = GROUPS[name][:2] if name in GROUPS else (OTHERS[name], "box_groups")
    most = 16 if kernel in ("dilation_3x3_groups", "median_groups", "box_groups") else 8  # of a group
    for width, first, multiple in (
        (48, 0, 16),
        (40, 0, 8),
        (36, 0, 4),
        (500, 4, 4),
        (36, 1, 0),
        (34, 0, 0),
        (33, 0, 0),
    ):
        memory = torch.ones(12 * width + first, dtype=torch.uint8, device=device)
        launched = kernels_of(call, memory[first:].view(1, 1, 12, width))
        constants = launched.split(kernel, 1)[1].split("(", 1)[0]
        assert constants.endswith((f" {min(multiple, most)}>", f"<{min(multiple, most)}>")), (width, first, constants)


@pytest.mark.parametrize("name", POINTWISE)
def test_which_calls_compute_with_bytes(name, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    call, kernel = POINTWISE[name]
    launched = kernels_of(call, torch.ones(2, 3, 13, 17, dtype=torch.uint8, device=device))
    assert kernel in launched
    assert "elementwise" not in launched  # no conversion


def test_which_images_take_the_kernel_of_bytes_of_box(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for size, width, taken in ((3, 31, False), (3, 32, True), (5, 31, False), (5, 32, True), (7, 48, False)):
        x = torch.ones(1, 3, 12, width, dtype=torch.uint8, device=device)
        call = partial(filters.box_blur, kernel_size=size)
        assert ("box_groups" in kernels_of(call, x)) == taken, (size, width)
        assert "box_groups" not in kernels_of(call, x.contiguous(memory_format=torch.channels_last))
        assert "box_groups" not in kernels_of(call, x.half())


def test_which_planes_of_equalize_stay_in_registers(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for height, width, taken in ((1, 1, True), (335, 513, True), (600, 650, True), (600, 660, False)):
        x = torch.ones(200, 1, height, width, dtype=torch.uint8, device=device)
        assert ("equalize_bytes" in kernels_of(enhance.equalize, x)) == taken, (height, width)
        assert "equalize_bytes" not in kernels_of(enhance.equalize, x[:2].half())


def test_equalize_of_large_planes_that_begin_anywhere(device):
    for shape in ((1, 1, 700, 901), (2, 3, 299, 299), (3, 1, 256, 257)):
        count = 1
        for size in shape:
            count *= size
        memory = torch.randint(0, 256, (count + 5,), generator=torch.Generator().manual_seed(count)).to(torch.uint8)
        memory[: shape[-1]] = 7
        for first in (0, 5):
            x = memory[first : first + count].view(shape)
            on_device = memory.to(device)[first : first + count].view(shape)
            assert torch.equal(enhance.equalize(on_device).cpu(), enhance.equalize(x)), (shape, first)


def test_which_images_take_the_kernel_of_bytes_of_sobel(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for width in (1, 17, 127, 128, 300):
        x = torch.ones(1, 3, 12, width, dtype=torch.uint8, device=device)
        launched = kernels_of(filters.sobel, x)
        assert "sobel_bytes" in launched, width
        assert "elementwise" not in launched  # no conversion
        assert "sobel_bytes" not in kernels_of(filters.sobel, x.float())
    assert "sobel_bytes" not in kernels_of(filters.sobel, x.contiguous(memory_format=torch.channels_last))


def test_gradients_of_bytes_are_one_kernel(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for width in (17, 128):
        x = torch.ones(1, 3, 12, width, dtype=torch.uint8, device=device)
        launched = kernels_of(filters.spatial_gradient, x)
        assert "forward_strip" in launched and "elementwise" not in launched


@pytest.mark.parametrize("name", [*GROUPS, *POINTWISE, *OTHERS])
def test_bytes_that_begin_anywhere(name, device):
    call = OTHERS[name] if name in OTHERS else (GROUPS.get(name) or POINTWISE[name])[0]
    of_levels = name in POINTWISE or name in ("hue", "sharpness") or name.startswith("gauss")
    for height, width in ((37, 513), (12, 33), (26, 264), (40, 19), (9, 500), (6, 1030), (7, 36), (6, 12)):
        count = 6 * height * width
        memory = torch.randint(0, 256, (count + 3,), generator=torch.Generator().manual_seed(width)).to(torch.uint8)
        for first in range(4):  # at the beginning of the memory, and at its end
            x = memory[first : first + count].view(2, 3, height, width)
            on_device = memory.to(device)[first : first + count].view_as(x)
            y, expected = call(on_device).cpu(), call(x)
            level = 2e-5 if y.is_floating_point() else 1 if of_levels else 0
            assert (y.float() - expected.float()).abs().max() <= level, (height, width, first)
