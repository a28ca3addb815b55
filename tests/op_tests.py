"""Inherited tests of every operator. An operator's test file subclasses OpTests and declares its calls.

    class TestSobel(OpTests):
        function = staticmethod(K.filters.sobel)
        module = K.filters.Sobel
        operators = ("sobel", "sobel_backward")
        variants = [{}, {"normalized": False}]

A variant is a dict of keyword arguments; those of filters are in the table of sample calls, where other tests read them, too.
A tensor is given by its axes, `"kernel": rand("B 3 3")`, or by a function of the input, `"img2": lambda x: x.flip(-1)`. It is
moved to the input's device and takes part in the gradient tests.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given, settings
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode

import kvision as K
import raw_calls
from benchmarks.sample_calls.model import Axes, Size
from kvision import _backend, _ops

# All cases of tests that take a part of them in CI, and more of random ones.
THOROUGH = os.environ.get("HYPOTHESIS_PROFILE") == "thorough"
# Of random ones few, on the CPU: the profile of CI has ten times as many of them there.
QUICK = os.environ.get("HYPOTHESIS_PROFILE", "quick") == "quick"

# The one table of tolerances: (relative, absolute) by the type results are stored in.
TOLERANCES = {
    torch.float64: (1e-9, 1e-9),
    torch.float32: (2e-5, 2e-6),
    torch.float16: (2e-3, 2e-3),
    torch.bfloat16: (1.6e-2, 1.6e-2),
    torch.uint8: (0, 0),
}
# Tolerance of parameter gradients, float32 sums of thousands of products, relative to the largest result.
PARAMETER_TOLERANCE = 1e-4

INSTRUCTION_SETS = ("baseline", "avx2", "avx512")
LAYOUTS = ("contiguous", "channels_last", "row_slice", "column_slice", "transposed", "expanded", "misaligned")

FAKE_LAYOUTS = ("contiguous", "channels_last", "row_slice", "transposed")
GRADIENT_LAYOUTS = ("contiguous", "channels_last", "row_slice", "transposed", "of a sum")


def assert_close(actual: Any, expected: Any, rtol: float | None = None, atol: float | None = None) -> None:
    """Equal within the table, NaN equal to NaN, type, shape and device included."""
    if isinstance(actual, (tuple, list)):
        assert len(actual) == len(expected)
        for a, e in zip(actual, expected):
            assert_close(a, e, rtol, atol)
        return
    r, a = TOLERANCES.get(actual.dtype, (0, 0))
    rtol, atol = r if rtol is None else rtol, a if atol is None else atol
    torch.testing.assert_close(actual, expected, rtol=rtol, atol=atol, equal_nan=True)


def with_layout(x: Tensor, layout: str) -> Tensor:
    """The values of (B, C, H, W) tensor `x` with other strides."""
    if layout == "channels_last":
        return x.contiguous(memory_format=torch.channels_last)
    if layout == "row_slice":
        return x.repeat_interleave(2, dim=2)[:, :, ::2]
    if layout == "column_slice":
        return x.repeat_interleave(2, dim=3)[..., ::2]
    if layout == "transposed":
        return x.transpose(2, 3).contiguous().transpose(2, 3)
    if layout == "expanded":
        return x[:1].expand_as(x)
    if layout == "misaligned":
        storage = torch.empty(x.numel() + 1, dtype=x.dtype, device=x.device)[1:]
        return storage.copy_(x.flatten()).view(x.shape)
    return x.contiguous()


def as_tuple(output: Any) -> tuple[Tensor, ...]:
    return tuple(output) if isinstance(output, (tuple, list)) else (output,)


def does_not_wait(device: torch.device, calls: Sequence[Callable[[], Any]]) -> None:
    """Check that no call but the first synchronizes with the GPU."""
    for call in calls:
        call()
    if device.type != "cuda":
        return
    torch.cuda.set_sync_debug_mode("error")
    try:
        for call in calls:
            call()
    finally:
        torch.cuda.set_sync_debug_mode("default")


def pairwise(first: Sequence[Any], second: Sequence[Any], third: Sequence[Any]) -> list[tuple[Any, Any, Any]]:
    """Values of three axes, in which each pair of values of two axes occurs; the third axis has the fewest values."""
    assert len(third) <= min(len(first), len(second))
    return [(a, b, third[(i + k) % len(third)]) for i, a in enumerate(first) for k, b in enumerate(second)]


@contextlib.contextmanager
def named(case: str) -> Iterator[None]:
    """Say of a comparison that fails inside the block which case of a test it is."""
    try:
        yield
    except AssertionError as error:
        raise AssertionError(f"{case}: {error}") from error


def instruction_sets(device: torch.device, backend: str) -> list[str | None]:
    """Those that the library and the processor have; None alone where no kernels of the CPU are tested."""
    if backend == "reference" or device.type != "cpu" or "cpu" in _backend.unserved:
        return [None]
    from kvision import _C

    return [name for name in INSTRUCTION_SETS if _C.isa_supported(name)]


@contextlib.contextmanager
def instruction_set(name: str | None) -> Iterator[None]:
    """Use this instruction set for CPU kernels inside the block. Skips the test where the library or the processor lacks it."""
    if name is None:
        yield
        return
    from kvision import _C

    if not _C.isa_supported(name):
        pytest.skip(f"the library or this processor has no {name}")
    active = _C.active_isa()
    assert _C.set_isa(name)
    try:
        yield
    finally:
        _C.set_isa(active)


class OpTests:
    function: Any  # the public function
    module: Any = None  # its module form
    operators: tuple[str, ...] = ()  # names in torch.ops.kvision that a call with gradient goes through
    uncompiled: tuple[str, ...] = ()  # those of `operators` that no compiled program calls
    operator_dtype = torch.float32  # of images whose call goes through them
    variants: list[dict[str, Any]] = [{}]
    errors: list[tuple[dict[str, Any], type[Exception], str]] = []  # keyword arguments, exception, part of the message
    differentiable = True
    compiler = "aot_eager"  # of test_compile; some classes of each kind say "inductor", which adds loops of torch's own around it
    bytes = False  # uint8 in, uint8 out
    mixed: tuple[str, ...] = ()  # operator arguments whose dtype may differ from the others'
    accepted: tuple[str, ...] = ()  # names of calls in raw_calls.py that are valid for this operator
    max_size = 33  # all sizes up to this are swept
    channels: int | None = None  # the only number of channels that the function takes
    shape: tuple[int, ...] = (2, 3, 13, 18)
    small: tuple[int, ...] = (1, 2, 4, 5)  # for numerical derivatives
    empty: tuple[tuple[int, int], ...] = ((0, 3), (2, 0))  # images and channels of batches without elements
    tolerances: dict[torch.dtype, tuple[float, float]] = {}  # overrides for an operator, with the reason next to it

    # --- what a subclass may override ---

    def input(self, shape: tuple[int, ...], dtype: torch.dtype, device: torch.device | str) -> Tensor:
        if dtype == torch.uint8:
            return torch.randint(0, 256, shape, dtype=dtype).to(device)
        return torch.rand(shape, dtype=torch.float64).to(dtype).to(device)

    # --- helpers ---

    def arguments(self, variant: dict[str, Any], x: Tensor) -> dict[str, Any]:
        def made(value: Any) -> Any:
            if not callable(value):
                return value
            tensor = value(Size(*x.shape[:2], *x.shape[-2:])) if isinstance(value, Axes) else value(x)
            wide = tensor.to(torch.float64 if x.dtype == torch.float64 else torch.float32)
            return (wide if tensor.is_floating_point() else tensor).to(x.device)

        return {k: made(v) for k, v in variant.items()}

    def call(self, x: Tensor, kwargs: dict[str, Any]) -> Any:
        return self.function(x, **kwargs)

    def expected(self, x: Tensor, kwargs: dict[str, Any]) -> Any:
        """The reference in float64, stored in the type of x."""
        wide = {k: v.double() if isinstance(v, Tensor) and v.is_floating_point() else v for k, v in kwargs.items()}
        if not x.is_floating_point() and x.dtype != torch.uint8:
            wide["input"] = x.double()
        with K.backend("reference"):
            if x.dtype == torch.uint8:
                return self.call(x, kwargs)
            output = self.call(x.double(), wide)
        stored = [o.to(x.dtype) if o.is_floating_point() else o for o in as_tuple(output)]
        return tuple(stored) if isinstance(output, (tuple, list)) else stored[0]

    def check(self, actual: Any, expected: Any) -> None:
        for a, e in zip(as_tuple(actual), as_tuple(expected), strict=True):
            assert_close(a, e, *self.tolerances.get(a.dtype, (None, None)))

    def tensors(self, x: Tensor, kwargs: dict[str, Any]) -> tuple[list[str], list[Tensor]]:
        names = [k for k, v in kwargs.items() if isinstance(v, Tensor) and v.is_floating_point()]
        return names, [x, *(kwargs[n] for n in names)]

    def of_tensors(self, kwargs: dict[str, Any], names: list[str]) -> Any:
        """The call as a function of its tensors, to one result or a tuple."""

        def f(x: Tensor, *values: Tensor) -> Any:
            output = as_tuple(self.call(x, {**kwargs, **dict(zip(names, values))}))
            return output[0] if len(output) == 1 else output

        return f

    def gradients(self, x: Tensor, kwargs: dict[str, Any], weights: list[Tensor]) -> list[Tensor]:
        names, values = self.tensors(x, kwargs)
        values = [v.detach().requires_grad_() for v in values]
        outputs = as_tuple(self.of_tensors(kwargs, names)(*values))
        loss = sum((o * w).sum() for o, w in zip(outputs, weights) if o.requires_grad)
        return list(torch.autograd.grad(loss, values))

    def exercise(self, x: Tensor, kwargs: dict[str, Any]) -> None:
        """Run forward and backward, with gradients for all tensors and for the first one alone."""
        outputs = as_tuple(self.call(x, kwargs))
        if self.differentiable:
            self.gradients(x, kwargs, [torch.ones_like(o) for o in outputs])
            leaf = x.detach().requires_grad_()
            torch.autograd.grad(sum(o.sum() for o in as_tuple(self.call(leaf, kwargs)) if o.requires_grad), leaf)

    def setup(self, variant: dict[str, Any], device: Any, dtype: torch.dtype = torch.float64, shape: Any = None) -> Any:
        x = self.input(shape or self.shape, dtype, device)
        return x, self.arguments(variant, x)

    def needs_native(self, backend: str) -> None:
        if backend == "reference":
            pytest.skip("this test is about the kernels")

    # --- values ---

    def test_value(self, variant, device, backend):
        """In each type, by each instruction set that the library and the processor have."""
        for dtype in _ops.FLOATS:
            torch.manual_seed(0)
            x, kwargs = self.setup(variant, device, dtype)
            expected = self.expected(x, kwargs)
            for isa in instruction_sets(device, backend):
                with instruction_set(isa), named(f"{dtype} {isa}"):
                    self.check(self.call(x, kwargs), expected)

    def test_value_of_bytes(self, variant, device, backend):
        x, kwargs = self.setup(variant, device, torch.uint8)
        expected = self.expected(x, kwargs) if self.bytes else as_tuple(self.call(x.float(), kwargs))[0]
        for isa in instruction_sets(device, backend) if self.bytes else [None]:
            with instruction_set(isa), named(str(isa)):
                output = self.call(x, kwargs)
                if self.bytes:
                    assert as_tuple(output)[0].dtype == torch.uint8
                    self.check(output, expected)
                else:
                    assert_close(as_tuple(output)[0], expected)

    @pytest.mark.interface
    def test_other_integers_become_float32(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.uint8)
        result, expected = (as_tuple(self.call(x.to(dtype), kwargs)) for dtype in (torch.int32, torch.float32))
        for y, z in zip(result, expected, strict=True):
            assert_close(y, z.round().to(torch.int32) if y.dtype == torch.int32 else z)

    def test_layout(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        if x.dim() != 4:
            pytest.skip("layouts are of images")
        same = x[:1].expand_as(x).contiguous()  # what images expanded from one hold
        expected, of_same = self.call(x, kwargs), self.call(same, kwargs)
        for layout in LAYOUTS:
            with named(layout):
                output = self.call(with_layout(x, layout), kwargs)
                self.check(output, of_same if layout == "expanded" else expected)
                if layout == "channels_last" and x.shape[1] > 1 and as_tuple(output)[0].dim() == 4:
                    assert as_tuple(output)[0].is_contiguous(memory_format=torch.channels_last)

    @pytest.mark.sweep
    def test_all_small_sizes(self, variant, sizes, device):
        """Values and gradients at every height and width up to max_size."""
        ran = 0
        swept = [n for n in range(1, self.max_size + 1) if sizes == "all" or n in (1, 2, 3, 5, 8, 9, 17, self.max_size)]
        for h in swept:
            # Another width for every height; for the first variant a few of them, and every width for two heights.
            widths = {self.max_size + 1 - h, *((1, self.max_size) if h in (1, self.max_size) else ())}
            if variant is self.variants[0] or THOROUGH:
                widths |= {*swept} if h in (1, self.max_size) else {1, h}
            for w in sorted(widths):
                x = self.input((1, self.channels or 2, *self.shape[2:-2], h, w), torch.float32, device)
                kwargs = self.arguments(variant, x)
                try:
                    expected = self.expected(x, kwargs)
                except K.core.exceptions.ShapeError:
                    with pytest.raises(K.core.exceptions.ShapeError):
                        self.call(x, kwargs)
                    continue
                ran += 1
                with named(f"{h} x {w}"):
                    self.check(self.call(x, kwargs), expected)
                    if self.differentiable:
                        self.check_gradients(x, kwargs)
        assert ran > (0 if sizes == "few" else self.max_size if variant is self.variants[0] else self.max_size // 4)

    def test_empty(self, variant, device):
        for batch, channels in self.empty:
            if self.channels and not channels:
                continue  # takes no other number of channels
            channels = self.channels or channels
            x, kwargs = self.setup(variant, device, torch.float32, (batch, channels, *self.shape[2:]))
            with K.backend("reference"):
                expected = self.call(x, kwargs)
            with named(f"{batch} images of {channels} channels"):
                assert_close(self.call(x, kwargs), expected)

    def test_nan_stays_in_its_window(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        x[0, 1, ..., 6, 7] = float("nan")
        self.check(self.call(x, kwargs), self.expected(x, kwargs))

    @pytest.mark.interface
    def test_input_is_not_modified(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        _, values = self.tensors(x, kwargs)
        before = [v.clone() for v in values]
        versions = [v._version for v in values]
        self.call(x, kwargs)
        assert versions == [v._version for v in values]
        assert all(torch.equal(a, b) for a, b in zip(before, values))

    @pytest.mark.interface
    def test_module(self, variant, device):
        if self.module is None:
            pytest.skip("no module form")
        x, kwargs = self.setup(variant, device, torch.float32)
        in_forward = {k: v for k, v in kwargs.items() if k in self.forward_arguments}
        module = self.module(**{k: v for k, v in kwargs.items() if k not in in_forward})
        assert_close(module(x, **in_forward), self.call(x, kwargs))
        assert self.module.__name__ in repr(module)

    forward_arguments: tuple[str, ...] = ()  # keyword arguments that the module takes in forward

    # --- kernels ---

    @pytest.mark.native
    def test_threads_and_runs_give_the_same_bits(self, variant, device, backend):
        self.needs_native(backend)  # torch's convolutions do not
        x, kwargs = self.setup(variant, device, torch.float32, (2, self.channels or 3, *self.shape[2:-2], 61, 67))
        outputs = []
        threads = torch.get_num_threads()
        try:
            for n in (1, 2, 2):
                torch.set_num_threads(n)
                result = list(as_tuple(self.call(x, kwargs)))
                if self.differentiable:
                    weights = [torch.ones_like(o) for o in result]
                    result += self.gradients(x, kwargs, weights)
                outputs.append(result)
        finally:
            torch.set_num_threads(threads)
        for other in outputs[1:]:
            assert all(torch.equal(a, b) for a, b in zip(outputs[0], other))

    @pytest.mark.interface
    def test_serves_natively(self, variant, device, backend):
        """Kernels serve all calls: with backend "native" a missing kernel raises an error."""
        self.needs_native(backend)
        x, kwargs = self.setup(variant, device, torch.float32)
        with K.backend("native"):
            self.call(x.requires_grad_(self.differentiable), kwargs)

    @pytest.mark.tracing
    def test_opcheck(self, device, backend):
        """All checks on each operator's first call; on other variants only those that non-tensor arguments affect."""
        self.needs_native(backend)
        checks: dict[str, tuple[str, ...]] = {}
        for variant in self.variants:
            x, kwargs = self.setup(variant, device, self.operator_dtype)
            with recorded() as calls:
                self.exercise(x, kwargs)
            for name, args in dict(calls).items():
                detached = tuple(a.detach() if isinstance(a, Tensor) else a for a in args)
                if self.differentiable and not name.endswith("backward"):
                    detached = (detached[0].requires_grad_(), *detached[1:])
                eager = ("test_schema", "test_faketensor")
                first = eager if name in self.uncompiled else torch.library._OPCHECK_DEFAULT_UTILS
                utils = checks.setdefault(name, first)
                torch.library.opcheck(getattr(torch.ops.kvision, name).default, detached, test_utils=utils)
                checks[name] = eager
        assert set(checks) == set(self.operators)

    @pytest.mark.interface
    def test_fake_results_are_laid_out_as_real_ones(self, device, backend):
        """Strides of fake and real results agree for all layouts of images and gradients, as torch.compile requires.

        Strides are compared on axes of more than one element of results that are not empty. The first variant is called with
        all layouts of gradients for each of its images, the others with each layout once.
        """
        self.needs_native(backend)
        differing: dict[str, str] = {}
        compared: set[Any] = set()  # a call with each gradient's layout repeats the forward call of the others
        for variant in self.variants:
            x, kwargs = self.setup(variant, device, torch.float32)
            layouts = FAKE_LAYOUTS if x.dim() == 4 else ("contiguous",)
            with recorded() as calls:
                every = list(itertools.product(layouts, GRADIENT_LAYOUTS))
                some = [(layouts[i % len(layouts)], grad_layout) for i, grad_layout in enumerate(GRADIENT_LAYOUTS)]
                for layout, grad_layout in every if variant is self.variants[0] or THOROUGH else some:
                    leaf = with_layout(x, layout).requires_grad_(self.differentiable)
                    outputs = as_tuple(self.call(leaf, kwargs))
                    if not self.differentiable:
                        break
                    results = [y for y in outputs if y.requires_grad]
                    grads = [gradient_like(y.detach(), grad_layout) for y in results]
                    torch.autograd.grad(results, leaf, grads)
            for name, args in calls:
                if name in differing or (key := call_signature(name, args)) in compared:
                    continue
                compared.add(key)
                if difference := fake_differs(name, args):
                    differing[name] = difference
        assert not differing, differing

    # --- gradients ---

    def expected_gradients(self, x: Tensor, kwargs: dict[str, Any]) -> tuple[list[Tensor], list[Tensor]]:
        """Weights of the results, and the reference's gradients of their weighted sum, in float64."""
        wide = {k: v.double() if isinstance(v, Tensor) and v.is_floating_point() else v for k, v in kwargs.items()}
        with K.backend("reference"):
            outputs = as_tuple(self.call(x.double(), wide))
            weights = [torch.rand_like(o) - 0.3 for o in outputs]
            return weights, self.gradients(x.double(), wide, weights)

    def check_gradients(
        self, x: Tensor, kwargs: dict[str, Any], known: tuple[list[Tensor], list[Tensor]] | None = None
    ) -> None:
        """Gradients in x's type against the reference's, which may be known."""
        weights, expected = self.expected_gradients(x, kwargs) if known is None else known
        actual = self.gradients(x, kwargs, [w.to(x.dtype) for w in weights])
        for i, (a, e) in enumerate(zip(actual, expected, strict=True)):
            rtol, atol = self.tolerances.get(a.dtype, TOLERANCES[a.dtype])
            scale = max(1.0, float(e.abs().nan_to_num().max())) if e.numel() else 1.0
            if i > 0:
                rtol, atol = PARAMETER_TOLERANCE, PARAMETER_TOLERANCE * scale
            assert_close(a, e.to(a.dtype), rtol, atol * scale)

    def needs_gradient(self) -> None:
        if not self.differentiable:
            pytest.skip("not differentiable")

    @pytest.mark.native
    def test_gradient_against_reference(self, variant, device, backend):
        """In each layout, and by each instruction set."""
        self.needs_gradient()
        x, kwargs = self.setup(variant, device, torch.float32)
        expected = self.expected_gradients(x, kwargs)
        for isa in instruction_sets(device, backend):
            with instruction_set(isa), named(str(isa)):
                self.check_gradients(x, kwargs, expected)
        for layout in ("channels_last", "row_slice") if x.dim() == 4 else ():
            with named(layout):
                self.check_gradients(with_layout(x, layout), kwargs, expected)

    @pytest.mark.native
    def test_gradient_at_ties_and_bounds(self, variant, device):
        """Values of exactly 0, 1/2 and 1, half of them the same in all channels: kernels and references follow one rule."""
        self.needs_gradient()
        x, kwargs = self.setup(variant, device)
        x = (2 * x).round() / 2
        x[..., : x.shape[-1] // 2] = x[:, :1, ..., : x.shape[-1] // 2]
        self.check_gradients(x, kwargs)

    def test_gradient_in_half(self, variant, device):
        self.needs_gradient()
        for dtype in (torch.float16, torch.bfloat16):
            torch.manual_seed(0)
            x, kwargs = self.setup(variant, device, dtype)
            kwargs = {
                k: v.to(dtype).float() if isinstance(v, Tensor) and v.is_floating_point() else v
                for k, v in kwargs.items()
            }
            weights = [torch.rand_like(o) for o in as_tuple(self.call(x, kwargs))]
            actual = self.gradients(x, kwargs, weights)[0]
            wide = {k: v.double() if isinstance(v, Tensor) and v.is_floating_point() else v for k, v in kwargs.items()}
            with K.backend("reference"):
                expected = self.gradients(x.double(), wide, [w.double() for w in weights])[0]
            rtol, atol = TOLERANCES[dtype]
            assert actual.dtype == dtype
            with named(str(dtype)):
                scale = max(1.0, float(expected.abs().max()))
                assert_close(actual, expected.to(dtype), 2 * rtol, 2 * atol * scale)

    @pytest.mark.derivatives
    def test_gradcheck(self, variant, device):
        self.needs_gradient()
        x, kwargs = self.setup(variant, device, shape=self.small)
        names, values = self.tensors(x, kwargs)
        values = [v.requires_grad_() for v in values]
        f = self.of_tensors(kwargs, names)
        assert torch.autograd.gradcheck(f, values, nondet_tol=0.0)
        # fast_mode checks along random directions, because all entries of the Jacobian would be a product of sizes.
        # Second derivatives may be the reference's, and torch's padding sums its gradient in any order on CUDA.
        noise = 0.0 if device.type == "cpu" else 1e-9
        assert torch.autograd.gradgradcheck(f, values, fast_mode=True, nondet_tol=noise)

    @pytest.mark.interface
    def test_computes_only_requested_gradients(self, variant, device):
        """Gradients of the parameters alone equal those asked for together."""
        self.needs_gradient()
        x, kwargs = self.setup(variant, device)
        names, values = self.tensors(x, kwargs)
        if len(values) == 1:
            pytest.skip("one tensor only")
        both = self.gradients(x, kwargs, [torch.ones_like(o) for o in as_tuple(self.call(x, kwargs))])
        for i in range(len(values)):
            leaves = [v.detach().requires_grad_(i == k) for k, v in enumerate(values)]
            outputs = as_tuple(self.of_tensors(kwargs, names)(*leaves))
            (alone,) = torch.autograd.grad(sum(o.sum() for o in outputs if o.requires_grad), leaves[i])
            assert_close(alone, both[i])

    # --- transforms ---

    @pytest.mark.interface
    def test_vmap(self, variant, device):
        x, kwargs = self.setup(variant, device, shape=(2, 2, *self.shape[1:]))
        for in_dim in (0, 1):
            mapped = torch.func.vmap(lambda s: self.call(s, self.arguments(variant, x[0])), in_dim, randomness="same")
            torch.manual_seed(1)
            actual = mapped(x.movedim(0, in_dim))
            torch.manual_seed(1)
            kwargs = self.arguments(variant, x[0])
            each = [as_tuple(self.call(s, kwargs)) for s in x]
            self.check(actual, tuple(torch.stack(parts) for parts in zip(*each)))

    @pytest.mark.interface
    def test_func_grad_and_jvp(self, variant, device):
        self.needs_gradient()
        x, kwargs = self.setup(variant, device, shape=self.small)

        def loss(s: Tensor) -> Tensor:
            return (as_tuple(self.call(s, kwargs))[0] ** 2).sum()

        leaf = x.clone().requires_grad_()
        (expected,) = torch.autograd.grad(loss(leaf), leaf)
        assert_close(torch.func.grad(loss)(x), expected)
        tangent = torch.rand_like(x)
        _, directional = torch.func.jvp(loss, (x,), (tangent,))
        assert_close(directional, (expected * tangent).sum(), 1e-7, 1e-7)
        per_sample = torch.func.vmap(torch.func.grad(loss))(x[None].repeat(3, *[1] * x.dim()))
        assert_close(per_sample[1], expected)

    @pytest.mark.interface
    def test_pullback_is_differentiable(self, variant, device):
        """The function from torch.func.vjp is called outside of it and differentiated by torch.autograd."""
        self.needs_gradient()
        x, kwargs = self.setup(variant, device, shape=self.small)

        def loss(s: Tensor) -> Tensor:
            return (as_tuple(self.call(s, kwargs))[0] ** 2).sum()

        leaf = x.clone().requires_grad_()
        value = loss(leaf)
        (expected,) = torch.autograd.grad((torch.autograd.grad(value, leaf, create_graph=True)[0] ** 2).sum(), leaf)
        value, vjp_fn = torch.func.vjp(loss, leaf)
        (actual,) = torch.autograd.grad((vjp_fn(torch.ones_like(value))[0] ** 2).sum(), leaf)
        assert_close(actual, expected, 1e-7, 1e-7)

    @pytest.mark.derivatives
    def test_hessian(self, variant, device):
        """All of it along three directions, as each of the reference's rows is a backward pass of its own."""
        self.needs_gradient()
        x, kwargs = self.setup(variant, device, shape=self.small)

        def loss(s: Tensor) -> Tensor:
            return (as_tuple(self.call(s, kwargs))[0] ** 2).sum()

        directions = torch.randn(3, *x.shape, dtype=x.dtype).to(device)
        with K.backend("reference"):
            leaf = x.clone().requires_grad_()
            (gradient,) = torch.autograd.grad(loss(leaf), leaf, create_graph=True)
            unused = {"retain_graph": True, "materialize_grads": True}
            rows = [torch.autograd.grad(gradient, leaf, v, **unused)[0] for v in directions]
        hessian = torch.func.hessian(loss)(x).reshape(x.numel(), x.numel())
        assert_close(directions.flatten(1) @ hessian, torch.stack(rows).flatten(1), 1e-6, 1e-7)

    def of_batches(self, variant: dict[str, Any], device: Any) -> Iterator[tuple[int, Any, list[Tensor]]]:
        """The call of small batches as a function of its tensors, and these; for the first variant of 0 and 1 image, too."""
        for batch in (0, 1, 2) if variant is self.variants[0] or THOROUGH else (2,):
            torch.manual_seed(0)
            x, kwargs = self.setup(variant, device, shape=(batch, *self.small[1:]))
            names, values = self.tensors(x, kwargs)
            f = self.of_tensors(kwargs, names)
            if batch == 0:
                try:
                    f(*values)
                except K.core.exceptions.ShapeError:
                    continue  # its other tensors have samples
            yield batch, f, values

    @pytest.mark.derivatives
    def test_jacobians(self, variant, device):
        """torch.func's Jacobians of a few sums of the results by all tensors, in both modes, are autograd's."""
        self.needs_gradient()
        for batch, f, values in self.of_batches(variant, device):

            def sums(*values: Tensor, f: Any = f) -> Tensor:
                return torch.cat([weighted_sums(y) for y in as_tuple(f(*values))])

            leaves = [v.clone().requires_grad_() for v in values]
            unused = {"allow_unused": True, "materialize_grads": True}
            rows = [torch.autograd.grad(y, leaves, retain_graph=True, **unused) for y in sums(*leaves)]
            expected = tuple(torch.stack(parts) for parts in zip(*rows))
            # Of an empty tensor, forward mode maps over no tangents, which some of torch's operators do not take.
            for jacobian in (torch.func.jacrev, torch.func.jacfwd) if batch else (torch.func.jacrev,):
                actual = jacobian(sums, tuple(range(len(values))))(*values)
                assert_close(actual, expected, 1e-7, 1e-7)

    @pytest.mark.derivatives
    def test_nested_vmap(self, variant, device):
        for _, f, values in self.of_batches(variant, device):
            factors = torch.tensor([[1, 0.9], [0.8, 0.7]], dtype=values[0].dtype, device=device)
            mapped = [factors.view(2, 2, *[1] * v.dim()) * v for v in values]
            torch.manual_seed(1)
            actual = torch.func.vmap(torch.func.vmap(f, randomness="same"), randomness="same")(*mapped)
            for i, j in itertools.product(range(2), repeat=2):
                torch.manual_seed(1)
                expected = f(*(v[i, j] for v in mapped))
                self.check(tuple(y[i, j] for y in actual) if isinstance(actual, tuple) else actual[i, j], expected)

    @pytest.mark.interface
    def test_autocast_changes_nothing(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        plain = self.call(x, kwargs)
        with torch.autocast(device.type, dtype=torch.bfloat16):
            assert_close(self.call(x, kwargs), plain)

    # --- production ---

    @pytest.mark.tracing
    def test_compile(self, device, backend):
        """fullgraph with a dynamic batch; values and gradients. The reference only has to be traceable.

        tests/deployment/test_dynamic_sweep.py exports every public function.
        """
        variant = self.variants[0]
        x, kwargs = self.setup(variant, device, torch.float32)
        torch._dynamo.reset()
        compiler = "eager" if backend == "reference" else self.compiler
        compiled = torch.compile(lambda s: self.call(s, kwargs), fullgraph=True, backend=compiler)
        shared = all(not isinstance(v, Tensor) or v.shape[0] == 1 for v in kwargs.values())
        for batch in (2, 3) if shared else self.shape[:1]:
            x = self.input((batch, *self.shape[1:]), torch.float32, device)
            a, b = (x.clone().requires_grad_(self.differentiable) for _ in range(2))
            if shared:
                torch._dynamo.mark_dynamic(a, 0)
            actual, expected = compiled(a), self.call(b, kwargs)
            self.check(actual, expected)
            if self.differentiable:
                (as_tuple(actual)[0] ** 2).sum().backward()
                (as_tuple(expected)[0] ** 2).sum().backward()
                assert_close(a.grad, b.grad, *self.tolerances.get(torch.float32, (None, None)))

    @pytest.mark.interface
    @pytest.mark.gpu
    def test_cuda_graph(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        x.requires_grad_(self.differentiable)

        def step() -> tuple[Tensor, ...]:
            outputs = as_tuple(self.call(x, kwargs))
            if not self.differentiable:
                return outputs
            loss = sum(o.sum() for o in outputs if o.requires_grad)
            return (*outputs, *torch.autograd.grad(loss, [x]))

        side = torch.cuda.Stream()
        with torch.cuda.stream(side):
            step()
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            captured = step()
        with torch.no_grad():
            x.copy_(self.input(self.shape, torch.float32, device))
        graph.replay()
        assert_close(tuple(c.detach() for c in captured), tuple(e.detach() for e in step()))

    @pytest.mark.interface
    @pytest.mark.gpu
    def test_current_stream(self, variant, device):
        """Kernels wait for earlier work on the current stream, and for no other work."""
        x, kwargs = self.setup(variant, device, torch.float32)
        expected = self.call(x, kwargs)
        late = torch.zeros_like(x)
        torch.cuda.synchronize()
        with torch.cuda.stream(torch.cuda.Stream()):
            torch.cuda._sleep(20_000_000)  # about 10 ms, during which another stream would read the zeros
            late.copy_(x)
            output = self.call(late, kwargs)
            torch.cuda.current_stream().synchronize()
        assert_close(output, expected)

    # --- bad input ---

    @pytest.mark.interface
    def test_wrong_kinds(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        name = self.function.__name__
        for wrong, error in [
            ([[1.0]], TypeError),
            (None, TypeError),
            (x.to(torch.complex64), TypeError),
            (x[0, 0, 0], ValueError),
            (x[None, None], ValueError),
            (x[..., :0], ValueError),
        ]:
            with pytest.raises(error, match=f"^{name}: ") as caught:
                self.call(wrong, kwargs)
            assert isinstance(caught.value, K.core.exceptions.BaseError)

    @pytest.mark.interface
    def test_errors(self, device):
        x = self.input(self.shape, torch.float32, device)
        for kwargs, error, message in self.errors:
            with pytest.raises(error, match=message) as caught:
                self.call(x, {**self.arguments(self.variants[0], x), **self.arguments(kwargs, x)})
            assert str(caught.value).startswith(self.function.__name__ + ": "), str(caught.value)

    def test_operators_refuse_bad_arguments(self, device, backend):
        """Operators are called without the checks of the Python functions, as by C++ and exported programs."""
        self.needs_native(backend)
        with recorded() as calls:
            for variant in self.variants:
                self.exercise(*self.setup(variant, device, self.operator_dtype))
        assert {name for name, _ in calls} == set(self.operators)
        wrong: list[Any] = []
        for name, args in dict(calls).items():
            operator = getattr(torch.ops.kvision, name).default
            args = [a.detach() if isinstance(a, Tensor) else a for a in args]
            fine = [*self.accepted, *(f"{name} of another dtype" for name in self.mixed)]
            wrong += [(operator, call) for call in raw_calls.wrong_calls(operator, args) if call[0] not in fine]
        taken = raw_calls.taken(wrong)
        assert not taken, "\n".join(taken)

    # --- fuzzing ---

    def fuzz_arguments(self) -> st.SearchStrategy[dict[str, Any]]:
        """Keyword arguments to fuzz with; the declared variants unless a subclass draws more."""
        return st.sampled_from(self.variants)

    @pytest.mark.fuzz
    def test_fuzz(self, device):
        strides = st.sampled_from(LAYOUTS)
        channels = st.just(self.channels) if self.channels else st.integers(0, 5)
        sizes = st.tuples(st.integers(0, 3), channels, *[st.integers(1, 40)] * (len(self.shape) - 2))
        dtypes = st.sampled_from(_ops.FLOATS + ((torch.uint8,) if self.bytes else ()))

        @settings(max_examples=10 if QUICK and device.type == "cpu" else settings.default.max_examples)
        @given(shape=sizes, layout=strides, dtype=dtypes, variant=self.fuzz_arguments(), seed=st.integers(0, 2**31))
        def run(shape, layout, dtype, variant, seed):
            torch.manual_seed(seed)
            x = self.input(shape, dtype, device)
            if len(shape) == 4 and x.numel():
                x = with_layout(x, layout)
            try:
                kwargs = self.arguments(variant, x)
                expected = self.expected(x, kwargs)
            except (TypeError, ValueError) as error:
                assert isinstance(error, K.core.exceptions.BaseError), repr(error)
                with pytest.raises(type(error)):
                    self.call(x, kwargs)
                return
            self.check(self.call(x, kwargs), expected)

        run()


def weighted_sums(y: Tensor) -> Tensor:
    """A few sums of all elements with weights of both signs: enough of a result to tell its derivatives by."""
    angles = torch.arange(y.numel(), dtype=y.dtype, device=y.device)[:, None] * y.new_tensor([1.0, 2.0, 0.7])
    return (y.reshape(y.numel(), 1) * angles.cos()).sum(0)


def gradient_like(y: Tensor, layout: str) -> Tensor:
    """Ones in the layouts of real gradients: those from torch's backward operators, from sums and from slices."""
    if layout == "of a sum":
        return y.new_ones(()).expand_as(y)
    return with_layout(torch.ones_like(y), layout) if y.dim() == 4 else torch.ones_like(y)


def call_signature(name: str, args: Sequence[Any]) -> tuple[Any, ...]:
    """All that a fake kernel sees of a call: shapes, strides and types of tensors, and the other arguments."""
    return name, *((tuple(a.shape), a.stride(), a.dtype) if isinstance(a, Tensor) else repr(a) for a in args)


def fake_differs(name: str, args: Sequence[Any]) -> str:
    """How the results of an operator's fake implementation differ from the real ones; empty where they do not."""
    operator = getattr(torch.ops.kvision, name).default
    args = [a.detach() if isinstance(a, Tensor) else a for a in args]
    real = as_tuple(operator(*args))
    with FakeTensorMode() as mode:
        fake = as_tuple(operator(*(mode.from_tensor(a) if isinstance(a, Tensor) else a for a in args)))
    for i, (r, f) in enumerate(zip(real, fake, strict=True)):
        if describe_layout(f) != describe_layout(r):
            inputs = ", ".join(str(describe_layout(a)[:2]) for a in args if isinstance(a, Tensor))
            return f"result {i}: fake {describe_layout(f)}, real {describe_layout(r)}, of {inputs}"
    return ""


def describe_layout(y: Tensor) -> tuple[Any, ...]:
    strides = [s if n > 1 else 0 for s, n in zip(y.stride(), y.shape)] if y.numel() else []
    return tuple(y.shape), strides, y.dtype, y.device.type


class DispatchedOperators(TorchDispatchMode):
    """Collects the names of all operators that are dispatched, torch's and kvision's, without their overloads."""

    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.names.append(func.overloadpacket.__name__)
        return func(*args, **(kwargs or {}))


@contextlib.contextmanager
def recorded():
    """Collects (operator, arguments) of every kernel call."""
    calls: list[tuple[str, tuple[Any, ...]]] = []
    operators = _ops.operators  # looks for modules that are not imported yet
    originals = {name: operator._call_kernel for name, operator in operators.items()}

    def recorder(name: str, kernel: Any) -> Any:
        def record(*args: Any) -> Any:
            calls.append((name, args))
            return kernel(*args)

        return record

    try:
        for name, kernel in originals.items():
            operators[name]._call_kernel = recorder(name, kernel)
        yield calls
    finally:
        for name, kernel in originals.items():
            operators[name]._call_kernel = kernel
