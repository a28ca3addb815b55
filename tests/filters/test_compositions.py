"""What every filter without kernels of its own inherits from torch and the operators it is made of, and must keep."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close

F = K.filters


class Case(NamedTuple):
    call: Callable[..., Tensor]
    shapes: tuple[tuple[int, ...], ...]  # of its tensors, which are random in [0.1, 1)
    per_image: tuple[int, ...] = (0,)  # those with a batch; the first is an image and sets the type of the result


IMAGE, VOLUME = (2, 2, 6, 5), (1, 2, 3, 4, 3)
CASES = {
    "fft_conv": Case(lambda x, k: F.fft_conv(x, k, normalized=True), (IMAGE, (1, 3, 2))),
    "fft_conv_each": Case(lambda x, k: F.fft_conv(x, k, "circular", behaviour="conv"), (IMAGE, (2, 3, 3)), (0, 1)),
    "guided_blur": Case(lambda g, x: F.guided_blur(g, x, 3, 0.1), (IMAGE, (2, 1, 6, 5)), (0, 1)),
    "guided_blur_fast": Case(
        lambda g, x, eps: F.guided_blur(g, x, 3, eps, "replicate", 2), (IMAGE, IMAGE, (2,)), (0, 1, 2)
    ),
    "motion_blur": Case(lambda x, d: F.motion_blur(x, 3, 33.0, d), (IMAGE, (1,))),
    "motion_blur_each": Case(
        lambda x, a, d: F.motion_blur(x, 3, 100 * a, d, "replicate", "bilinear"), (IMAGE, (2,), (2,)), (0, 1, 2)
    ),
    "motion_blur3d": Case(
        lambda x, a, d: F.motion_blur3d(x, 3, 100 * a, d, mode="bilinear"), (VOLUME, (1, 3), (1,)), (0, 1, 2)
    ),
    "blur_pool2d": Case(lambda x: F.blur_pool2d(x, 3), (IMAGE,)),
    "max_blur_pool2d": Case(lambda x: F.max_blur_pool2d(x, 3), (IMAGE,)),
    "edge_aware_blur_pool2d": Case(lambda x: F.edge_aware_blur_pool2d(x, 3, 3.0), (IMAGE,)),
    "in_range": Case(lambda x: F.in_range(x, (0.2, 0.3), (0.8, 0.9)), (IMAGE,)),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


def tensors(case: Case, device: torch.device, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    return [(torch.rand(shape, dtype=torch.float64) * 0.9 + 0.1).to(dtype).to(device) for shape in case.shapes]


def test_derivatives(case, device):
    values = [v.requires_grad_() for v in tensors(case, device)]
    assert torch.autograd.gradcheck(case.call, values, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(case.call, values)


def test_transforms(case, device):
    first, second = tensors(case, device), tensors(case, device)
    mapped = torch.func.vmap(case.call)(*map(torch.stack, zip(first, second)))
    assert_close(mapped, torch.stack([case.call(*first), case.call(*second)]))

    def loss(*values: Tensor) -> Tensor:
        return case.call(*values).square().sum()

    leaf = [first[0].clone().requires_grad_(), *first[1:]]
    (expected,) = torch.autograd.grad(loss(*leaf), leaf[0])
    assert_close(torch.func.grad(loss)(*first), expected)


@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")
def test_compiles_and_exports_whole_with_any_batch(case, device):
    torch._dynamo.reset()
    compiled = torch.compile(case.call, fullgraph=True, backend="aot_eager")

    class Program(torch.nn.Module):
        def forward(self, *values: Tensor) -> Tensor:
            return case.call(*values)

    values = tensors(case, device)
    grown = [torch.cat([v, v[:1]]) if i in case.per_image else v for i, v in enumerate(values)]
    if case.shapes[0][0] > 1:
        batch = torch.export.Dim("batch")
        axes = tuple({0: batch} if i in case.per_image else None for i in range(len(values)))
        for i in case.per_image:
            torch._dynamo.mark_dynamic(values[i], 0)
    else:
        axes, grown = None, values
    program = torch.export.export(Program(), tuple(values), dynamic_shapes=axes and {"values": axes}).module()
    for given in (values, grown):
        given = [v.clone().requires_grad_() for v in given]
        expected = case.call(*given)
        assert_close(compiled(*given), expected)
        assert_close(program(*given), expected)
        weights = torch.rand_like(expected)
        for a, e in zip(*(torch.autograd.grad((y * weights).sum(), given) for y in (compiled(*given), expected))):
            assert_close(a, e)


def test_number_types(case, device):
    exact = tensors(case, device)
    single = [v.float() for v in exact]
    expected = case.call(*single)
    assert_close(expected, case.call(*exact).float())
    with torch.autocast(device.type, dtype=torch.bfloat16):
        assert_close(case.call(*single), expected)
    for dtype in (torch.float16, torch.bfloat16):
        images = [v.to(dtype) if v.dim() > 3 else v for v in single]
        assert case.call(*images).dtype == dtype
        if case is not CASES["in_range"]:  # a bound in a coarse type is another bound
            assert_close(case.call(*images), case.call(*[v.float() for v in images]).to(dtype))


@pytest.mark.parametrize("empty", [0, 1], ids=["no images", "no channels"])
def test_empty(case, empty, device):
    if empty == 1 and case is CASES["in_range"]:
        pytest.skip("its bounds count the channels")
    values = []
    for i, v in enumerate(tensors(case, device)):
        whole = v[:0] if empty == 0 and i in case.per_image else v
        values.append(whole[:, :0] if empty == 1 and v.dim() > 3 else whole)
    values = [v.requires_grad_() for v in values]
    y = case.call(*values)
    assert y.numel() == 0 and y.dim() == values[0].dim()
    y.sum().backward()
    assert values[0].grad.shape == values[0].shape


def test_input_is_not_modified(case, device):
    values = tensors(case, device)
    before = [v.clone() for v in values]
    case.call(*values)
    assert all(torch.equal(a, b) for a, b in zip(values, before))


@pytest.mark.parametrize("layout", ["channels_last", "strided"])
def test_layouts(case, layout, device):
    values = tensors(case, device)
    expected = case.call(*values)
    for i, v in enumerate(values):
        if layout == "strided":
            values[i] = v.repeat_interleave(2, -1)[..., ::2]
        elif v.dim() == 4:
            values[i] = v.contiguous(memory_format=torch.channels_last)
    assert_close(case.call(*values), expected)


def test_cuda_graph(case, device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    values = tensors(case, device, torch.float32)
    side = torch.cuda.Stream()
    with torch.cuda.stream(side):
        case.call(*values)
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        captured = case.call(*values)
    for v, new in zip(values, tensors(case, device, torch.float32)):
        v.copy_(new)
    graph.replay()
    assert_close(captured, case.call(*values))
