"""Export and compilation with dynamic batch, height and width: symbolic sizes, and NumPy's integers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn
from torch.export import Dim

import kvision as K
from op_tests import assert_close

pytestmark = pytest.mark.interface

G = K.geometry
HOMOGRAPHY = torch.tensor([[[1.0, 0.1, 1.0], [0.05, 1.0, -1.0], [0.0, 0.0, 1.0]]])

CALLS = {
    "resize": lambda x: G.resize(x, (x.shape[-2] // 2, x.shape[-1] * 3 // 2)),
    "resize-vert": lambda x: G.resize(x, x.shape[-2] // 2, side="vert"),
    "resize-short": lambda x: G.resize(x, 10),
    "resize-long": lambda x: G.resize(x, 10, side="long"),
    "warp_perspective": lambda x: G.warp_perspective(x, HOMOGRAPHY.to(x), (x.shape[-2] // 2, x.shape[-1])),
    "homography_warp": lambda x: G.homography_warp(x, HOMOGRAPHY.to(x), (x.shape[-2], x.shape[-1] // 2)),
    "center_crop": lambda x: G.center_crop(x, (x.shape[-2] // 2, x.shape[-1] // 2)),
    "create_meshgrid": lambda x: x[:, 0, :, :, None] + G.create_meshgrid(x.shape[-2], x.shape[-1], device=x.device),
    "resize_to_be_divisible": lambda x: G.resize_to_be_divisible(x, 4),
    "rescale": lambda x: G.rescale(x, (0.5, 1.3)),
    "rotate": lambda x: G.rotate(x, torch.tensor(20.0, device=x.device)),
    "pyrdown": G.pyrdown,
    "extract_tensor_patches": lambda x: K.contrib.extract_tensor_patches(x, (4, 5), stride=2, padding=1),
}


class Call(nn.Module):
    def __init__(self, call):
        super().__init__()
        self.call = call

    def forward(self, x):
        return self.call(x)


@pytest.mark.tracing
@pytest.mark.parametrize("name", CALLS)
def test_export_with_dynamic_batch_and_size(name, device):
    """A graph exported at one size gives the eager values at others: odd, even, larger, transposed."""
    x = torch.rand(2, 3, 20, 24, device=device)
    axes = {0: Dim("B", min=1), 2: Dim("H", min=8), 3: Dim("W", min=8)}
    graph = torch.export.export(Call(CALLS[name]), (x,), dynamic_shapes=(axes,)).module()
    for b, h, w in ((2, 20, 24), (3, 33, 26), (1, 17, 45)):
        x = torch.rand(b, 3, h, w, device=device)
        assert_close(graph(x), CALLS[name](x))


@pytest.mark.tracing
def test_compile_with_dynamic_sizes(device):
    """Values and gradients, through one graph for all sizes."""
    torch._dynamo.reset()
    graphs = []

    def backend(graph, inputs):
        graphs.append(graph)
        return graph.forward

    call = torch.compile(CALLS["resize"], dynamic=True, fullgraph=True, backend=backend)
    for h, w in ((20, 24), (33, 26), (17, 45)):
        x = torch.rand(2, 3, h, w, device=device, requires_grad=True)
        y, expected = call(x), CALLS["resize"](x)
        assert_close(y, expected)
        assert_close(*(torch.autograd.grad(z.square().sum(), x)[0] for z in (y, expected)))
    assert len(graphs) == 1


NUMBERS = {
    "gaussian_blur2d": lambda x, n: K.filters.gaussian_blur2d(x, (5, 5), (n, n + 0.1)),
    "bilateral_blur": lambda x, n: K.filters.bilateral_blur(x, (3, 3), n, (n, n)),
    "unsharp_mask": lambda x, n: K.filters.unsharp_mask(x, (5, 5), (n, n)),
    "motion_blur": lambda x, n: K.filters.motion_blur(x, 3, 90 * n, n),
    "canny": lambda x, n: K.filters.canny(x, n, 2.0)[0],
    "adjust_gamma": lambda x, n: K.enhance.adjust_gamma(x, n),
    "adjust_hue": lambda x, n: K.enhance.adjust_hue(x, n),
    "psnr": lambda x, n: K.metrics.psnr(x, x.flip(0), n),
}


@pytest.mark.tracing
@pytest.mark.parametrize("name", NUMBERS)
def test_compile_with_dynamic_numbers(name, device, backend):
    """Two graphs serve all numbers and sizes, values and gradients."""
    from torch._dynamo.testing import CompileCounterWithBackend

    if backend == "reference":
        pytest.skip("references are plain torch, which compiles again for some numbers")
    if name == "psnr" and torch.__version__.startswith("2.11"):
        pytest.skip("torch 2.11 compiles x * (0.1 * n) again for every n")
    torch._dynamo.reset()
    counter = CompileCounterWithBackend("aot_eager")
    call, compiled = NUMBERS[name], torch.compile(NUMBERS[name], fullgraph=True, backend=counter)
    for i, number in enumerate((0.3, 0.41, 0.37, 0.5)):
        x = torch.rand(2 + i, 3, 9 + i, 11 + i, device=device, requires_grad=True)
        values = [f(x, number) for f in (compiled, call)]
        assert_close(*values)
        assert_close(*(torch.autograd.grad(y.square().sum(), x)[0] for y in values), 1e-4, 1e-5)
    assert counter.frame_count <= 2


@pytest.mark.tracing
@pytest.mark.parametrize("warp", [G.warp_perspective, G.warp_affine, G.homography_warp])
def test_compile_with_matrices_of_a_constant_batch(warp, device):
    """The matrices fit a batch of two, whatever its size; for other batches the error is that of the function."""
    torch._dynamo.reset()
    matrices = HOMOGRAPHY.to(device, torch.float32).expand(2, 3, 3)
    if warp is G.warp_affine:
        matrices = matrices[:, :2]
    compiled = torch.compile(lambda x: warp(x, matrices, (8, 9)), dynamic=True, fullgraph=True, backend="eager")
    for h, w in ((20, 24), (33, 26)):
        x = torch.rand(2, 3, h, w, device=device)
        assert_close(compiled(x), warp(x, matrices, (8, 9)))
    name = warp.__name__
    message = rf"ShapeError\((\(\)|.{name}: expected \w+ with a batch size of 1 or )"  # torch 2.11 leaves it out
    with pytest.raises(torch._dynamo.exc.Unsupported, match=message):
        compiled(torch.rand(5, 3, 20, 24, device=device))


def test_sizes_may_be_numpy_integers(device):
    x = torch.rand(1, 3, 9, 12, device=device)
    four, five = np.int64(4), np.int32(5)
    matrix = HOMOGRAPHY.to(device)
    for call in (
        lambda h, w: G.resize(x, (h, w)),
        lambda h, w: G.resize(x, h),
        lambda h, w: G.warp_perspective(x, matrix, (h, w)),
        lambda h, w: G.homography_warp(x, matrix, (h, w)),
        lambda h, w: G.center_crop(x, (h, w)),
        lambda h, w: G.create_meshgrid(h, w),
        lambda h, w: G.resize_to_be_divisible(x, h),
        lambda h, w: K.contrib.extract_tensor_patches(x, (h, w), stride=h, padding=w),
        lambda h, w: K.filters.box_blur(x, (w, w)),
    ):
        assert torch.equal(call(four, five), call(4, 5))


@pytest.mark.parametrize("size", [True, (True, 2), 2.0, (2, np.float32(2)), np.bool_(True), "22", ()])
def test_sizes_of_other_kinds_are_refused(size):
    with pytest.raises(TypeError, match="resize: expected size to be an int or 2 ints, got "):
        G.resize(torch.rand(1, 1, 4, 4), size)


@pytest.mark.parametrize("size", [np.int64(0), (np.int64(4), np.int64(2**40)), (np.int64(2),)])
def test_numpy_integers_out_of_range_are_refused(size):
    with pytest.raises(ValueError, match="resize: expected size to be an int"):
        G.resize(torch.rand(1, 1, 4, 4), size)


EYE = torch.eye(3)[None]
WIDE = 40000  # more pixels than a filter's window may have
CORNERS = torch.tensor([[[0.0, 0], [WIDE - 1, 0], [WIDE - 1, 1], [0, 1]]])
LARGE = {
    "resize": lambda x: G.resize(x, (2, WIDE)),
    "rescale": lambda x: G.rescale(x, (1.0, WIDE / x.shape[-1])),
    "warp_perspective": lambda x: G.warp_perspective(x, EYE.to(x.device), (2, WIDE)),
    "warp_affine": lambda x: G.warp_affine(x, EYE[:, :2].to(x.device), (2, WIDE)),
    "homography_warp": lambda x: G.homography_warp(x, EYE.to(x.device), (2, WIDE)),
    "center_crop": lambda x: G.center_crop(x, (2, WIDE)),
    "crop_and_resize": lambda x: G.crop_and_resize(x, CORNERS.to(x.device), (2, WIDE)),
    "crop_by_boxes": lambda x: G.crop_by_boxes(x, CORNERS.to(x.device), CORNERS.to(x.device)),
    "extract_tensor_patches": lambda x: K.contrib.extract_tensor_patches(x, (2, WIDE), stride=WIDE)[:, 0],
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8])
@pytest.mark.parametrize("name", LARGE)
def test_results_larger_than_a_window(name, dtype, device):
    """Rows of 40000 pixels, and their transpose where sizes are arguments; windows of filters keep their limit."""
    x = (torch.arange(4 * WIDE, device=device) % 251).to(dtype).reshape(1, 1, 2, 2 * WIDE)
    y = LARGE[name](x)
    assert y.shape == (1, 1, 2, WIDE)
    if name in ("warp_perspective", "warp_affine", "crop_by_boxes", "extract_tensor_patches"):
        assert_close(y, x[..., :WIDE])
    with pytest.raises(ValueError, match="box_blur: expected kernel_size to be an int or 2 ints of at most 32767"):
        K.filters.box_blur(x, (1, WIDE))


def test_columns_larger_than_a_window(device):
    x = torch.rand(1, 1, 2 * WIDE, 2, device=device)
    assert_close(G.warp_perspective(x, EYE.to(x.device), (WIDE, 2)), x[:, :, :WIDE])
    halves = (x[:, :, 0::2] + x[:, :, 1::2]) / 2
    assert_close(G.resize(x, (WIDE, 2)), halves)
