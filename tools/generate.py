"""Write the files that are generated: include/kvision/ops, and the numbers that Python and C++ share (shared_numbers.py).

    python tools/generate.py            # after `ninja -C build/cmake`, since the schemas are those of the built library

A declaration's schema is that of KV_OPERATOR (csrc), its comment the one above that, its rule made of the words of
`register(..., gradients=...)` (python/kvision/_gradients.py). A gradient that is no single call is a rule of the operator's
name in include/kvision/ops/rules. tests/packaging/test_generated.py compares.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import shared_numbers

from kvision import _gradients, _ops
from kvision._torch_compat import find_operator, schema_of
from kvision.geometry._formula import FORMULAS

ROOT = Path(__file__).parents[1]
SUBJECTS = {
    "augmentation": "Random parameters, the matrices that they give, passes over images, noise and erased rectangles",
    "color": "Color programs, mosaics and chroma",
    "contrib": "Regions, distances and patches",
    "enhance": "Statistics of whole images, blends and codecs",
    "feature": "Local features",
    "filters": "The filters",
    "geometry": "Warps, depth, peaks, several views and matrices of transforms",
    "losses": "Losses",
    "metrics": "Metrics and what losses share with them",
    "morphology": "Morphology",
}
TYPES = {
    "Tensor": "Tensor",
    "Optional[Tensor]": "OptionalTensor",
    "int": "int64_t",
    "float": "double",
    "bool": "bool",
    "List[int]": "Ints",
    "List[float]": "Floats",
}
RESULTS = ("", "Tensor", "Two", "Three", "Four", "Five")


def declared() -> dict[str, list[tuple[str, list[tuple[str, str]]]]]:
    """By module: the files of csrc, or "formulas", with names of operators and the comments above their schemas."""
    operators = _ops.all_operators()
    modules: dict[str, list[tuple[str, list[tuple[str, str]]]]] = {module: [] for module in SUBJECTS}
    formulas: dict[str, list[tuple[str, str]]] = {"feature": [], "geometry": []}
    for path in sorted((ROOT / "csrc").rglob("*_op.cpp")):
        found = re.findall(r"((?:^//.*\n)*)^KV_OPERATOR\(\s*(\w+)", path.read_text(), re.MULTILINE)
        forward = [(name, comment) for comment, name in found if "_backward" not in name and not takes_list(name)]
        if forward:
            file = path.relative_to(ROOT / "csrc")
            modules[file.parts[0]].append((str(file), forward))
    for name in sorted(FORMULAS):
        module = operators[name].definition.__module__.split(".")[1:2]
        formulas["feature" if module == ["feature"] else "geometry"].append((name, ""))
    for module, names in formulas.items():
        modules[module].append(("formulas", names))
    return modules


def written_rules(module: str) -> set[str]:
    path = ROOT / f"include/kvision/ops/rules/{module}.h"
    return set(re.findall(r"^inline constexpr Rule (\w+)", path.read_text(), re.MULTILINE)) if path.exists() else set()


def schema(name: str) -> Any:
    return schema_of(find_operator("kvision", name).default)


def takes_list(name: str) -> bool:
    """Whether an operator takes a list of images, which C++ has not yet."""
    return any(str(a.type) == "List[Tensor]" for a in schema(name).arguments)


class Rules:
    """The rules of a module's operators, as C++; those of the operators that they call follow."""

    def __init__(self, module: str) -> None:
        self.written = written_rules(module)
        self.operators = _ops.all_operators()
        self.functions: dict[str, str] = {}

    def rule(self, name: str, called: bool = False) -> str:
        """An expression of the rule of operator `name`."""
        operator = self.operators.get(name)
        if name in self.written:
            return f"detail::rules::{name}"
        if name in FORMULAS:
            return "side_by_side"
        if operator is None or not operator.words:
            constant = operator is not None and len(operator.non_differentiable) == len(schema(name).returns)
            return "non_differentiable" if constant else "no_gradient"
        entries = self.entries(name)
        if not entries:
            return "no_gradient"
        values = [value for entry in entries for value in entry.values]
        saved, saves_input = self.saved_results(name), any(v == ("argument", 0) for v in values)
        if name not in self.functions:
            self.functions[name] = ""  # it may call itself
            self.functions[name] = self.function(name, entries)
        options = f", {saved}, false" if not saves_input else f", {saved}" if saved else ""
        return f"Rule{{detail::{name}_gradients{options}}}"

    def entries(self, name: str) -> list[_gradients.Entry]:
        entries = self.operators[name].entries
        return [e for e in entries if e.call not in (_gradients.BY_REFERENCE, _gradients.BY_HAND)]

    def saved_results(self, name: str) -> int:
        """How many of the last results the gradients read."""
        first = [v.of for entry in self.entries(name) for v in entry.values if v.kind in ("result", "detach")]
        return len(schema(name).returns) - min(first) if first else 0

    def function(self, name: str, entries: list[_gradients.Entry]) -> str:
        first_result = len(schema(name).returns) - self.saved_results(name)

        def expression(value: _gradients.Value) -> str:
            kind, of = value
            if kind == "constant":
                return {True: "true", False: "false", None: "c10::IValue()"}[of]
            if kind == "needs":
                return " || ".join(f"b.needs({i})" for i in of)
            if kind == "sizes":
                assert of == 0
                return "b.image_size()"
            if kind in ("result", "detach"):
                return f"b.results[{of - first_result}]" + (".detach()" if kind == "detach" else "")
            return {"grad": f"b.grads[{of}]", "argument": f"b.arguments[{of}]", "minus": f"minus(b.arguments[{of}])"}[
                kind
            ]

        def call(entry: _gradients.Entry) -> str:
            arguments = ", ".join(map(expression, entry.values))
            return f'b.run("{entry.call}", {{{arguments}}}, {self.rule(entry.call).replace("detail::", "")})'

        targets = [i for entry in entries for i in entry.targets]
        body = ""
        if len(entries) == 1 and targets == list(range(len(targets))):
            body = f"return {call(entries[0])};"
        else:
            body = f"variable_list gradients({1 + max(targets)});"
            for entry in entries:
                wanted = " || ".join(f"b.needs({i})" for i in entry.targets)
                if len(entry.targets) == 1:
                    body += f"if ({wanted}) gradients[{entry.targets[0]}] = {call(entry)}[0];"
                else:
                    each = "".join(f"gradients[{i}] = computed[{n}];" for n, i in enumerate(entry.targets))
                    body += f"if ({wanted}) {{ variable_list const computed = {call(entry)}; {each} }}"
            body += "return gradients;"
        return f"inline variable_list {name}_gradients(Backward const& b) {{ {body} }}"


