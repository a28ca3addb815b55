"""Invalid calls of torch.ops.kvision.*, which skip the checks of the Python functions as C++ and exported programs do.

A kernel with bad arguments may crash the process, so calls on the CPU run in a forked process.
"""

from __future__ import annotations

import faulthandler
import os
import signal
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._modes import BORDER

Call = tuple[str, list[Any]]  # what is wrong with the call, its arguments

SIZES = (0, -1, -(2**40), 2**15, 2**31, 2**62)
# What arguments of these names may be.
RIGHT = {
    **{"border": ["0"], "distance": ["0"], "mode": ["0"]},
    **{"top": ["0"], "left": ["0"], "steps": ["0", str(2**15)], "radius": ["0", str(2**15)]},
    **{
        name: ["0"]
        for name in ("cfa", "filter", "format", "interpolation", "kernel", "kind", "model", "statistic", "padding")
    },  # numbers of choices
    **{"ignored": [str(n) for n in SIZES], "target": ["of torch.int64"], "image_index": ["of torch.int64"]},
    **{"input_mask": ["of torch.bool"], "other_mask": ["of torch.bool"]},
}
DTYPES = (torch.int64, torch.bool, torch.complex64, torch.float8_e4m3fn)


def wrong_calls(operator: Any, args: Sequence[Any]) -> Iterator[Call]:
    """Invalid calls that the operator has to reject, derived from a valid one."""
    names = [a.name for a in operator._schema.arguments]
    tensors = [i for i, a in enumerate(args) if isinstance(a, Tensor)]
    rank = max(args[i].dim() for i in tensors)
    images = [i for i in tensors if args[i].dim() == rank]

    def call(what: str, values: dict[int, Any]) -> Call:
        return what, [values.get(i, a) for i, a in enumerate(args)]

    for i, argument in enumerate(operator._schema.arguments):
        for what, value in wrong_values(str(argument.type), args[i], i in images):
            if what not in RIGHT.get(argument.name, ()):
                yield call(f"{argument.name} {what}", {i: value})

    # Tensors that are valid alone but inconsistent with the others.
    for i in tensors if len(tensors) > 1 else []:
        x, batch = args[i], max(args[k].shape[0] for k in tensors if k != i)
        yield call(f"{names[i]} of another dtype", {i: x.double()})
        if batch > 1:
            yield call(f"{names[i]} of another batch", {i: x.new_ones(batch + x.shape[0], *x.shape[1:])})
    for i in images if len(images) > 1 else []:
        for axis in (axis for axis in (-1, -2) if args[i].shape[axis]):
            yield call(f"{names[i]} cut along axis {axis}", {i: args[i].narrow(axis, 0, args[i].shape[axis] - 1)})
    if "border" in names and all(args[i] for i, name in enumerate(names) if name == "same"):
        pixels = {i: args[i][..., :1, :1] for i in images}
        border = names.index("border")
        yield call("border reflect around a pixel", {**pixels, border: BORDER["reflect"]})


def wrong_values(kind: str, value: Any, is_image: bool) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Tensor):
        yield from ((f"of {dtype}", value.to(dtype)) for dtype in DTYPES)
        yield "without axes", value.new_ones(())
        yield "of one axis less", value.select(-1, 0)
        yield "of one axis more", value[None]
        if is_image:
            yield "without rows", value[..., :0, :]
            yield "without columns", value[..., :0]
    elif "Tensor" in kind:
        yield from ((f"of {n} axes", torch.ones((1,) * n)) for n in (0, 5))
    elif kind == "int":
        yield from ((str(n), n) for n in SIZES)


def taken(calls: Sequence[tuple[Any, Call]]) -> list[str]:
    """The calls of operators that do not raise a RuntimeError that starts with the operator's name, and their outcomes.

    One process makes them all: a fork of this one takes longer than hundreds of calls.
    """
    named = [
        (f"{operator._schema.name.removeprefix('kvision::')}, {what}", operator, args)
        for operator, (what, args) in calls
    ]
    if any(isinstance(a, Tensor) and a.is_cuda for _, _, args in named for a in args):
        return [f"{what}: {end}" for what, operator, args in named if (end := outcome(operator, args))]
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        faulthandler.disable()
        torch.set_num_threads(1)  # a forked process has none of torch's worker threads
        signal.alarm(60)
        for what, operator, args in named:
            os.write(writer, f"{what}: ".encode())
            os.write(writer, f"{outcome(operator, args)}\n".encode())
        os._exit(0)
    os.close(writer)
    with open(reader) as pipe:
        lines = pipe.read().splitlines()
    _, status = os.waitpid(child, 0)
    return [line for line in lines if not line.endswith(": ")] + ([f"{lines[-1]}status {status}"] if status else [])


def outcome(operator: Any, args: Sequence[Any]) -> str:
    """The outcome of a call. Empty if the call is rejected as expected."""
    name = operator._schema.name.removeprefix("kvision::")
    try:
        operator(*args)
        if args[0].is_cuda:
            torch.cuda.synchronize()
    except RuntimeError as error:
        return "" if str(error).startswith(f"{name}: ") else " ".join(repr(error).split())[:200]
    return "no error"
