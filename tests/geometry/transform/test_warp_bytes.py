"""Bytes warped by a matrix: which calls compute in fixed point on CUDA, and results of any width, memory and matrix."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from kvision import geometry as G

pytestmark = pytest.mark.native

# Half a level, the error of fixed point, and that of coordinates of up to 1600.
CLOSE = 0.5 + 0.02 + 0.04
SIZES = [((335, 513), (333, 511)), ((37, 53), (70, 41)), ((64, 64), (65, 66)), ((1, 1), (5, 7)), ((1, 70), (3, 64))]
# Linear parts of maps from the result to the image: turned, nearly still, shrunk beyond what a block can hold.
PARTS = {
    "turned": (0.83, 0.47, -0.41, 0.87),
    "still": (1.0, 0.001, -0.002, 1.0),
    "shrunk": (2.9, 0.3, -0.4, 3.1),
}


def noise(shape: tuple[int, ...]) -> Tensor:
    return torch.randint(0, 256, shape, generator=torch.Generator().manual_seed(shape[-1])).to(torch.uint8)


def matrices(part: str, batch: int, shift: float, perspective: float = 0.0) -> Tensor:
    """(B, 3, 3) from the image to the result, in the rounding of float32."""
    a, b, c, d = PARTS[part]
    rows = [[[a, b, shift + 3.3 * i], [c, d, 0.7 - i], [perspective, -perspective / 2, 1.0]] for i in range(batch)]
    return torch.linalg.inv(torch.tensor(rows, dtype=torch.float64)).float()


def errors(x: Tensor, matrix: Tensor, size: tuple[int, int], device: torch.device, **options: str) -> Tensor:
    """From the warp in float64."""
    y = G.warp_perspective(x.to(device), matrix.to(device), size, **options)
    exact = G.warp_perspective(x.double(), matrix.double(), size, **options)
    return (y.cpu().double() - exact).abs()


def kernels_of(call: Callable[..., object], *args: object) -> str:
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    call(*args)
    with torch.profiler.profile(activities=activities) as profile:
        call(*args)
        torch.cuda.synchronize()
    return " ".join(e.name for e in profile.events() if e.device_type == torch.autograd.DeviceType.CUDA)


def test_which_calls_compute_in_fixed_point(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for channels, width in ((1, 1), (3, 64), (3, 65)):
        x, M = noise((2, channels, 40, width)).to(device), matrices("turned", 2, 0.0).to(device)
        for images in (x, x.contiguous(memory_format=torch.channels_last), x[..., 1:, :], x.mT):
            assert "sample_byte_tiles" in kernels_of(G.warp_affine, images, M[:, :2], (40, 41))
            assert "sample_byte_tiles" in kernels_of(G.warp_perspective, images, M, (40, 44))
            assert "sample_byte_tiles" in kernels_of(G.rotate, images, torch.full((2,), 9.0, device=device))
        assert "sample_byte_list_tiles" in kernels_of(G.warp_affine, [*x], M[:, :2], (40, 41))
        for images, mode in ((x.half(), "bilinear"), (x.float(), "bilinear"), (x, "nearest"), (x, "bicubic")):
            assert "sample_byte" not in kernels_of(G.warp_affine, images, M[:, :2], (40, 41), mode)
        u = torch.zeros(2, 8, 9, device=device)
        assert "sample_byte" not in kernels_of(G.remap, x, u, u)


@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
@pytest.mark.parametrize("part", PARTS)
def test_results_are_within_rounding_of_exact_ones(part, padding, device):
    for (height, width), size in SIZES:
        for channels in (1, 3, 5):
            x = noise((2, channels, height, width))
            for perspective in (0.0, 2e-4):
                M = matrices(part, 2, 1.3, perspective)
                assert errors(x, M, size, device, padding_mode=padding).max() <= CLOSE, (height, width, channels)


@pytest.mark.parametrize("shift", [-1e3, 9e4, -2e6, 1e12])
def test_matrices_far_outside(shift, device):
    x, M = noise((2, 3, 37, 53)), matrices("turned", 2, shift)
    assert errors(x, M, (40, 41), device, padding_mode="zeros").max() == 0
    assert errors(x, M, (40, 41), device, padding_mode="border").max() <= CLOSE


def test_results_depend_on_no_memory_and_no_neighbors(device):
    for (height, width), size in SIZES:
        count = 6 * height * width
        memory, M = noise((count + 3,)).to(device), matrices("turned", 2, 1.3).to(device)
        for first in range(4):  # at the beginning of the memory, and at its end
            x = memory[first : first + count].view(2, 3, height, width)
            y = G.warp_perspective(x, M, size)
            assert errors(x.cpu(), M.cpu(), size, device).max() <= CLOSE, (height, width, first)
            if device.type == "cuda":  # on the CPU only what is in bounds is in fixed point, vector by vector
                assert torch.equal(G.warp_perspective(x.contiguous(memory_format=torch.channels_last), M, size), y)
                assert torch.equal(G.warp_perspective(x[1:], M[1:], size), y[1:])
                assert torch.equal(G.warp_perspective([*x], M, size), y)
                assert torch.equal(G.warp_perspective(x.repeat(32, 1, 1, 1), M.repeat(32, 1, 1), size)[-2:], y)


@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
def test_views_have_the_results_of_copies(padding, device):
    M = matrices("turned", 2, 1.3).to(device)
    for height, width in ((40, 136), (36, 128), (9, 16)):
        for layout in (torch.contiguous_format, torch.channels_last):
            memory = noise((2, 3, height, width)).to(device).contiguous(memory_format=layout)
            for rows, columns in (
                (slice(None), slice(0, -3)),
                (slice(1, None), slice(8, None)),
                (slice(2, -1), slice(5, -8)),
            ):
                x = memory[..., rows, columns]
                y = G.warp_perspective(x, M, (35, 99), padding_mode=padding)
                copy = x.contiguous(memory_format=torch.contiguous_format)
                assert errors(copy.cpu(), M.cpu(), (35, 99), device, padding_mode=padding).max() <= CLOSE
                if device.type == "cuda":
                    assert torch.equal(y, G.warp_perspective(copy, M, (35, 99), padding_mode=padding))
                else:
                    assert (
                        y.int() - G.warp_perspective(copy, M, (35, 99), padding_mode=padding).int()
                    ).abs().max() <= 1


def test_long_lists_have_the_results_of_batches(device):
    x, M = noise((4, 3, 9, 70)).to(device), matrices("turned", 4, 1.3).to(device)
    expected = G.warp_perspective(x, M, (7, 66))
    y = G.warp_perspective([*x] * 256, M.repeat(256, 1, 1), (7, 66))
    assert torch.equal(y, expected.repeat(256, 1, 1, 1))


def maps(part: str, size: tuple[int, int], shift: float) -> tuple[Tensor, Tensor]:
    """Of two samples, bent, so that coordinates are of no matrix."""
    y, x = torch.meshgrid(torch.arange(size[0]).float(), torch.arange(size[1]).float(), indexing="ij")
    a, b, c, d = PARTS[part]
    u, v = a * x + b * y + shift + torch.sin(y / 7), c * x + d * y + torch.cos(x / 5)
    return torch.stack([u, u - 2.7]), torch.stack([v, v + 1.1])


def map_errors(x: Tensor, u: Tensor, v: Tensor, device: torch.device, **options: str) -> Tensor:
    exact = G.remap(x.double(), u.double(), v.double(), **options)
    return (G.remap(x.to(device), u.to(device), v.to(device), **options).cpu().double() - exact).abs()


@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
@pytest.mark.parametrize("part", PARTS)
def test_results_by_maps_are_within_rounding_of_exact_ones(part, padding, device):
    for (height, width), size in SIZES:
        for channels in (1, 3, 5):
            x = noise((2, channels, height, width))
            u, v = maps(part, size, 1.3)
            assert map_errors(x, u, v, device, padding_mode=padding).max() <= CLOSE, (height, width, channels)


def test_results_by_maps_depend_on_no_memory_and_no_neighbors(device):
    for (height, width), size in SIZES:
        count = 6 * height * width
        memory = noise((count + 3,)).to(device)
        u, v = (m.to(device) for m in maps("turned", size, 1.3))
        for first in range(4):
            x = memory[first : first + count].view(2, 3, height, width)
            y = G.remap(x, u, v)
            assert map_errors(x.cpu(), u.cpu(), v.cpu(), device).max() <= CLOSE, (height, width, first)
            if device.type == "cuda":
                assert torch.equal(G.remap(x.contiguous(memory_format=torch.channels_last), u, v), y)
                assert torch.equal(G.remap(x[1:], u[1:], v[1:]), y[1:])
                assert torch.equal(G.remap(x, u[:1], v[:1])[:1], y[:1])
                assert torch.equal(G.remap(x.repeat(40, 1, 1, 1), u.repeat(40, 1, 1), v.repeat(40, 1, 1))[-2:], y)
                assert torch.equal(G.remap(x, u.mT.contiguous().mT, v), y)
                assert torch.equal(G.remap(x, u[..., 1:], v[..., 1:]), y[..., 1:])


def test_maps_of_midway_and_of_no_coordinates(device):
    x = noise((2, 3, 37, 53))
    y, x_at = torch.meshgrid(torch.arange(37.0), torch.arange(53.0), indexing="ij")
    u, v = (x_at + 0.5).repeat(2, 1, 1), (y - 0.5).repeat(2, 1, 1)
    assert map_errors(x, u, v, device).max() <= 0.5
    if device.type == "cuda":
        even = G.remap(x.double(), u.double(), v.double()).round().to(torch.uint8)
        assert torch.equal(G.remap(x.to(device), u.to(device), v.to(device)).cpu(), even)
    u[:, ::5, ::3], v[:, ::7, ::2] = float("nan"), -1e9
    for padding in ("zeros", "border"):
        assert map_errors(x, u, v, device, padding_mode=padding).max() <= 0.5


def test_means_midway_between_levels_are_rounded_to_the_even_one(device):
    x, M = noise((2, 3, 37, 53)), torch.eye(3).repeat(2, 1, 1)
    M[:, :2, 2] = 0.5
    y = G.warp_perspective(x.to(device), M.to(device), (37, 53)).cpu()
    assert torch.equal(y, G.warp_perspective(x.double(), M.double(), (37, 53)).round().to(torch.uint8))


def test_a_graph_captures_the_warp(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    x, M = noise((2, 3, 37, 53)).to(device), matrices("turned", 2, 1.3).to(device)
    expected = G.warp_perspective(x, M, (70, 41))
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        y = G.warp_perspective(x, M, (70, 41))
    y.zero_()
    graph.replay()
    assert torch.equal(y, expected)
