"""Inherited tests of functions composed of other operators. Functions with a dedicated kernel: op_tests.py.

    class TestCompositions(CompositionTests):
        cases = {"guided_blur": Case(lambda g, x: F.guided_blur(g, x, 3, 0.1), (IMAGE, IMAGE))}

A case is a call and the shapes of its tensors. Every test that takes `case` runs once for each, those of a subclass too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

from op_tests import assert_close, named


class Case(NamedTuple):
    call: Callable[..., Tensor]
    shapes: tuple[tuple[int, ...], ...]  # of the tensors; the first is an image and sets the dtype of the result
    shared: tuple[int, ...] = ()  # indices of tensors without the batch axis
    differentiable: bool = True


@cache
def _copied(device: torch.device, constant: Tensor) -> Tensor:
    return constant.to(device)


def on(device: torch.device, constant: Tensor) -> Tensor:
    """A constant of a test on a device: copied once, since the capture of a CUDA graph allows no copy from the host."""
    return constant.to(device) if torch.compiler.is_compiling() else _copied(device, constant)


class CompositionTests:
    cases: dict[str, Case]
    compiled: tuple[str, ...] | None = None  # the cases that are compiled; default: all

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        if "name" in metafunc.fixturenames:
            metafunc.parametrize("name", self.cases)

    @pytest.fixture
    def case(self, name: str) -> Case:
        return self.cases[name]

    def values(self, case: Case, device: Any, dtype: torch.dtype = torch.float64) -> list[Tensor]:
        """Random tensors in [0.1, 1)."""
        return [(0.9 * torch.rand(shape, dtype=torch.float64) + 0.1).to(dtype).to(device) for shape in case.shapes]

    def needs_gradient(self, case: Case) -> None:
        if not case.differentiable:
            pytest.skip("not differentiable")

    @pytest.mark.derivatives
    def test_derivatives(self, case, device):
        self.needs_gradient(case)
        values = [v.requires_grad_() for v in self.values(case, device)]
        # fast_mode checks along random directions. On CUDA torch sums some gradients in any order.
        noise = 0.0 if device.type == "cpu" else 1e-9
        assert torch.autograd.gradcheck(case.call, values, check_forward_ad=True, fast_mode=True, nondet_tol=noise)
        assert torch.autograd.gradgradcheck(case.call, values, fast_mode=True, nondet_tol=noise)

    def test_transforms(self, case, device):
        first, second = self.values(case, device), self.values(case, device)
        mapped = torch.func.vmap(case.call)(*map(torch.stack, zip(first, second)))
        assert_close(mapped, torch.stack([case.call(*first), case.call(*second)]))
        if not case.differentiable:
            return

        def loss(*values: Tensor) -> Tensor:
            return case.call(*values).square().sum()

        leaf = first[0].clone().requires_grad_()
        assert_close(torch.func.grad(loss)(*first), torch.autograd.grad(loss(leaf, *first[1:]), leaf)[0])

    @pytest.mark.tracing
    @pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")
    def test_compiles_with_dynamic_batch(self, name, case, device):
        """Values and gradients of one graph. test_dynamic_sweep.py exports every public function."""
        if name not in (self.cases if self.compiled is None else self.compiled):
            pytest.skip("others stand for it")
        torch._dynamo.reset()
        compiled = torch.compile(case.call, fullgraph=True, backend="aot_eager")
        values = self.values(case, device)
        batches = [values]
        if case.shapes[0][0] > 1:
            batched = [i not in case.shared for i in range(len(values))]
            batches.append([torch.cat([v, v[:1]]) if b else v for v, b in zip(values, batched)])
            for v, b in zip(values, batched):
                if b:
                    torch._dynamo.mark_dynamic(v, 0)
        for batch in batches:
            leaves = [v.clone().requires_grad_(case.differentiable) for v in batch]
            expected, actual = case.call(*leaves), compiled(*leaves)
            assert_close(actual, expected)
            if case.differentiable:
                assert_close(*(torch.autograd.grad(y.square().sum(), leaves) for y in (actual, expected)))

    @pytest.mark.interface
    def test_autocast_changes_nothing(self, case, device):
        values = self.values(case, device, torch.float32)
        expected = case.call(*values)
        with torch.autocast(device.type, dtype=torch.bfloat16):
            assert_close(case.call(*values), expected)

    def test_no_images(self, case, device):
        values = [v if i in case.shared else v[:0] for i, v in enumerate(self.values(case, device))]
        values = [v.requires_grad_() for v in values]
        y = case.call(*values)
        assert y.shape[0] == 0
        if y.requires_grad:
            y.sum().backward()
            assert values[0].grad.shape == values[0].shape

    @pytest.mark.interface
    def test_input_is_not_modified(self, case, device):
        """A result does not alias its input either."""
        values = self.values(case, device)
        before, versions = [v.clone() for v in values], [v._version for v in values]
        case.call(*values).add_(1)
        assert versions == [v._version for v in values]
        assert all(torch.equal(a, b) for a, b in zip(values, before))

    def test_layouts(self, case, device):
        values = self.values(case, device)
        expected = case.call(*values)
        strided = [v.repeat_interleave(2, -1)[..., ::2] for v in values]
        last = [v.contiguous(memory_format=torch.channels_last) if v.dim() == 4 else v for v in values]
        for name, some in (("strided", strided), ("channels_last", last)):
            with named(name):
                assert_close(case.call(*some), expected)

    @pytest.mark.interface
    @pytest.mark.gpu
    def test_cuda_graph(self, case, device):
        values = self.values(case, device, torch.float32)
        side = torch.cuda.Stream()
        with torch.cuda.stream(side):
            case.call(*values)
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            captured = case.call(*values)
        for v, new in zip(values, self.values(case, device, torch.float32)):
            v.copy_(new)
        graph.replay()
        assert_close(captured, case.call(*values))
