"""The parts of torch without a public name, and what torch.onnx lacks; every other file of kvision uses public names only.

A comment says what each part waits for. tests/packaging/test_torch_compat.py asserts that no other file reaches
a private one, and tools/test_torch_versions.py runs the core of the suite on the oldest and the newest torch.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import sys
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch._C import _are_functorch_transforms_active, _AutoDispatchBelowAutograd
from torch._C._functorch import (
    TransformType,
    get_interpreter_stack,
    get_unwrapped,
    is_batchedtensor,
    is_functorch_wrapped_tensor,
)
from torch._functorch.utils import unwrap_dead_wrappers
from torch._ops import OpOverload
from torch.autograd import forward_ad
from torch.compiler import is_compiling
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_unflatten

__all__ = [
    "ConstantModule",
    "LoadedModule",
    "TorchDispatchMode",
    "before_first_lookup",
    "below_autograd",
    "carry_tangents",
    "compiling",
    "constant_in_graphs",
    "find_operator",
    "full",
    "function_caller",
    "has_kernel",
    "has_static_value",
    "hypot",
    "in_derivative_transform",
    "in_forward_ad",
    "in_function_transform",
    "in_onnx_export",
    "is_any_autocast_enabled",
    "is_mapped",
    "is_tracing",
    "keep_calls_apart",
    "kernel_caller",
    "largest",
    "linspace",
    "refuse_script",
    "sample_dirichlet",
    "schema_of",
    "smallest",
    "tree_flatten",
    "tree_unflatten",
    "unwrap_dead_wrappers",
    "without_transforms",
]

# Whether torch.func.vmap, grad, vjp, jvp or functionalize is active. Waits for a public predicate in torch.func.
in_function_transform = _are_functorch_transforms_active

# Whether torch.jit.trace records. torch.jit.is_tracing is public, but has two Python frames around this, which is asked on
# every call; unlike it, this one waits for torch.compile to know it.
is_tracing = torch._C._is_tracing

# Whether a device's autocast is on. torch.is_autocast_enabled is public, but asks for one device by its name, which takes longer
# to find than this answer, nearly always no. Waits for a public one.
is_any_autocast_enabled = torch._C._is_any_autocast_enabled

# Calls inside skip autograd's dispatch key and reach the kernel. Python's counterpart of the public C++ class
# at::AutoDispatchBelowAutograd; waits for a public one, such as a context manager in torch.library.
below_autograd = _AutoDispatchBelowAutograd

# `unwrap_dead_wrappers(tensors)`: the tensors without the wrappers of transforms that have returned. Waits for a
# ctx.saved_tensors of autograd.Function that unwraps them.

# `tree_flatten`, `tree_unflatten`: of nested lists and dicts, as torchvision uses them. Waits for a public torch.utils.pytree.

# `sample_dirichlet(concentrations)`: without torch.distributions, whose import takes longer. Waits for a public function.
sample_dirichlet = torch._sample_dirichlet

# `TorchDispatchMode`: sees every operator that runs. torch's documentation of extensions describes it, but there is no
# public module to import it from; waits for torch.utils.python_dispatch.


def without_transforms(x: Tensor) -> Tensor:
    """The values of `x` outside of torch.func's transforms: all samples of a vmap at once.

    Waits for a public unwrap in torch.func.
    """
    while is_functorch_wrapped_tensor(x):
        x = get_unwrapped(x)
    return x


def is_mapped(x: Tensor) -> bool:
    """Whether `x` has an axis that torch.func.vmap hides. Waits for what `without_transforms` waits for."""
    while is_functorch_wrapped_tensor(x):
        if is_batchedtensor(x):
            return True
        x = get_unwrapped(x)
    return False


class LoadedModule(nn.Module):
    """A module that sees a state dict before it loads it, and knows whether a missing key is an error.

    Waits for a method of nn.Module: the public hook is registered object by object, and `strict` is True to it in any case.
    """

    def _before_loading(self, state_dict: dict[str, Any], prefix: str, is_strict: bool, errors: list[str]) -> None:
        raise NotImplementedError

    def _load_from_state_dict(
        self,
        state_dict: dict[str, Any],
        prefix: str,
        metadata: Any,
        strict: bool,
        missing: Any,
        extra: Any,
        errors: Any,
    ) -> None:
        frame = sys._getframe()
        while frame.f_back is not None and frame.f_code is not nn.Module.load_state_dict.__code__:
            frame = frame.f_back
        self._before_loading(state_dict, prefix, frame.f_locals.get("strict", strict), errors)
        super()._load_from_state_dict(state_dict, prefix, metadata, strict, missing, extra, errors)


class ConstantModule(nn.Module):
    """A module whose buffers that are no part of its state dict keep their values wherever it is moved, also by `to_empty`.

    Waits for a method of nn.Module that says which buffers a state dict lacks, and for one that rebuilds them.
    """

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> ConstantModule:
        constants = {name: x for name in self._non_persistent_buffers_set if (x := self._buffers[name]) is not None}
        super()._apply(fn, recurse)
        for name, x in constants.items():
            moved = self._buffers[name]
            assert moved is not None  # nn.Module moves what is there
            if x.is_meta and not moved.is_meta:
                raise RuntimeError(
                    f"{type(self).__name__}: {name} was made on 'meta', has no values and is in no state dict; make the module "
                    "with tensors that have values"
                )
            if moved is not x:
                self._buffers[name] = x.to(moved.device, moved.dtype)
        return self


def in_forward_ad() -> bool:
    """Whether a level of forward-mode differentiation is open, in any thread.

    Waits for a public predicate in torch.autograd.forward_ad.
    """
    return forward_ad._current_level >= 0


def carry_tangents(*tensors: Tensor | None) -> bool:
    """Whether forward mode differentiates a call on `tensors`. The level that is open may be another thread's.

    Waits for what in_forward_ad waits for. A graph shows no tangents, and is only used at the level that it was made at.
    """
    if not in_forward_ad():
        return False
    if is_compiling() or _in_transform(TransformType.Jvp):
        return True
    for x in tensors:
        if x is not None and forward_ad.unpack_dual(without_transforms(x)).tangent is not None:
            return True
    return False


def in_onnx_export() -> bool:
    """Whether torch.onnx.export traces; a public name, but torch imports torch.onnx only when it is asked for."""
    return (is_compiling() or is_tracing()) and torch.onnx.is_in_onnx_export()


def hypot(x: Tensor, y: Tensor) -> Tensor:
    """torch.hypot, for ONNX of other operators. Waits for torch.onnx to take it."""
    if not in_onnx_export():
        return torch.hypot(x, y)
    largest = torch.maximum(x.abs(), y.abs())
    unit = torch.where(largest > 0, largest, 1)  # squares then neither overflow nor underflow
    return unit * ((x / unit) ** 2 + (y / unit) ** 2).sqrt()


def has_kernel(operator: str, dispatch_key: str) -> bool:
    """Whether `operator`, say "kvision::sobel", has a kernel for a key, say "CUDA". Waits for a query in torch.library."""
    return torch._C._dispatch_has_kernel_for_dispatch_key(operator, dispatch_key)


def find_operator(namespace: str, name: str) -> Any:
    """`torch.ops.<namespace>.<name>`, None where it is not declared, without the hook of before_first_lookup.

    Waits for what before_first_lookup waits for.
    """
    operators = getattr(torch.ops, namespace)
    if name not in vars(operators):
        try:
            return type(operators).__getattr__(operators, name)
        except AttributeError:
            return None
    return getattr(operators, name)


def before_first_lookup(namespace: str, prepare: Callable[[], None]) -> None:
    """Call `prepare` when an operator of `torch.ops.<namespace>` that find_operator has not found yet is looked up.

    Waits for a lazy torch.library.register_fake and register_autograd. A namespace of torch.ops is a module, so that it
    can have a __getattr__ of its own; torch's, that of its class, comes after it.
    """
    operators = getattr(torch.ops, namespace)

    def __getattr__(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)  # asked of every module
        prepare()
        vars(operators).pop("__getattr__", None)
        return getattr(operators, name)

    operators.__getattr__ = __getattr__


def keep_calls_apart(operator: Any) -> None:
    """Keep compilers from replacing calls of a random operator of torch.ops by the result of an equal call.

    The pass that does so in graphs with gradients has a list of torch's random operators. Waits for one that asks for
    Tag.nondeterministic_seeded.
    """
    from torch._functorch import compile_utils  # which only compilation needs

    if operator not in compile_utils.rand_ops:
        compile_utils.rand_ops.append(operator)


def constant_in_graphs(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let torch.compile call `function` once and write its result into the graph.

    torch.compiler.assume_constant_result is public, but imports the compiler, which takes more than a second that programs
    without compilation would pay for. Waits for torch 2.14 to be the oldest, whose own only sets this mark.
    """
    function._dynamo_marked_constant = True  # type: ignore[attr-defined]
    return function


