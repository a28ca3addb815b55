"""The operator path: the only module that talks to torch.library.

An operator is its reference, written in plain torch, plus kernels registered under the same name as
`torch.ops.kvision.<name>`. `register` ties them together and returns the function everything in kvision calls:

    call ──► reference                      no kernel for this device or dtype, the user asked for it, or for ONNX
        ├──► torch.ops.kvision.<name>       while compiling, exporting or tracing: register_fake and _differentiate serve it
        ├──► autograd.Function ──► kernel   a graph is wanted: requires_grad, torch.func, forward-mode
        └──► kernel                         otherwise

Four routes because each is the fast one where it applies, and because torch.func works only through the third and
torch.compile only through the second (docs/design.md has the measurements).
"""

from __future__ import annotations

import contextlib
import functools
import importlib
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, is_grad_enabled
from torch.compiler import is_compiling

from kvision import _backend
from kvision._backend import backend, current_backend, unserved_devices
from kvision._dtype import is_autocast_on
from kvision._gradients import Entry, compile_words, parse, reads_first
from kvision._hints import look_at_range, without_hints
from kvision._symbolic import are_symbolic, kernel_of_tensors
from kvision._torch_compat import (
    before_first_lookup,
    below_autograd,
    carry_tangents,
    compiling,
    constant_in_graphs,
    find_operator,
    function_caller,
    in_derivative_transform,
    in_forward_ad,
    in_function_transform,
    in_onnx_export,
    is_any_autocast_enabled,
    is_exporting,
    is_tracing,
    keep_calls_apart,
    kernel_caller,
    schema_of,
    unwrap_dead_wrappers,
)

FLOATS = (torch.float32, torch.float64, torch.float16, torch.bfloat16)
_HALF_TYPES = (torch.float16, torch.bfloat16)
_PROMOTED = (*_HALF_TYPES, torch.float64, torch.uint8)  # before a reference computes; labels and masks stay as they are

# --- operators ------------------------------------------------------------------------------------------------------

# The operators of the modules imported until now; `_ops.operators` imports the others as well.
_registered: dict[str, Operator] = {}

if TYPE_CHECKING:
    operators: dict[str, Operator]


def __getattr__(name: str) -> Any:
    if name == "operators":
        return all_operators()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def import_modules() -> None:
    """Import what `import kvision` leaves until it is used, so that all operators are registered."""
    package = importlib.import_module("kvision")
    for name in package.__all__:
        getattr(package, name)


def all_operators() -> dict[str, Operator]:
    """Those of all modules, by name."""
    import_modules()
    return _registered


def _registered_operator(name: str) -> Operator:
    return _registered.get(name) or all_operators()[name]


def serves(name: str, x: Tensor) -> str:
    """What serves operator `name` on tensors of the device and type of `x`: "native" or "reference"."""
    return "native" if all_operators()[name].is_native(x) else "reference"


# A program of torch.export names operators of modules that nobody may have imported; it looks them up in torch.ops.
before_first_lookup("kvision", import_modules)


def register(name: str, reference: Callable[..., Any], **rules: Any) -> Operator:
    """Tie the kernels of `torch.ops.kvision.<name>` to their reference; see Operator for the rules."""
    _registered[name] = Operator(name, reference, **rules)
    return _registered[name]


def register_random(name: str, schema: str, draw: Callable[..., Tensor], fake: Callable[..., Tensor]) -> Any:
    """An operator that draws from torch's default generators, for graphs: compilers neither join nor replace its calls."""
    tags = (torch.Tag.nondeterministic_seeded,)
    operator = torch.library.custom_op(f"kvision::{name}", draw, mutates_args=(), schema=schema, tags=tags)

    @operator.register_fake
    def shape(*args: Any) -> Tensor:
        keep_calls_apart(getattr(torch.ops.kvision, name))  # before the graph that is traced now is cleaned
        return fake(*args)

    return operator


library = torch.library.Library("kvision", "FRAGMENT")
_PLAIN = frozenset((Tensor, torch.nn.Parameter))  # types that are no subclass with rules of its own


