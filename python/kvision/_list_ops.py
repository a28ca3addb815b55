"""Operators on lists of images of different sizes: what `_ops.Operator` is to tensors, for a first argument Tensor[].

The samples of a list are independent, so that the reference is a loop over single images, and one operator on a batch says
which devices and types have kernels. Autograd tracks tensors that are arguments by themselves, not those of a list; they are
passed one by one to the function that has the gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, is_grad_enabled
from torch.compiler import is_compiling

from kvision import _backend
from kvision._backend import backend, current_backend, unserved_devices
from kvision._ops import Operator, library
from kvision._torch_compat import (
    below_autograd,
    carry_tangents,
    find_operator,
    function_caller,
    in_derivative_transform,
    in_forward_ad,
    in_function_transform,
    is_tracing,
    kernel_caller,
    schema_of,
    unwrap_dead_wrappers,
)

Results = Sequence[Tensor]


class ListOperator:
    """An operator on a list of images or gradients, then tensors, each one for all samples or with a row for each, then numbers
    and lists of tensors without gradients.

    Args:
        name: name of the operator, `torch.ops.kvision.<name>`.
        of: the operator on batches with the same kernels: it has them where this has them, and is nondeterministic where this is.
        reference: the definition, a function of the same arguments that calls the references of operators on batches.
        fake: empty tensors like the results.
        backward: `backward(needs, grads, images, *args)` returns the gradients of the images, a list or None, and those of the
            other tensors; `needs` tells which of these are wanted. Written with registered operators.
        nondeterministic: whether the kernel may give other bits on a second run, from the arguments.
        supports: why the kernel does not serve these arguments, or None.
        saves_results: `backward(needs, grads, results, images, *args)` takes the results, too.
        non_differentiable: the numbers of results without gradients.
    """

    def __init__(
        self,
        name: str,
        of: Operator,
        reference: Callable[..., Results],
        *,
        fake: Callable[..., Results],
        backward: Callable[..., Sequence[Any]],
        nondeterministic: Callable[..., bool] = lambda *args: False,
        supports: Callable[..., str | None] = lambda *args: None,
        saves_results: bool = False,
        non_differentiable: Sequence[int] = (),
    ) -> None:
        self.name, self.of, self.reference, self._supports = name, of, reference, supports
        self._saves_results, self._non_differentiable = saves_results, non_differentiable
        self._fake, self.backward, self._nondeterministic = fake, backward, nondeterministic
        self.unserved = unserved_devices(name)
        self.kernel: Any = None if "cpu" in self.unserved else find_operator("kvision", name).default
        self._call_kernel: Any = kernel_caller(self.kernel)
        self.tensors = 0  # besides those of the list
        if self.kernel is not None:
            types = [str(a.type) for a in schema_of(self.kernel).arguments]
            self.tensors = sum("Tensor" in t and "List" not in t for t in types)
            qualified = f"kvision::{name}"
            torch.library.register_fake(qualified, fake)
            torch.library.register_vmap(qualified, self._refuse_vmap)
            library.impl(name, self._differentiate, "Autograd")
        self._function = self._make_function()
        self._apply = function_caller(self._function)

    def __call__(self, images: Sequence[Tensor], *args: Any) -> Results:
        x = images[0]
        if x.device.type in self.unserved or not self.of.is_native(x) or self._supports(images, *args) is not None:
            return self.reference(images, *args)
        if torch.are_deterministic_algorithms_enabled() and self._nondeterministic(images, *args):
            return self.reference(images, *args)
        if is_compiling() or is_tracing():
            return self._call_traced(images, args)
        if in_function_transform():
            return self._function.apply(len(images), *images, *args)
        if self._wants_gradient(images, args):
            return self._apply(len(images), *images, *args)
        if in_forward_ad() and carry_tangents(*images, *args[: self.tensors]):
            raise self._no_forward_mode()
        with below_autograd():
            return self._call_kernel(images, *args)

    def _call_traced(self, images: Sequence[Tensor], args: Sequence[Any]) -> Results:
        if in_derivative_transform():
            return self.reference(images, *args)
        return self.kernel(list(images), *args)

    def _wants_gradient(self, images: Sequence[Tensor], args: Sequence[Any]) -> bool:
        if not is_grad_enabled():
            return False
        for x in images:
            if x.requires_grad:
                return True
        return any(x is not None and x.requires_grad for x in args[: self.tensors])

    def _differentiate(self, images: Sequence[Tensor], *args: Any) -> Results:
        """The operator where torch differentiates: in graphs, and in calls of torch.ops.kvision."""
        if self._wants_gradient(images, args):
            return list(self._apply(len(images), *images, *args))
        with below_autograd():
            return self._call_kernel(images, *args)

    def _make_function(self) -> type[torch.autograd.Function]:
        operator = self

        def forward(count: int, *args: Any) -> tuple[Tensor, ...]:
            with below_autograd():
                return tuple(operator._call_kernel(list(args[:count]), *args[count:]))

        def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
            ctx.count, end = inputs[0], 1 + inputs[0] + operator.tensors
            ctx.save_for_backward(*inputs[1:end], *(output if operator._saves_results else ()))
            ctx.plain = inputs[end:]
            if operator._non_differentiable:
                ctx.mark_non_differentiable(*[output[i] for i in operator._non_differentiable])
            ctx.backend = current_backend() if _backend.ask_backend else None

        def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
            # What torch.func.vjp wrapped hides, once vjp has returned, that a tensor requires a gradient.
            grads, saved = unwrap_dead_wrappers(grads), unwrap_dead_wrappers(ctx.saved_tensors)
            count = ctx.count
            end = count + operator.tensors
            needs = ctx.needs_input_grad[1:]
            needed = (any(needs[:count]), *needs[count:end])
            results = (saved[end:],) if operator._saves_results else ()
            args = (needed, grads, *results, saved[:count], *saved[count:end], *ctx.plain)
            if ctx.backend is None and not _backend.ask_backend:
                of_images, *others = operator.backward(*args)
            else:
                with backend_of(ctx):
                    of_images, *others = operator.backward(*args)
            of_images = of_images or (None,) * count
            wanted = (g if need else None for g, need in zip(of_images, needs))
            return (None, *wanted, *others, *(None,) * len(ctx.plain))

        def backend_of(ctx: Any) -> Any:
            return backend(ctx.backend or _backend.default_backend)

        def jvp(ctx: Any, *tangents: Any) -> Any:
            raise operator._no_forward_mode()

        rules: dict[str, Any] = {
            "forward": forward,
            "setup_context": setup_context,
            "backward": backward,
            "jvp": jvp,
            "vmap": self._refuse_vmap,
        }
        return type(self.name, (torch.autograd.Function,), {k: staticmethod(v) for k, v in rules.items()})

    def _refuse_vmap(self, *_: Any) -> Any:
        raise NotImplementedError(
            f"{self.name}: lists of images have no vmap; pass the images of all elements as one list"
        )

    def _no_forward_mode(self) -> NotImplementedError:
        return NotImplementedError(
            f"{self.name}: lists of images have no forward mode; differentiate backward, or single images"
        )