@constant_in_graphs
def _in_transform(*types: TransformType) -> bool:
    """Whether one of torch.func's transforms that are active in this thread has one of these types."""
    return any(transform.key() in types for transform in get_interpreter_stack() or ())


def in_derivative_transform() -> bool:
    """Whether torch.func.grad, vjp or jvp is active, and not only vmap. Waits for a public predicate in torch.func."""
    return in_function_transform() and _in_transform(TransformType.Grad, TransformType.Jvp)


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """torch.compiler.is_compiling() inside, where autograd is traced for a graph.

    Waits for torch 2.13 to be the oldest, whose compiler itself sets it until a graph is compiled.
    """
    previous, torch.compiler._is_compiling_flag = torch.compiler._is_compiling_flag, True
    try:
        yield
    finally:
        torch.compiler._is_compiling_flag = previous


def is_exporting() -> bool:
    """Whether torch.export traces. Waits for a torch whose is_exporting is not also true while it compiles, as in 2.11."""
    return torch.compiler._is_exporting_flag


def has_static_value(number: float) -> bool:
    """Whether a number is no symbol of the graph that is compiled. torch imports its module of symbols only when it compiles."""
    if is_compiling():
        return torch.fx.experimental.symbolic_shapes.has_static_value(number)
    return not isinstance(number, (torch.SymInt, torch.SymFloat))  # as what is allowed in a graph meets them