def operators_header(module: str, files: list[tuple[str, list[tuple[str, str]]]]) -> str:
    rules = Rules(module)
    declarations = []
    for file, names in files:
        declarations.append(f"\n// --- {file}\n\n" if names else "")
        for name, comment in names:
            of = schema(name)
            arguments = ", ".join(f"{TYPES[str(a.type)]} {a.name}" for a in of.arguments)
            kind = f'Operator<"{name}", {RESULTS[len(of.returns)]}({arguments})>'
            declarations.append(f"{comment}inline constexpr {kind} {name}{{{rules.rule(name)}}};\n")
    include = f'#include "kvision/ops/rules/{module}.h"\n' if rules.written else ""
    functions = rules.functions
    before = "".join(f"inline variable_list {name}_gradients(Backward const& b);\n" for name in functions)
    before = f"namespace detail {{\n\n{before}\n}}  // namespace detail\n\n" if functions else ""
    after = "\n\n".join(functions.values())
    after = f"\n// --- rules\n\nnamespace detail {{\n\n{after}\n\n}}  // namespace detail\n\n" if functions else "\n"
    return (
        f"// {SUBJECTS[module]}. Arguments are those of torch.ops.kvision. Written by tools/generate.py.\n#pragma once\n\n"
        f'#include "kvision/ops/operator.h"\n{include}\nnamespace kvision::ops {{\n\n'
        f"{before}{''.join(declarations)}{after}}}  // namespace kvision::ops\n"
    )


def generated() -> Iterator[tuple[Path, str]]:
    """All files that are generated: their paths, and their texts before they are formatted."""
    yield from shared_numbers.python_files()
    yield shared_numbers.cpp_file()
    for module, files in declared().items():
        yield ROOT / f"include/kvision/ops/{module}.h", operators_header(module, files)


def main() -> None:
    paths = []
    for path, text in generated():
        path.write_text(text)
        paths.append(path)
    programs = Path(sys.executable).parent
    for formatter, suffix in (([programs / "clang-format", "-i"], ".h"), ([programs / "ruff", "format", "-q"], ".py")):
        subprocess.run([*formatter, *(path for path in paths if path.suffix == suffix)], check=True)


if __name__ == "__main__":
    main()
