"""The C++ API of include/kvision: operators as torch declares them, right gradients, options and errors."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import kvision  # noqa: F401  declares the operators
from kvision import _backend, _ops
from kvision.color.program import STEPS

ROOT = Path(__file__).parents[2]
OPERATORS = "".join(path.read_text() for path in sorted((ROOT / "include/kvision/ops").glob("*.h")))
TYPES = {
    "Tensor": "Tensor",
    "OptionalTensor": "Optional[Tensor]",
    "int64_t": "int",
    "double": "float",
    "bool": "bool",
    "Ints": "List[int]",
    "Floats": "List[float]",
}
RESULTS = {"Tensor": 1, "Two": 2, "Three": 3, "Four": 4, "Five": 5}
# Rules that call <name>_backward.
BY_NAME = ("linear", "side_by_side", "detail::correlation", "detail::separable", "detail::resized")
DECLARATION = re.compile(r'Operator<\s*"(\w+)",\s*(\w+)\(([^)]*)\)>\s*(\w+)(?:\{\s*([\w:]+))?')
DECLARED = {m[1]: m.groups()[1:] for m in DECLARATION.finditer(OPERATORS)}

built = pytest.mark.skipif("cpu" in _backend.unserved, reason="the operators are declared by libkvision.so")


@built
@pytest.mark.parametrize("name", sorted(DECLARED))
def test_declarations_are_the_schemas(name: str) -> None:
    result, arguments, identifier, _ = DECLARED[name]
    schema = getattr(torch.ops.kvision, name).default._schema
    pairs = [argument.split() for argument in arguments.split(",")]
    assert identifier == name
    assert [(TYPES[kind], argument) for kind, argument in pairs] == [(str(a.type), a.name) for a in schema.arguments]
    assert RESULTS[result] == len(schema.returns)


@built
@pytest.mark.parametrize("name", sorted(_ops.operators))
def test_operator_is_declared_or_gives_a_gradient(name: str) -> None:
    forward = re.sub(r"(_kernel)?_backward$", "", name)
    assert f'"{name}"' in OPERATORS or DECLARED[forward][3] in BY_NAME


def test_steps_of_color_programs() -> None:
    steps = re.search(r"enum Step : int64_t \{(.*?)\}", (ROOT / "include/kvision/color.h").read_text(), re.DOTALL)
    assert steps and re.findall(r"\w+", steps[1]) == list(STEPS)


@pytest.fixture(scope="module")
def programs(cmake: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of tests/cpp, built as a user builds against kvision."""
    folder = tmp_path_factory.mktemp("cpp")
    command = [sys.executable, "-m", "kvision.info", "--cmake-prefix-path"]
    prefixes = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    subprocess.run([cmake, "-S", ROOT / "tests/cpp", "-B", folder, f"-DCMAKE_PREFIX_PATH={prefixes}"], check=True)
    subprocess.run([cmake, "--build", folder, "--parallel", "2"], check=True)
    return folder


@pytest.mark.slow
@built
@pytest.mark.parametrize("name", ["gradients", "api"])
def test_program(programs: Path, name: str) -> None:
    result = subprocess.run([programs / name], capture_output=True, text=True)
    assert result.returncode == 0 and " 0 failures" in result.stdout, result.stdout + result.stderr