def full(shape: tuple[int, ...], number: float, **options: Any) -> Tensor:
    """torch.full. Waits for compilers that keep a number symbolic there, as they do in a product."""
    if has_static_value(number):
        return torch.full(shape, number, **options)
    return torch.ones(shape, **options) * number


def linspace(first: float, last: float, n: int, like: Tensor) -> Tensor:
    """torch.linspace of the type and device of `like`. Waits for one that keeps a number of steps symbolic in a graph."""
    if has_static_value(n):
        return torch.linspace(first, last, n, dtype=like.dtype, device=like.device)
    at = torch.arange(n, dtype=like.dtype, device=like.device)
    step = (last - first) / (n - 1)
    return torch.where(at < n // 2, first + step * at, last - step * (n - 1 - at))


def largest(*sizes: int) -> int:
    """The largest of sizes, also of those that are symbolic in a graph. Waits for a dynamo whose torch.sym_max takes ints."""
    return max(sizes) if _are_ints(sizes) else functools.reduce(torch.sym_max, sizes)


def smallest(*sizes: int) -> int:
    """The smallest of sizes, as in `largest`."""
    return min(sizes) if _are_ints(sizes) else functools.reduce(torch.sym_min, sizes)


def _are_ints(sizes: tuple[int, ...]) -> bool:
    return {*map(type, sizes)} == {int}


def schema_of(operator: OpOverload) -> Any:
    """The schema, which lists `arguments` and `returns`. Waits for a public attribute of OpOverload."""
    return operator._schema


def kernel_caller(operator: OpOverload | None) -> Callable[..., Any] | None:
    """What `operator` calls, without the Python frame around it. Waits for an OpOverload whose call is in C++."""
    return getattr(operator, "_op", None)


def function_caller(function: type[torch.autograd.Function]) -> Callable[..., Any]:
    """`function.apply` without its Python part, which binds arguments to their names and serves torch.func only.

    It is the apply of the private base class of autograd.Function. Waits for an apply that is in C++ as a whole.
    """
    return super(torch.autograd.Function, function).apply  # type: ignore[misc]  # stubs lack the base class


def refuse_script(package: dict[str, Any]) -> None:
    """Let torch.jit.script, which torch has deprecated, say for the functions and modules of a package what to use instead.

    Without it the compiler of TorchScript complains of whatever it does not know in them. Waits for torch.jit to be gone.
    """
    for name, value in package.items():
        if not getattr(value, "__module__", "").startswith("kvision."):
            continue
        sentence = (
            f"kvision's {name} is not compiled by torch.jit.script, which PyTorch has deprecated: use torch.export (with "
            "AOTInductor where there is no Python) or torch.jit.trace."
        )
        if inspect.isfunction(value):
            value.__script_unsupported = sentence  # type: ignore[attr-defined]  # torch.jit.script looks for it
        elif inspect.isclass(value) and issubclass(value, nn.Module):
            value.__prepare_scriptable__ = functools.partialmethod(_raise_script_error, sentence)  # type: ignore[attr-defined]


def _raise_script_error(_: nn.Module, sentence: str) -> None:
    raise RuntimeError(f"TorchScript error: {sentence}")
