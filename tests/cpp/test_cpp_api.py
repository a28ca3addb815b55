"""The C++ API of include/kvision: a function for every operator, with its arguments, and right gradients."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import kvision  # noqa: F401  declares the operators
from kvision import _ops
from kvision.color.program import STEPS

ROOT = Path(__file__).parents[2]
HEADERS = {path: path.read_text() for path in sorted((ROOT / "include/kvision").glob("*.h"))}
TYPES = {
    "Tensor const&": "Tensor",
    "std::optional<Tensor> const&": "Optional[Tensor]",
    "std::string const&": "str",
    "int64_t": "int",
    "double": "float",
    "bool": "bool",
    "std::vector<int64_t> const&": "List[int]",
    "std::vector<double> const&": "List[float]",
}

built = pytest.mark.skipif("cpu" in _ops.unserved, reason="the operators are declared by libkvision.so")


def functions() -> dict[str, list[tuple[str, str]]]:
    """Function name to (type, name) of its arguments, for all that headers define."""
    found = {}
    for text in HEADERS.values():
        for name, arguments in re.findall(r"^inline [^()]*?(\w+)\(([^()]*)\) \{", text, re.MULTILINE):
            plain = re.sub(r"\s*= (\{[^}]*\}|[^,]*)", "", arguments)  # without defaults
            pairs = [re.fullmatch(r"(.*?)\s*(\w+)", a.strip(), re.DOTALL) for a in plain.split(",")]
            found[name] = [(TYPES.get(p[1], p[1]), p[2]) for p in pairs]
    return found


PROGRAM = re.search(
    r"^struct ColorProgram \{(.*?)^\};", HEADERS[ROOT / "include/kvision/color.h"], re.DOTALL | re.MULTILINE
)[1]


@built
@pytest.mark.parametrize("name", sorted(_ops.operators))
def test_operator_has_its_function(name: str) -> None:
    schema = [(str(a.type), a.name) for a in getattr(torch.ops.kvision, name).default._schema.arguments]
    found = functions().get(name)
    if name.startswith("color_program"):  # a struct stands for the arguments that say what is to be computed
        fields = re.findall(r"^  (std::\S+) (\w+)(?:\(\) const \{|(?: = .*)?;)", PROGRAM, re.MULTILINE)
        struct = {(TYPES.get(f"{kind} const&"), field) for kind, field in fields}
        found = [a for a in schema if a in struct or a in found]
    assert found == schema


def test_steps_of_colour_programs() -> None:
    steps = re.search(r"enum Step : int64_t \{(.*?)\}", PROGRAM, re.DOTALL)[1]
    assert re.findall(r"\w+", steps) == list(STEPS)


@pytest.mark.slow
@built
def test_gradients(cmake: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "kvision.info", "--cmake-prefix-path"]
    prefixes = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    subprocess.run([cmake, "-S", ROOT / "tests/cpp", "-B", tmp_path, f"-DCMAKE_PREFIX_PATH={prefixes}"], check=True)
    subprocess.run([cmake, "--build", tmp_path], check=True)
    result = subprocess.run([tmp_path / "gradients"], capture_output=True, text=True)
    assert result.returncode == 0 and " 0 failures" in result.stdout, result.stdout + result.stderr
