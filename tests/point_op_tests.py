"""Inherited tests of operators on points and small matrices. Operators on images: op_tests.py.

    class TestEulerOperators(PointOpTests):
        calls = {"quaternion_from_euler": [Call((NUMBER,) * 3)]}

`calls` has a list of calls for each operator, by its name in torch.ops.kvision. Backward operators need no
separate calls, because gradients use them. `operators` lists them for the check in test_suites.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

import kvision as K
import raw_calls
from kvision import _ops
from op_tests import (
    TOLERANCES,
    as_tuple,
    assert_close,
    fake_differs,
    instruction_set,
    instruction_sets,
    named,
    recorded,
    with_layout,
)

BATCH = 3
SINGLE_AND_DOUBLE = (torch.float32, torch.float64)


class Call(NamedTuple):
    inputs: tuple[Callable[[], Tensor] | Tensor | None, ...]  # creates a sample's row; a tensor is shared; None
    options: (
        tuple[Any, ...] | Callable[[int], tuple[Any, ...]]
    ) = ()  # a function of the batch size where they depend on it
    broadcasts: bool = True  # whether an input of one row serves all samples
    per_sample: bool = True  # whether a sample's result depends on its own rows alone
    differentiable: bool = True
    dtypes: tuple[torch.dtype, ...] = _ops.FLOATS
    tolerance: float = 4  # multiple of TOLERANCES
    accepted: tuple[str, ...] = ()  # parts of names of calls in raw_calls.py that are valid here
    compared: Callable[..., Any] = lambda *results: results  # the part of the results that is unique


def vector(*sizes: int, scale: float = 1.0) -> Callable[[], Tensor]:
    """Numbers in [0.1, 1), scaled."""
    return lambda: scale * (0.9 * torch.rand(sizes, dtype=torch.float64) + 0.1)


def near(x: Tensor, distance: float = 0.2) -> Callable[[], Tensor]:
    return lambda: x + distance * torch.rand_like(x)


NUMBER, DEGREES, SMALL = vector(), vector(scale=100), vector(scale=0.3)
EYE, EYE34 = torch.eye(3, dtype=torch.float64), torch.eye(3, 4, dtype=torch.float64)
SQUARE = torch.tensor([[0.0, 0], [4, 0], [4, 3], [0, 3]], dtype=torch.float64)
CUBE = torch.tensor([[0.0, 1, 1, 0] * 2, [0.0, 0, 1, 1] * 2, [0.0] * 4 + [1.0] * 4], dtype=torch.float64).T


@pytest.mark.native
class PointOpTests:
    calls: dict[str, list[Call]]
    operators: tuple[str, ...]  # all operators that the calls and their gradients use

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        names = [name for name in cls.__dict__.get("calls", ())]
        cls.operators = tuple(n for name in names for n in (name, f"{name}_backward") if n in _ops.operators)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        if "call" in metafunc.fixturenames:
            cases = [pytest.param(n, c, id=f"{n}-{i}") for n, calls in self.calls.items() for i, c in enumerate(calls)]
            metafunc.parametrize("name, call", cases)

    # --- helpers ---

    def rows(self, call: Call, batch: int, device: Any, dtype: torch.dtype = torch.float64) -> list[Tensor | None]:
        made = [torch.stack([f() for _ in range(batch)]) if callable(f) else f for f in call.inputs]
        return [x if x is None else self.cast(x, dtype).to(device) for x in made]

    def cast(self, x: Tensor, dtype: torch.dtype) -> Tensor:
        return x.to(dtype) if x.is_floating_point() or not dtype.is_floating_point else x

    def batched(self, call: Call) -> list[int]:
        """The inputs that have a row for every sample."""
        return [i for i, f in enumerate(call.inputs) if callable(f)]

    def options(self, call: Call, args: Sequence[Tensor | None]) -> tuple[Any, ...]:
        return call.options(len(args[self.batched(call)[0]])) if callable(call.options) else call.options

    def of_tensors(self, name: str, call: Call, args: list[Tensor | None]) -> Callable[..., tuple[Tensor, ...]]:
        """The operator as a function of its floating-point tensors, to the results that are unique."""
        where = [i for i, x in enumerate(args) if x is not None and x.is_floating_point()]
        options = self.options(call, args)

        def f(*values: Tensor) -> tuple[Tensor, ...]:
            full = list(args)
            for i, value in zip(where, values):
                full[i] = value
            return as_tuple(call.compared(*as_tuple(_ops.operators[name](*full, *options))))

        return f

    def floats(self, args: list[Tensor | None]) -> list[Tensor]:
        return [x for x in args if x is not None and x.is_floating_point()]

    def with_gradients(self, name: str, call: Call, args: list[Tensor | None]) -> list[Tensor]:
        """The results without and with a graph, and the gradients of a weighted sum of them.

        With a graph the reference may serve instead of the kernel (`supports`)."""
        leaves = [x.detach().requires_grad_(call.differentiable) for x in self.floats(args)]
        f = self.of_tensors(name, call, args)
        with torch.no_grad():
            values = list(f(*leaves))
        if not call.differentiable:
            return values
        results = f(*leaves)
        total = sum((y * self.weights_like(y)).sum() for y in results if y.requires_grad)
        return [*values, *(y.detach() for y in results), *torch.autograd.grad(total, leaves)]

    def weights_like(self, y: Tensor) -> Tensor:
        steps = torch.linspace(-1, 1, y.numel(), dtype=torch.float64, device=y.device)
        return steps.reshape(y.shape).to(y.dtype)

    def expected(self, name: str, call: Call, args: list[Tensor | None], dtype: torch.dtype) -> list[Tensor]:
        promoted = [x.double() if x is not None and x.is_floating_point() else x for x in args]
        with K.backend("reference"):
            results = self.with_gradients(name, call, promoted)
        return [y.to(dtype) if y.dtype == torch.float64 else y for y in results]

    def check(self, call: Call, actual: list[Tensor], expected: list[Tensor]) -> None:
        for a, e in zip(actual, expected, strict=True):
            scale = max(1.0, float(e.double().nan_to_num(0, 0, 0).abs().max())) if e.numel() else 1.0
            relative, absolute = TOLERANCES.get(a.dtype, (0, 0))
            assert_close(a, e, call.tolerance * relative, call.tolerance * absolute * scale)

    def needs_kernels(self, backend: str, device: torch.device, on: str = "") -> None:
        if backend == "reference" or (on and device.type != on):
            pytest.skip(f"this test is about the kernels{' of the CPU' if on else ''}")

    # --- values ---

    def test_values_and_gradients(self, name, call, device):
        """In each type that the operator has kernels for."""
        for dtype in dict.fromkeys(call.dtypes):
            torch.manual_seed(0)
            args = self.rows(call, BATCH, device, dtype)
            with named(str(dtype)):
                self.check(call, self.with_gradients(name, call, args), self.expected(name, call, args, dtype))

    def test_one_row_serves_all(self, name, call, device):
        if not call.broadcasts or len(self.batched(call)) < 2:
            pytest.skip("every input has a row for each sample")
        args = self.rows(call, BATCH, device)
        for kept in self.batched(call):
            some = [x[:1] if i in self.batched(call) and i != kept else x for i, x in enumerate(args)]
            self.check(call, self.with_gradients(name, call, some), self.expected(name, call, some, torch.float64))

    def test_any_batch(self, name, call, device, backend):
        """Kernels vectorize over samples. Empty batches, single samples and remainders are computed as well."""
        self.needs_kernels(backend, device, "cpu")
        dtype = call.dtypes[0]
        args = self.rows(call, 9, device, dtype)
        # 7 samples are a vector and a remainder of three.
        batches = [
            [x[:batch] if i in self.batched(call) else x for i, x in enumerate(args)]
            for batch in ((0, 1, 7) if call.per_sample else (9,))
        ]
        expected = [self.expected(name, call, some, dtype) for some in batches]
        for isa in instruction_sets(device, backend):
            with instruction_set(isa), named(str(isa)):
                whole = self.with_gradients(name, call._replace(differentiable=False), args)
                for some, of_some in zip(batches, expected):
                    self.check(call, self.with_gradients(name, call, some), of_some)
                    first = self.with_gradients(name, call._replace(differentiable=False), some)
                    assert all(torch.equal(a.nan_to_num(), b[: len(a)].nan_to_num()) for a, b in zip(first, whole))

    def test_threads_and_runs_give_the_same_bits(self, name, call, device, backend):
        self.needs_kernels(backend, device)
        args = self.rows(call, 67, device, call.dtypes[0])
        threads, results = torch.get_num_threads(), []
        try:
            for n in (1, 2, 2):
                torch.set_num_threads(n)
                results.append(self.with_gradients(name, call, args))
        finally:
            torch.set_num_threads(threads)
        for other in results[1:]:
            assert all(torch.equal(a.nan_to_num(), b.nan_to_num()) for a, b in zip(results[0], other))

    def test_strides(self, name, call, device):
        args = self.rows(call, BATCH, device, call.dtypes[-1])
        spread = [None if x is None else x.repeat_interleave(2, 0)[::2] for x in args]
        spread = [x if x is None or x.dim() == 1 else x.repeat_interleave(2, -1)[..., ::2] for x in spread]
        results = [self.with_gradients(name, call._replace(differentiable=False), x) for x in (spread, args)]
        for a, b in zip(*results):
            assert_close(a, b, 0, 0)

    @pytest.mark.interface
    def test_inputs_are_not_modified(self, name, call, device):
        args = self.rows(call, BATCH, device, call.dtypes[0])
        before = [None if x is None else x.clone() for x in args]
        self.with_gradients(name, call, args)
        assert all(x is None or torch.equal(x, y) for x, y in zip(args, before))

    # --- derivatives and transforms ---

    @pytest.mark.derivatives
    def test_derivatives(self, name, call, device):
        if not call.differentiable:
            pytest.skip("not differentiable")
        args = self.rows(call, 2, device)
        leaves = [x.requires_grad_() for x in self.floats(args)]
        f = self.of_tensors(name, call, args)
        assert torch.autograd.gradcheck(f, leaves, fast_mode=True, check_forward_ad=True)
        # Second derivatives are torch's, whose scattered additions on CUDA have no fixed order.
        assert torch.autograd.gradgradcheck(f, leaves, fast_mode=True, nondet_tol=1e-12 if device.type == "cuda" else 0)

    @pytest.mark.interface
    def test_vmap(self, name, call, device):
        if not call.per_sample:
            pytest.skip("the batch is not one of samples")
        args = [self.rows(call, 2, device, call.dtypes[-1]) for _ in range(3)]
        axes = tuple(0 if i in self.batched(call) else None for i in range(len(call.inputs)))
        stacked = [torch.stack(x) if axis == 0 else x[0] for x, axis in zip(zip(*args), axes)]

        options = self.options(call, args[0])

        def f(*values: Tensor) -> tuple[Tensor, ...]:
            return as_tuple(call.compared(*as_tuple(_ops.operators[name](*values, *options))))

        mapped = torch.func.vmap(f, axes)(*stacked)
        self.check(call, list(mapped), [torch.stack(y) for y in zip(*(f(*x) for x in args))])

    @pytest.mark.tracing
    def test_compile(self, device, backend):
        """All calls in one graph, values and gradients."""
        cases = [(name, calls[0]) for name, calls in self.calls.items()]
        args = [self.rows(call, BATCH, device, call.dtypes[0]) for _, call in cases]
        leaves = [[x.requires_grad_(call.differentiable) for x in self.floats(a)] for a, (_, call) in zip(args, cases)]

        functions = [self.of_tensors(name, call, a) for (name, call), a in zip(cases, args)]

        def f(leaves: list[list[Tensor]]) -> list[tuple[Tensor, ...]]:
            return [function(*x) for function, x in zip(functions, leaves)]

        torch._dynamo.reset()
        compiled = torch.compile(f, fullgraph=True, backend="eager" if backend == "reference" else "aot_eager")
        results = [compiled(leaves), f(leaves)]
        for (_, call), actual, expected in zip(cases, *results):
            self.check(call, [y.detach() for y in actual], [y.detach() for y in expected])
        every = [x for some in leaves for x in some if x.requires_grad]
        if every:
            totals = [sum((y * self.weights_like(y)).sum() for y in sum(r, ()) if y.requires_grad) for r in results]
            loosest = max((call for _, call in cases), key=lambda call: call.tolerance)
            self.check(loosest, *(list(torch.autograd.grad(total, every)) for total in totals))

    # --- as torch's operators ---

    def test_as_operators(self, name, call, device, backend):
        """The operator and its backward operators: schemas, fake results, and bad arguments, which C++ rejects."""
        self.needs_kernels(backend, device)
        with recorded() as calls:
            self.with_gradients(name, call, self.rows(call, BATCH, device, call.dtypes[0]))
        assert name in dict(calls)
        wrong: list[Any] = []
        for called, args in dict(calls).items():
            if called not in self.operators:
                continue
            operator = getattr(torch.ops.kvision, called).default
            args = [a.detach() if isinstance(a, Tensor) else a for a in args]
            torch.library.opcheck(operator, tuple(args), test_utils=("test_schema", "test_faketensor"))
            images = [i for i, a in enumerate(args) if isinstance(a, Tensor) and a.dim() == 4]
            for layouts in itertools.product(("contiguous", "channels_last"), repeat=len(images)):
                in_layouts = list(args)
                for i, layout in zip(images, layouts):
                    in_layouts[i] = with_layout(args[i], layout)
                assert not fake_differs(called, in_layouts)
            if max(a.dim() for a in args if isinstance(a, Tensor)) < 2:
                continue  # a wrong shape for rows is valid for numbers
            fine = ("without rows", "without columns", *call.accepted)
            every = raw_calls.wrong_calls(operator, args)
            wrong += [(operator, call) for call in every if not any(f in call[0] for f in fine)]
        taken = raw_calls.taken(wrong)
        assert not taken, "\n".join(taken)
