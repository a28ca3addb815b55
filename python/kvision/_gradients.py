"""Gradients by words: what `register(..., gradients=...)` says, for Python's autograd and for C++'s.

    register("sobel", _reference, gradients="input: sobel_backward")

The gradient to argument `input` is a call of operator `sobel_backward`. The arguments of that call are found by their
names: those of sobel (`normalized`), the gradients to its results (`grad`, `grad_values`: what is named like that and is no
argument of sobel, in order). What has another name is listed:

    input: median_blur_backward(output=detach(result))       a result of the forward call; results are then saved
    grad: box_blur(input=grad_grad)                          in an operator with an argument `grad`, the gradient to the result
    input: resize_backward(size=sizes(input))                the sizes of the first argument behind batch and channels
    input, factor: sharpness_backward(of_factor=needs(factor))     two results; whether a gradient is wanted
    pred: focal_backward; weight: reference                  entries; the reference is differentiated for `weight`
    input: gaussian_blur2d_backward; sigma: by_hand          the function `backward=` gives that to `sigma`

`result` is the only result, `result0` the first one of several, and so is `grad0`. `minus(corner)` has the opposite numbers.
Values may be Python's constants. An argument without an entry has no gradient, nor has one that is None. autograd sums a
gradient to the shape of its tensor and converts it to its type.

Python compiles the words to a function when the gradient is first needed. tools/generate.py writes the same calls to
include/kvision/ops.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from kvision._torch_compat import schema_of

BY_REFERENCE, BY_HAND = "reference", "by_hand"


class Value(NamedTuple):
    """An argument of a called operator: what it is, and the indices (or, for a constant, the value) that say which."""

    kind: str  # grad, argument, result, detach (a result), sizes, needs, minus, constant
    of: Any


class Entry(NamedTuple):
    """Gradients to the arguments `targets`, by index: the results of operator `call` of `values`, or BY_REFERENCE, BY_HAND."""

    targets: tuple[int, ...]
    call: str
    values: tuple[Value, ...]


def parse(name: str, words: str, kernel: Any, by_name: Callable[[str], Any]) -> list[Entry]:
    """The entries of the words of operator `name`, whose kernel has the schema; `by_name` finds other operators."""
    schema = schema_of(kernel)
    own = [a.name for a in schema.arguments]
    entries = []
    for text in words.split(";"):
        targets, _, call = text.partition(":")
        node = ast.parse(call.strip(), mode="eval").body
        listed = {k.arg: k.value for k in node.keywords} if isinstance(node, ast.Call) else {}
        function = ast.unparse(node.func if isinstance(node, ast.Call) else node)
        indices = tuple(own.index(target.strip()) for target in targets.split(","))
        values: list[Value] = []
        if function not in (BY_REFERENCE, BY_HAND):
            next_grad = 0
            for argument in (a.name for a in schema_of(by_name(function).kernel).arguments):
                if argument in listed:
                    values.append(_value(ast.unparse(listed.pop(argument)), own, len(schema.returns)))
                elif argument in own:
                    values.append(Value("argument", own.index(argument)))
                elif re.fullmatch(r"grad(_\w+|\d*)", argument):
                    values.append(Value("grad", next_grad))
                    next_grad += 1
                else:
                    raise ValueError(f"{name}: its gradient {function} has an argument {argument}, which it has not")
        if listed:
            raise ValueError(f"{name}: its gradient {function} has no argument {', '.join(map(str, listed))}")
        entries.append(Entry(indices, function, tuple(values)))
    return entries


def _value(text: str, own: Sequence[str], results: int) -> Value:
    node = ast.parse(text, mode="eval").body
    if isinstance(node, ast.Call):
        kind = ast.unparse(node.func)
        of = [_value(ast.unparse(a), own, results).of for a in node.args]
        if kind in ("detach", "sizes", "needs", "minus"):
            return Value(kind, tuple(of) if kind == "needs" else of[0])
    elif isinstance(node, ast.Name):
        if text in own:
            return Value("argument", own.index(text))
        kind, number = text.rstrip("0123456789"), text[len(text.rstrip("0123456789")) :]
        if kind in ("grad", "grad_grad"):
            return Value("grad", int(number or 0))
        if kind == "result" and (number or results == 1):
            return Value("result", int(number or 0))
    elif isinstance(node, ast.Constant):
        return Value("constant", node.value)
    raise ValueError(f"{text!r} is no value of a gradient")


def reads_first(entries: Sequence[Entry]) -> bool:
    """Whether gradients are computed from the first argument, and not only from its sizes."""
    return any(entry.call in (BY_REFERENCE, BY_HAND) or Value("argument", 0) in entry.values for entry in entries)


def compile_words(operator: Any, by_name: Callable[[str], Any]) -> Callable[..., Sequence[Any]]:
    """The function `backward(needs, grads..., results..., *args)` of an operator's words."""
    arguments, outputs = schema_of(operator.kernel).arguments, schema_of(operator.kernel).returns
    own = [f"a{i}" for i in range(len(arguments))]
    grads = [f"g{i}" for i in range(len(outputs))]
    results = [f"r{i}" for i in range(len(outputs))] if operator.saves_results else []
    globals: dict[str, Any] = {BY_REFERENCE: operator.differentiate_reference, BY_HAND: operator.by_hand}
    steps: list[str] = []
    to: dict[int, str] = {}  # the gradients

    def expression(value: Value) -> str:
        kind, of = value
        if kind == "sizes":
            return f"list(a{of}[2:])" if of == 0 and operator.takes_sizes else f"list(a{of}.shape[2:])"
        if kind == "minus":
            return f"[-x for x in a{of}]"
        if kind == "needs":
            return wanted(of)
        return {"grad": f"g{of}", "argument": f"a{of}", "result": f"r{of}", "detach": f"r{of}.detach()"}.get(
            kind, repr(of)
        )

    def wanted(targets: Sequence[int]) -> str:
        return " or ".join(f"needs[{i}]" for i in targets)

    for k, (targets, called, values) in enumerate(operator.entries):
        if called in (BY_REFERENCE, BY_HAND):
            needs = "".join(f"needs[{i}], " if i in targets else "False, " for i in range(len(own)))
            inputs = grads + (results if called == BY_HAND else []) + own
            steps.append(
                f"x{k} = {called}(({needs}), {', '.join(inputs)}) if {wanted(targets)} else [None] * {len(own)}"
            )
            to |= {i: f"x{k}[{i}]" for i in targets}
            continue
        globals[called] = by_name(called)
        call = f"{called}({', '.join(map(expression, values))})"
        if len(targets) == 1:
            to[targets[0]] = call if operator.tensors == 1 else f"{call} if needs[{targets[0]}] else None"
            continue
        steps.append(f"x{k} = {call} if {wanted(targets)} else [None] * {len(targets)}")
        for n, i in enumerate(targets):
            is_optional = "Optional" in str(arguments[i].type)
            to[i] = f"x{k}[{n}] if needs[{i}] else None" if is_optional else f"x{k}[{n}]"
    steps.append(f"return [{', '.join(to.get(i, 'None') for i in range(max(to) + 1))}]")
    body = "".join(f"    {step}\n" for step in steps)
    source = f"def backward(needs, {', '.join(grads + results + own)}):\n{body}"
    exec(compile(source, f"<gradients of {operator.name}>", "exec"), globals)
    backward: Callable[..., Sequence[Any]] = globals["backward"]
    return backward
