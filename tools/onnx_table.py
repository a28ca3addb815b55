"""docs/onnx.md: which public functions torch.onnx.export takes, and whether onnxruntime then computes Python's numbers.

    python tools/onnx_table.py                     all functions: most of an hour on two cores; then the page
    python tools/onnx_table.py sobel --show        these, with the whole message where one fails; the page stays as it is

Each function of benchmarks/sample_calls is exported with fixed sizes (dynamo=True, opset 20), and run. What was tried is kept in
build/onnx_table.json, so that a second start goes on; --again tries everything anew. Each export has a process of its own: one that
fails may leave torch in a state in which the next one fails, too.
"""

from __future__ import annotations

import argparse
import importlib
import json
import logging
import multiprocessing
import multiprocessing.connection
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT)]
import kvision as K  # noqa: E402
from benchmarks.sample_calls import WITHOUT_SAMPLE, SampleCall, Size, sample_calls  # noqa: E402

OPSET = 20
SIZES = (Size(2, 3, 32, 40), Size(2, 4, 32, 40))
KEPT = ROOT / "build/onnx_table.json"
PAGE = ROOT / "docs/onnx.md"
RELATIVE, ABSOLUTE = 1e-3, 1e-4
SECONDS = 300
NO_TENSORS = "gives no tensors"

# What the messages of torch and onnxruntime mean, as a user would say it.
REASONS = {
    r"Invalid model": "onnxruntime refuses the program as invalid",
    r"No ONNX function found for <OpOverload\(op='(?:aten|prims)\.(\w+)'": "ONNX has no operator for torch's `{0}`",
    r"No decompositions registered for.*'(?:aten|prims)\.(\w+)'": "ONNX has no operator for torch's `{0}`",
    r"data.dependent|DataDependent|unbacked|nonzero\(\)|Could not extract": "sizes or branches depend on the values",
    r"No ONNX function found for <OpOverload\(op='kvision\.(\w+)'": "the operator `{0}` is in the program, not its reference",
    r"tolist\(\)|Cannot access storage|Cannot access data pointer|data pointer of Tensor|unhashable type: non-nested SymInt": (
        "values are read on the host"
    ),
}


@dataclass
class Row:
    name: str
    result: str  # agrees, differs, not run, not exported
    message: str = ""

    @property
    def reason(self) -> str:
        for pattern, reason in REASONS.items():
            if match := re.search(pattern, self.message, re.IGNORECASE):
                return reason.format(*match.groups())
        return self.message.strip().splitlines()[0][:160] if self.message.strip() else ""


class Module(nn.Module):
    """The call, with its tensors in the order of their names."""

    def __init__(self, call: SampleCall, names: list[str]) -> None:
        super().__init__()
        self.call, self.names = call, names

    def forward(self, *tensors: Tensor) -> list[Tensor]:
        return flat(self.call.call(K, dict(zip(self.names, tensors))))


def flat(value: Any) -> list[Tensor]:
    if isinstance(value, Tensor):
        return [value]
    if isinstance(value, dict):
        value = list(value.values())
    return [tensor for part in value for tensor in flat(part)] if isinstance(value, (list, tuple)) else []


def example(call: SampleCall) -> tuple[dict[str, Tensor], list[Tensor]]:
    """Tensors that the function takes, and its results."""
    for size in SIZES:
        tensors = call.tensors(size)
        try:
            return tensors, flat(call.call(K, tensors))
        except ValueError:
            continue
    raise AssertionError(f"{call.name} takes none of {SIZES}")


def attempt(call: SampleCall) -> Row:
    import onnxruntime

    tensors, expected = example(call)
    if not expected:
        return Row(call.name, "not exported", NO_TENSORS)
    module, values = Module(call, list(tensors)), tuple(tensors.values())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "program.onnx")
        try:
            program = torch.onnx.export(module, values, dynamo=True, opset_version=OPSET, verbose=False)
            assert program is not None
            program.save(path)
        except Exception as error:
            return Row(call.name, "not exported", root(error))
        try:
            session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
            # What the function only takes the type or the size of is no input of the program.
            named = {f"tensors_{i}": value for i, value in enumerate(values)} if len(values) > 1 else {}
            inputs = session.get_inputs()
            feed = {x.name: (named[x.name] if x.name in named else values[0]).numpy() for x in inputs}
            results = [torch.from_numpy(result) for result in session.run(None, feed)]
        except Exception as error:
            return Row(call.name, "not run", root(error))
    if len(results) != len(expected):
        return Row(call.name, "differs", f"{len(results)} results, {len(expected)} in Python")
    for result, reference in zip(results, expected):
        try:
            torch.testing.assert_close(
                result, reference.detach(), rtol=RELATIVE, atol=ABSOLUTE, equal_nan=True, check_dtype=False
            )
        except AssertionError as error:
            return Row(call.name, "differs", " ".join(str(error).split()))
    return Row(call.name, "agrees")