class Operator:
    """One operator: tensors first, then plain arguments, in the order of its schema.

    Every tensor argument is an image batch or parameters of its samples: axis 0 is the batch, or has size 1 and serves
    all of it. An optional tensor may be None.

    Args:
        name: name of the operator, `torch.ops.kvision.<name>`.
        reference: the definition in plain torch, in float32 or float64. Half types and bytes are computed in float32
            and rounded to the type of the first tensor (bytes: half to even, saturated).
        fake: shape rule, the result's sizes from the arguments; default: the sizes of the first tensor. May return a
            list of sizes for several results, and an empty tensor instead of sizes where more than these differs.
        layout_of: the tensor, by index, whose memory format the results have: the image's in backward operators that
            read it.
        gradients: the operators that give the gradients to the arguments, in the words of _gradients.py, from which
            the C++ interface is generated, too. Default: `backward`.
        jvp: `jvp(tangents, *args) -> tangent of the result`, where it is less work than the default, which differentiates the
            derivative of the reference. Tangents are None or tensors, one for each tensor argument.
        backward: gradients that are no single call, as a function `backward(needs, grads..., *args) -> gradients of the
            tensor arguments`, in order, written with registered operators, so that it can itself be differentiated;
            `needs[i]` tells whether the i-th is wanted, and None stands for one that is not. Default: the reference is
            differentiated.
        saves_results: backward needs the results: `backward(needs, grads..., results..., *args)`. Words that mention a
            result imply it.
        non_differentiable: the results, by index, that carry no gradient.
        linear: linear in its first tensor. Then jvp is the operator itself where it has no other tensor. Of the first tensor
            its sizes alone are saved for backward (`args[0]` is these there), where there is no other or where `gradients`
            ask for no more.
        bytes: the kernels take uint8, too.
        uint16: the kernels take uint16, too.
        levels: the result for bytes is that for images of floats times this number, 1 or 255.
        float_results: the results for bytes are those for the same numbers in float32.
        labels: the first tensor holds int64 or uint8, and the kernels take no other types.
        native_half: the reference takes half types as they are, because how they round is part of the result.
        casts_outputs: the reference itself casts its results as the kernels do, say to another type than the first
            tensor's.
        supports: `supports(*args)` returns None, or the reason why no kernel serves these arguments: then the reference
            does, and backend("native") raises with the reason. Its docstring says the same for all arguments;
            kvision.info() shows the first line.
        nondeterministic: True, or a function of the arguments that tells whether the kernel may give other bits on a
            second run. Under torch.use_deterministic_algorithms the reference then serves, whose own operators raise
            or warn if they are not deterministic either.
        clamps: the result of images is clamped to [0, 1]; or a function of the arguments that tells whether it is. The first call
            looks at the range of the images.
        flatten: the rule of vmap where not all tensors have the same axis 0: `flatten(n, in_dims, args)` returns the
            arguments of one call for all n of them, or None where there is none. Default: flatten_batches.
    """

    def __init__(
        self,
        name: str,
        reference: Callable[..., Any],
        *,
        fake: Callable[..., Sequence[Any]] | None = None,
        layout_of: int = 0,
        gradients: str = "",
        backward: Callable[..., Sequence[Tensor | None]] | None = None,
        jvp: Callable[..., Tensor] | None = None,
        saves_results: bool = False,
        non_differentiable: Sequence[int] = (),
        linear: bool = False,
        bytes: bool = False,
        uint16: bool = False,
        levels: int = 1,
        float_results: bool = False,
        labels: bool = False,
        native_half: bool = False,
        casts_outputs: bool = False,
        supports: Callable[..., str | None] | None = None,
        nondeterministic: bool | Callable[..., bool] = False,
        clamps: bool | Callable[..., bool] = False,
        flatten: Callable[[int, tuple[Any, ...], tuple[Any, ...]], list[Any] | None] | None = None,
    ) -> None:
        self.name = name
        self.definition = reference
        self.reference = (
            without_autocast_and_tf32(reference)
            if casts_outputs
            else with_kernel_casts(reference, native_half, layout_of, levels, non_differentiable, float_results)
        )
        self.words = gradients
        self.by_hand = backward
        self.jvp = jvp
        self.saves_results = saves_results or "result" in gradients
        self.non_differentiable = non_differentiable
        self.linear = linear
        self.dtypes = (torch.int64, torch.uint8) if labels else (*FLOATS, torch.uint8) if bytes else FLOATS
        if uint16:
            self.dtypes = (*self.dtypes, torch.uint16)
        self.supports = supports
        self.nondeterministic = nondeterministic
        self._fake_sizes = fake
        self._float_results = float_results
        self._layout_of = layout_of
        self._flatten = flatten or flatten_batches
        self.unserved = unserved_devices(name)
        self.kernel = self._bind()
        self.tensors = self._count_tensors()
        self._floats = self._positions_of_floats()
        self._is_constant = bool(non_differentiable) and len(non_differentiable) == self._count_results()
        self.function = self._make_function()
        self._apply = function_caller(self.function)
        self._clamps = clamps if callable(clamps) else (lambda *_: True) if clamps else None
        self._call_kernel: Any = kernel_caller(self.kernel) if self._clamps is None else self._first_call
        # The types that kernels serve; looked up on every call.
        self._on_cpu, self._on_cuda = (
            frozenset(() if device in self.unserved else self.dtypes) for device in ("cpu", "cuda")
        )

    # In one frame, of names that are looked up at once: with less of both this was a sixth of the time of a small call.
    def __call__(self, *args: Any) -> Any:
        x = args[0]
        served = self._on_cpu if x.is_cpu else self._on_cuda if x.is_cuda else ()
        if _backend.ask_backend or x.dtype not in served or type(x) not in _PLAIN:
            if not self.is_native(x):
                return self.reference(*args)
        if self.supports is not None and (reason := self.supports(*args)) is not None:
            return self._call_reference(reason, args)
        if self.nondeterministic and torch.are_deterministic_algorithms_enabled():
            if self.nondeterministic is True or self.nondeterministic(*args):
                reason = "its kernel is not deterministic and torch.use_deterministic_algorithms is on"
                return self._call_reference(reason, args)
        if is_compiling() or is_tracing():
            return self._call_traced(args)
        if in_function_transform():
            return self.function.apply(*args)
        if is_grad_enabled():
            for a in args[: self.tensors]:
                if a is not None and a.requires_grad:
                    return self._apply(*args)
        if in_forward_ad() and carry_tangents(*args[: self.tensors]):
            return self._apply(*args)
        with below_autograd():
            return self._call_kernel(*args)

    def _first_call(self, *args: Any) -> Any:
        """The kernel, which later calls do not reach by way of this."""
        call = self._call_kernel = kernel_caller(self.kernel)
        assert call is not None  # what is not built is not called
        result = call(*args)  # which refuses what `clamps` could not read
        if self._clamps is not None and self._clamps(*args):
            look_at_range(args[0])
        return result

    def _call_traced(self, args: Sequence[Any]) -> Any:
        """What a graph is to hold: the operator, or the operators of its reference.

        ONNX has no kernels. An operator of a graph has gradients, but no rule for the transforms of torch.func that
        differentiate inside of the graph, nor for forward mode.
        """
        if in_onnx_export():
            return self._call_reference("ONNX has no kernels of it", args)
        if in_derivative_transform() or carry_tangents(*args[: self.tensors]):
            if not self._is_constant:
                return self.reference(*args)
            args = [a.detach() if isinstance(a, Tensor) else a for a in args]
        if not is_compiling():
            return self.kernel(*map(_recorded, args))
        if self._floats and not is_exporting() and are_symbolic([args[i] for i in self._floats]):
            _write_symbolic_calls_into_graphs()
            return _call_symbolic(self.name, *args)
        return self.kernel(*args)

    # The one predicate on devices and types; `supports` is the one on all arguments.
    def is_native(self, x: Tensor) -> bool:
        """Whether the kernels serve a call on `x`; raises under backend("native") where they do not."""
        chosen = current_backend()
        if chosen == "reference":
            return False
        served: Collection[torch.dtype] = self._on_cpu if x.is_cpu else self._on_cuda if x.is_cuda else ()
        if hasattr(x, "placements"):  # a DTensor, whose shards torch's own operators know
            served = ()
        if x.dtype in served:
            return True
        if chosen == "native":
            device = x.device.type
            self._refuse(self.unserved.get(device) or f"there is no kernel for {x.dtype} on {device}")
        return False

    def conditions(self) -> list[str]:
        """What has to hold for the kernels to serve a call, besides its device and type."""
        stated = [(self.supports.__doc__ or "").partition("\n")[0]] if self.supports else []
        return [*stated, "torch.use_deterministic_algorithms is off."] if self.nondeterministic else stated

    def _call_reference(self, reason: str, args: Sequence[Any]) -> Any:
        """Call the reference, because of `reason`; raises under backend("native")."""
        if _backend.ask_backend and current_backend() == "native":
            self._refuse(reason)
        return self.reference(*args)

    def _refuse(self, reason: str) -> None:
        raise RuntimeError(f"{self.name}: backend 'native' was asked for, but {reason}; see kvision.info()")

    # --- registration with torch ---

    def _bind(self) -> Any:
        if "cpu" in self.unserved:
            return None
        qualified = f"kvision::{self.name}"
        kernel = find_operator("kvision", self.name).default
        torch.library.register_fake(qualified, self._fake)
        torch.library.register_vmap(qualified, functools.partial(self._vmap, kernel))
        library.impl(self.name, self._differentiate, "Autograd")
        return kernel

    def _differentiate(self, *args: Any) -> Any:
        """The operator where torch differentiates: in graphs, and in calls of torch.ops.kvision."""
        if not self._is_constant:
            if in_derivative_transform():
                return self.reference(*args)
            tensors = args[: self.tensors]
            wants_gradient = is_grad_enabled() and any(t is not None and t.requires_grad for t in tensors)
            if wants_gradient or (in_forward_ad() and carry_tangents(*tensors)):
                return self._apply(*args)
        with below_autograd():
            return self._call_kernel(*args)

    def call_symbolic(self, *args: Any) -> Any:
        """A call of the kernel with numbers that are symbolic in the graph that is traced."""
        if in_function_transform():
            return self.reference(*args)
        call, function = self._with_symbolic_numbers
        wants_gradient = is_grad_enabled() and any(t is not None and t.requires_grad for t in args[: self.tensors])
        return function.apply(*args) if wants_gradient else call(*args)

    @functools.cached_property
    def _with_symbolic_numbers(self) -> tuple[Callable[..., Any], type[torch.autograd.Function]]:
        """The kernel as a function of symbolic numbers, and the same with gradients."""
        call = kernel_of_tensors(library, self.name, self.kernel, self._floats, self._fake)
        return call, self._make_function(call)

    def _make_function(self, call: Callable[..., Any] | None = None) -> type[torch.autograd.Function]:
        operator = self

        def forward(*args: Any) -> Any:
            with below_autograd():
                return operator._call_kernel(*args)

        def backward_of_symbols(ctx: Any, *grads: Tensor) -> Any:
            with compiling() if are_symbolic(ctx.plain) else contextlib.nullcontext():
                return self._backward(ctx, *grads)

        rules = {
            "forward": call or forward,
            "setup_context": self._setup_context,
            "backward": backward_of_symbols if call else self._backward,
            "jvp": self._jvp,
            "vmap": functools.partial(self._vmap, self),
        }
        return type(self.name, (torch.autograd.Function,), {k: staticmethod(v) for k, v in rules.items()})

    def _fake(self, *args: Any) -> Any:
        x, sizes = args[self._layout_of], self._sizes(*args)
        dtype = torch.float32 if self._float_results and x.dtype == torch.uint8 else x.dtype
        if isinstance(sizes, list):
            return tuple(_empty(x, s, dtype) for s in sizes)
        return _empty(x, sizes, dtype)

    def _sizes(self, *args: Any) -> Any:
        return args[0].shape if self._fake_sizes is None else self._fake_sizes(*args)

    @without_hints()
    def _vmap(self, call: Callable[..., Any], info: Any, in_dims: tuple[Any, ...], *args: Any) -> tuple[Any, Any]:
        """One call for all n elements if it gives their results one after the other, else a call for each."""
        n = info.batch_size

        def element(i: int) -> list[Any]:
            if n == 0:  # the Jacobian of an empty tensor
                return [a.sum(dim, dtype=a.dtype) if isinstance(dim, int) else a for a, dim in zip(args, in_dims)]
            return [a.select(dim, i) if isinstance(dim, int) else a for a, dim in zip(args, in_dims)]

        sizes, flattened = self._result_sizes(element(0)), self._flatten(n, in_dims, args)
        if flattened is not None and self._result_sizes(flattened) == [(n * size[0], *size[1:]) for size in sizes]:
            output = call(*flattened)
            mapped = [y.reshape(n, *size) for y, size in zip(_as_tuple(output), sizes)]
        else:
            outputs = [call(*element(i)) for i in range(max(n, 1))]
            output = outputs[0]
            mapped = [torch.stack(results)[:n] for results in zip(*map(_as_tuple, outputs))]
        return (tuple(mapped), (0,) * len(mapped)) if isinstance(output, (tuple, list)) else (mapped[0], 0)

    def _result_sizes(self, args: Sequence[Any]) -> list[tuple[int, ...]]:
        sizes = self._sizes(*args)
        listed = sizes if isinstance(sizes, list) else [sizes]
        return [tuple(s.shape) if isinstance(s, Tensor) else tuple(s) for s in listed]

    # --- derivatives ---

    @functools.cached_property
    def backward(self) -> Callable[..., Sequence[Tensor | None]]:
        """`backward(needs, grads..., results if they are saved..., *args) -> gradients of the tensor arguments`."""
        if self.words:
            return compile_words(self, _registered_operator)
        return self.by_hand or self.differentiate_reference

    @functools.cached_property
    def entries(self) -> list[Entry]:
        """Those of the words of its gradients."""
        return parse(self.name, self.words, self.kernel, _registered_operator)

    @functools.cached_property
    def takes_sizes(self) -> bool:
        """Whether the words of its gradients ask of the first tensor for no more than the sizes."""
        return self.linear and bool(self.words) and not reads_first(self.entries)

    def _count_tensors(self) -> int:
        """How many arguments are tensors or None; they come first."""
        if self.kernel is None:
            return 0
        return sum("Tensor" in str(a.type) for a in schema_of(self.kernel).arguments)

    def _positions_of_floats(self) -> tuple[int, ...]:
        """Which arguments are floats or lists of floats."""
        arguments = () if self.kernel is None else schema_of(self.kernel).arguments
        return tuple(i for i, a in enumerate(arguments) if "float" in str(a.type))

    def _count_results(self) -> int:
        return 0 if self.kernel is None else len(schema_of(self.kernel).returns)

    def _setup_context(self, ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        tensors = inputs[: self.tensors]
        is_linear_map = self._is_linear_map(tensors)
        ctx.sizes = tensors[0].shape if is_linear_map or self.takes_sizes else None
        if self.saves_results:
            tensors = (*_as_tuple(output), *tensors)
        if self.non_differentiable:
            ctx.mark_non_differentiable(*(_as_tuple(output)[i] for i in self.non_differentiable))
            ctx.set_materialize_grads(False)  # no zeros for these
        in_backward = tensors if ctx.sizes is None else (None, *tensors[1:])
        ctx.save_for_backward(*in_backward)
        if in_forward_ad():
            ctx.save_for_forward(*(in_backward if is_linear_map else tensors))
        ctx.plain = inputs[self.tensors :]
        # autograd differentiates on a thread of its own for CUDA, which is in no block.
        ctx.backend = current_backend() if _backend.ask_backend else None

    def _is_linear_map(self, tensors: Sequence[Tensor | None]) -> bool:
        """Whether the result is linear in all the tensors there are, that is, in the first one."""
        if not self.linear:
            return False
        for t in tensors[1:]:
            if t is not None:
                return False
        return True

    def _backward(self, ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        needs = ctx.needs_input_grad
        if all(grad is None for grad in grads):
            return (None,) * len(needs)
        # What torch.func.vjp wrapped hides, once vjp has returned, that a tensor requires a gradient.
        grads, saved = unwrap_dead_wrappers(grads), unwrap_dead_wrappers(ctx.saved_tensors)
        if ctx.sizes is not None:
            saved = (ctx.sizes, *saved[1:])
        if ctx.backend is None and not _backend.ask_backend:
            input_grads = self.backward(needs, *grads, *saved, *ctx.plain)
        else:
            with backend(ctx.backend or _backend.default_backend):
                input_grads = self.backward(needs, *grads, *saved, *ctx.plain)
        return (*input_grads, *(None,) * (len(needs) - len(input_grads)))

    def _jvp(self, ctx: Any, *tangents: Tensor | None) -> Any:
        if self._is_constant:
            return (None,) * self._count_results()
        tensors = ctx.saved_tensors[-self.tensors :]  # after the results, where they are saved
        if self._is_linear_map(tensors):
            return self(tangents[0], *tensors[1:], *ctx.plain)
        args = (*tensors, *ctx.plain)
        if self.jvp is not None:
            return self.jvp(tangents[: self.tensors], *args)
        indices = [i for i, t in enumerate(tangents) if t is not None]
        f = self._reference_of_tensors(args, indices, self.non_differentiable)
        _, jvp_fn = linearize(f, *(args[i] for i in indices))
        output_tangents = jvp_fn(*(tangents[i] for i in indices))
        if not self.non_differentiable:
            return output_tangents
        rest = iter(output_tangents)
        outputs = range(self._count_results())
        return tuple(None if i in self.non_differentiable else next(rest) for i in outputs)

    def differentiate_reference(self, needs: Sequence[bool], *grads_and_args: Any) -> list[Tensor | None]:
        """The default backward; other backwards call it for gradients that have no kernel."""
        args = grads_and_args[-len(needs) :]
        constant = self.non_differentiable
        grads = tuple(g for i, g in enumerate(grads_and_args[: -len(needs)]) if i not in constant)
        indices = [i for i, need in enumerate(needs) if need]
        with _without_tf32():
            f = self._reference_of_tensors(args, indices, constant)
            _, vjp_fn = torch.func.vjp(f, *(args[i] for i in indices))
            input_grads = dict(zip(indices, vjp_fn(grads if constant or len(grads) > 1 else grads[0])))
        return [input_grads.get(i) for i in range(self.tensors)]

    def _reference_of_tensors(
        self, args: Sequence[Any], indices: Sequence[int], excluded: Sequence[int] = ()
    ) -> Callable[..., Any]:
        """The reference as a function of the tensors at `indices`, without its results at `excluded`."""

        def f(*values: Tensor) -> Any:
            full = list(args)
            for i, value in zip(indices, values):
                full[i] = value
            output = self.reference(*full)
            return tuple(y for i, y in enumerate(output) if i not in excluded) if excluded else output

        return f


class FastPath:
    """A kernel that is called without the rules of operators, because these take most of the host time of a small call.

    It replaces several operators in a row, or one operator with more arguments. It has no gradient and cannot be traced:
    callers ask `serves`, and call the operators where it is False.

    Args:
        name: name of the kernel, `torch.ops.kvision.<name>`.
        dtypes: types of images that the kernel supports.
        clamps: as that of Operator.
    """

    all: ClassVar[list[FastPath]] = []

    def __init__(self, name: str, dtypes: Collection[torch.dtype], clamps: bool = False) -> None:
        self.all.append(self)
        unserved = unserved_devices(name)
        self._on_cpu, self._on_cuda = (
            frozenset(() if "cpu" in unserved or device in unserved else dtypes) for device in ("cpu", "cuda")
        )
        self._call_kernel = None if "cpu" in unserved else kernel_caller(find_operator("kvision", name).default)
        self.kernel: Any = self._first_call if clamps else self._call_kernel

    def _first_call(self, x: Any, *args: Any) -> Any:
        self.kernel = self._call_kernel
        look_at_range(x if isinstance(x, Tensor) else x[0])
        return self.kernel(x, *args)

    def serves(self, x: Tensor) -> bool:
        """Whether a call on images `x` needs kernels only: no reference, gradient, function transform or tracing."""
        if (x.requires_grad and is_grad_enabled()) or is_compiling() or is_tracing() or type(x) is not Tensor:
            return False
        if x.dtype not in (self._on_cpu if x.is_cpu else self._on_cuda if x.is_cuda else ()) or x.numel() == 0:
            return False
        if in_function_transform() or (in_forward_ad() and carry_tangents(x)):
            return False
        return not _backend.ask_backend or current_backend() != "reference"


def not_empty(x: Tensor, *_: Any) -> str | None:
    """The first tensor has at least one element."""
    return None if x.numel() else f"there is no kernel for empty tensors, here {tuple(x.shape)}"


def has_pixels(x: Tensor, *_: Any) -> str | None:
    """Images have at least one pixel."""
    return None if 0 not in x.shape[2:] else f"there is no kernel for images without pixels, here {tuple(x.shape)}"


def no_derivative(*args: Any) -> str | None:
    """No derivative is needed: the backward pass differentiates the reference, which would be computed twice."""
    wanted = wants_derivative(*(a for a in args if isinstance(a, Tensor)))
    return "its derivatives are those of the reference" if wanted else None


def behind_grad(supports: Callable[..., str | None]) -> Callable[..., str | None]:
    """The `supports` of a backward operator that takes its gradient before the arguments of the operator."""
    return functools.wraps(supports)(lambda grad, *args: supports(*args))


def on_cuda(x: Tensor, *_: Any) -> bool:
    """The `nondeterministic` of operators whose CUDA kernels add by atomics."""
    return x.is_cuda


def transpose(reference: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """The transpose of a reference that is linear in its first tensor and keeps its shape: `transpose(f)(grad, *args)`."""

    def backward(grad: Tensor, *args: Any) -> Tensor:
        _, vjp_fn = torch.func.vjp(lambda x: reference(x, *args), torch.zeros_like(grad))
        return vjp_fn(grad)[0]

    return backward


def vjp(reference: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """The gradient of a reference for its first tensor: `vjp(f)(grad, x, *args)`."""

    def backward(grad: Tensor, x: Tensor, *args: Any) -> Tensor:
        _, vjp_fn = torch.func.vjp(lambda x: reference(x, *args), x)
        return vjp_fn(grad)[0]

    return backward


def linearize(f: Callable[..., Any], *tensors: Tensor) -> tuple[Any, Callable[..., Any]]:
    """`f(*tensors)`, and the function from tangents of all tensors to those of the results.

    J t is the derivative of u -> J^T u. So no level of forward mode is opened, which other threads would see and which
    cannot be nested.
    """
    output, vjp_fn = torch.func.vjp(f, *tensors)
    _, jvp_fn = torch.func.vjp(vjp_fn, _map(torch.zeros_like, output))
    return output, lambda *tangents: jvp_fn(tangents)[0]


# --- helpers --------------------------------------------------------------------------------------------------------


def _call_symbolic(name: str, *args: Any) -> Any:
    """A call of operator `name` with symbolic numbers, which is one function in the graph that torch.compile writes."""
    return _registered[name].call_symbolic(*args)


@constant_in_graphs
def _write_symbolic_calls_into_graphs() -> None:
    torch.compiler.allow_in_graph(_call_symbolic)  # not when it is defined, because this imports the compiler


def _recorded(argument: Any) -> Any:
    """A list of sizes as numbers, as torch.jit.trace records them; it represents sizes by tensors."""
    if isinstance(argument, (list, tuple)):
        return [n.item() if isinstance(n, Tensor) else n for n in argument]
    return argument


def _as_tuple(output: Any) -> tuple[Tensor, ...]:
    return tuple(output) if isinstance(output, (tuple, list)) else (output,)


def _map(f: Callable[[Any], Any], output: Any) -> Any:
    return tuple(map(f, output)) if isinstance(output, (tuple, list)) else f(output)


def _empty(x: Tensor, sizes: Sequence[int] | Tensor, dtype: torch.dtype) -> Tensor:
    """What the kernels allocate."""
    return sizes if isinstance(sizes, Tensor) else match_layout(x.new_empty(sizes, dtype=dtype), x)


def match_layout(y: Tensor, x: Tensor) -> Tensor:
    """`y` in the layout that the kernels write: dense, and channels-last if the image `x` is (layout_of in glue.h)."""
    c = x.shape[1] if x.dim() == y.dim() == 4 else 0
    if c > 1 and (x.stride(1), x.stride(3), x.stride(2)) == (1, c, c * x.shape[3]):
        return y.movedim(1, -1).contiguous().movedim(-1, 1)  # vmap does not support memory formats
    return y.contiguous()


_cudnn_conv = torch.backends.cudnn.conv  # type: ignore[attr-defined]  # made when torch is imported


@contextlib.contextmanager
def _without_tf32() -> Iterator[None]:
    """cuDNN's convolutions in float32, not in TF32, which torch lets them round to unless told otherwise."""
    previous, _cudnn_conv.fp32_precision = _cudnn_conv.fp32_precision, "ieee"
    try:
        yield
    finally:
        _cudnn_conv.fp32_precision = previous


def wants_derivative(*tensors: Tensor | None) -> bool:
    """Whether the result of a call on these tensors may be differentiated, so that it must come from differentiable operators."""
    if in_function_transform() or (in_forward_ad() and carry_tangents(*tensors)):
        return True
    if is_grad_enabled():
        for t in tensors:
            if t is not None and t.requires_grad:
                return True
    return False


def saturate_to_byte(x: Tensor) -> Tensor:
    """Round half to even and saturate, as OpenCV stores bytes."""
    return x.round().clamp(0, 255).to(torch.uint8)


def without_autocast_and_tf32(reference: Callable[..., Any]) -> Callable[..., Any]:
    """The reference as the kernels compute: no autocast, no TF32."""

    @functools.wraps(reference)
    def wrapped(*args: Any) -> Any:
        if is_any_autocast_enabled() and is_autocast_on(args[0]):
            with torch.autocast(args[0].device.type, enabled=False):
                return wrapped(*args)
        if args[0].is_cuda and not is_compiling() and _cudnn_conv.fp32_precision != "ieee":
            with _without_tf32():
                return wrapped(*args)
        return reference(*args)

    return wrapped


def through_floats(f: Callable[..., Any], levels: int = 1, plain: Sequence[int] = ()) -> Callable[..., Any]:
    """`f` of float32 images as a function of bytes: divides these by `levels`, multiplies the results and rounds them.

    The results `plain`, by index, are numbers that are neither multiplied nor rounded.
    """

    def stored(i: int, y: Tensor) -> Tensor:
        return y.to(torch.uint8) if i in plain else saturate_to_byte(y if levels == 1 else y * levels)

    def wrapped(*args: Any) -> Any:
        x, *rest = _promoted(args, torch.uint8)
        if levels != 1:  # by a tensor: CUDA multiplies by the reciprocal of a number, and 255ths would miss their level
            x = x / x.new_full((), levels)
        output = f(x, *rest)
        if isinstance(output, (tuple, list)):
            return tuple(stored(i, y) for i, y in enumerate(output))
        return stored(0, output)

    return wrapped


def with_kernel_casts(
    reference: Callable[..., Any],
    native_half: bool = False,
    layout_of: int = 0,
    levels: int = 1,
    plain: Sequence[int] = (),
    float_results: bool = False,
) -> Callable[..., Any]:
    """The reference with the kernels' rules: half types and bytes compute in float32, no autocast or TF32, their layout.

    With `native_half` the reference takes half types as they are, with `float_results` bytes give floats; `levels` and
    `plain` are those of `through_floats`.
    """
    of_bytes = through_floats(reference, levels, plain)

    @without_autocast_and_tf32
    @functools.wraps(reference)
    def wrapped(*args: Any) -> Any:
        x = args[0]
        dtype = x.dtype
        if dtype == torch.uint8 and float_results:
            dtype = torch.float32
        if dtype == torch.uint8:
            return _map(lambda y: match_layout(y, args[layout_of]), of_bytes(*args))
        if not (native_half and dtype in _HALF_TYPES):
            args = _promoted(args, dtype)
        output, like = reference(*args), args[layout_of]
        if isinstance(output, (tuple, list)):
            return tuple(_stored(y, dtype, like) for y in output)
        return _stored(output, dtype, like)

    return wrapped


def _promoted(args: tuple[Any, ...], dtype: torch.dtype) -> tuple[Any, ...]:
    """Arguments in the type that computes for images of `dtype`; labels and masks stay as they are."""
    for a in args:  # nearly always they have it, and small calls take no longer than this
        if isinstance(a, Tensor) and a.dtype is not dtype:
            break
    else:
        if dtype is torch.float32 or dtype is torch.float64:
            return args
    if dtype == torch.float64:
        return tuple(a.to(dtype) if isinstance(a, Tensor) and a.is_floating_point() else a for a in args)
    return tuple(a.float() if isinstance(a, Tensor) and a.dtype in _PROMOTED else a for a in args)


def _stored(y: Tensor, dtype: torch.dtype, like: Tensor) -> Tensor:
    """A result as the kernels store it, for images of floating-point type `dtype` and the layout of `like`."""
    if y.dtype is not dtype:
        y = y.to(dtype)
    return match_layout(y, like)


def flatten_batches(n: int, in_dims: tuple[Any, ...], args: tuple[Any, ...]) -> list[Any] | None:
    """The mapped axis joins the batch, which every tensor has in front.

    A tensor of one row for all samples stays one. Of a batch of one it cannot be told apart, and becomes a row for each.
    """
    tensors = [i for i, a in enumerate(args) if isinstance(a, Tensor)]
    sizes = [size_below_vmap(args[i], in_dims[i]) for i in tensors]
    batch = next((size for size in sizes if size != 1), 1)
    flattened = list(args)
    for i, size in zip(tensors, sizes):
        if size not in (1, batch):
            return None
        if in_dims[i] is None and size != batch and i != tensors[0]:
            continue
        flattened[i] = flatten_batch(args[i], in_dims[i], n, batch)
    return flattened


def size_below_vmap(x: Tensor, dim: int | None) -> int:
    """The size of axis 0 without the mapped axis `dim`."""
    return x.shape[1 if dim == 0 else 0]


def flatten_batch(x: Tensor, dim: int | None, n: int, batch: int) -> Tensor:
    """(n * batch, ...), where `x` has n batches along axis `dim`, or one for all; a batch may be 1 row for all."""
    x = x.unsqueeze(0).expand(n, *x.shape) if dim is None else x.movedim(dim, 0)
    if x.shape[1] != batch:
        x = x.expand(n, batch, *x.shape[2:])
    return x.reshape(n * batch, *x.shape[2:])