def attempts(calls: list[SampleCall], jobs: int) -> Iterator[Row]:
    """Each in a child of this process, which has imported what all of them need; `jobs` at a time, as they end."""
    context = multiprocessing.get_context("fork")
    waiting, running = list(reversed(calls)), {}
    while waiting or running:
        while waiting and len(running) < jobs:
            call = waiting.pop()
            receive, send = context.Pipe(duplex=False)
            child = context.Process(target=lambda call=call, send=send: send.send(attempt(call)))
            child.start()
            send.close()
            running[receive] = call, child, time.monotonic()
        multiprocessing.connection.wait(list(running), timeout=1)
        for receive, (call, child, begin) in list(running.items()):
            if receive.poll():
                try:
                    yield receive.recv()
                except EOFError:
                    yield Row(call.name, "not exported", "the export ends the process")
            elif time.monotonic() - begin > SECONDS:
                yield Row(call.name, "not exported", f"takes more than {SECONDS} s")
            else:
                continue
            del running[receive]
            child.kill()
            child.join()


def root(error: BaseException) -> str:
    """The message of the error at the bottom, which says what was met."""
    while error.__cause__ is not None:
        error = error.__cause__
    return f"{type(error).__name__}: {error}"[:4000]


def page(rows: list[Row]) -> str:
    import onnxruntime

    rows = [row for row in rows if row.message != NO_TENSORS]
    agree = [row for row in rows if row.result == "agrees"]
    versions = f"torch {torch.__version__.split('+')[0]}, onnxruntime {onnxruntime.__version__}, opset {OPSET}"
    lines = [
        "# Functions in ONNX",
        "",
        f"`torch.onnx.export(dynamo=True)` takes {len(agree)} of {len(rows)} public functions, and onnxruntime then computes",
        f"Python's numbers (within {RELATIVE:g} relative and {ABSOLUTE:g} absolute, at fixed sizes, {versions}).",
        "[deployment.md](deployment.md#onnx) says how to export, what was also compared with free sizes, and what OpenVINO takes.",
        "`python tools/onnx_table.py` makes this page. Not in it are functions without tensors, with files or with random",
        "results, augmentations, and features.",
        "",
        "## Those that do not",
        "",
        "| function | what happens | why |",
        "|---|---|---|",
    ]
    lines += [
        f"| `{row.name}` | {row.result} | {row.reason.replace('|', ' ')} |" for row in rows if row.result != "agrees"
    ]
    lines += ["", "## Those that do", ""]
    for module in sorted({row.name.split(".")[0] for row in agree}):
        names = ", ".join(f"`{row.name.split('.')[1]}`" for row in agree if row.name.startswith(f"{module}."))
        lines += [f"**{module}:** {names}", ""]
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="parts of names; default: all, and the page is written")
    parser.add_argument("--show", action="store_true", help="print whole messages")
    parser.add_argument("--jobs", type=int, default=2, help="exports at the same time (default 2)")
    parser.add_argument("--again", action="store_true", help="forget what was tried before")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    torch.set_num_threads(1)
    for library in ("onnxruntime", "onnxscript", "torch._dynamo", "torch.onnx._internal.exporter._core"):
        importlib.import_module(library)  # once, not in each process
    kept: dict[str, dict[str, str]] = {}
    if KEPT.exists() and not options.again:
        kept = json.loads(KEPT.read_text())
    calls = [call for call in sample_calls() if call.axes]
    chosen = [call for call in calls if any(part in call.name for part in options.names)]
    if not options.names:
        chosen = [call for call in calls if call.name not in kept]
    for row in attempts(chosen, options.jobs):
        kept[row.name] = asdict(row)
        KEPT.parent.mkdir(exist_ok=True)
        KEPT.write_text(json.dumps(kept, indent=1))
        print(f"{row.name:50} {row.result:14} {row.message if options.show else row.reason}", flush=True)
    assert not {call.name for call in calls} & set(WITHOUT_SAMPLE)
    if not options.names:
        PAGE.write_text(page([Row(**kept[call.name]) for call in calls]))


if __name__ == "__main__":
    main()
