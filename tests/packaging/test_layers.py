"""Which package may import which: the rules of docs/layers.md, in Python and in C++."""

from __future__ import annotations

import ast
import functools
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
RULE = re.compile(r"^\| `(\w+)` \| (.*?) \| (.*?) \|", re.MULTILINE)
TABLE = {
    name: [re.findall(r"`(\w+)`", cell) for cell in cells]
    for name, *cells in RULE.findall((ROOT / "docs/layers.md").read_text())
}


@functools.cache
def imported(path: Path) -> frozenset[str]:
    """The modules of kvision that a file imports, at its top or in its functions, without those for types alone."""
    tree = ast.parse(path.read_text())
    unread = {
        node
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
        for node in ast.walk(block)
    }
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node not in unread:
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return frozenset(name for name in names if name.startswith("kvision."))


def modules() -> dict[str, Path]:
    package = ROOT / "python"
    return {
        ".".join(p.relative_to(package).with_suffix("").parts): p for p in sorted((package / "kvision").rglob("*.py"))
    }


def test_python_packages_import_what_they_may() -> None:
    for name, path in modules().items():
        package = name.split(".")[1]
        if package not in TABLE:
            continue
        used = {i.split(".")[1] for i in imported(path)} & TABLE.keys()
        assert used <= {package, *TABLE[package][0]}, f"{name} imports {used - {package, *TABLE[package][0]}}"


def test_cpp_modules_include_what_they_may() -> None:
    for path in sorted((ROOT / "csrc").rglob("*.*")):
        module = path.relative_to(ROOT / "csrc").parts[0]
        if module == "tests" or path.suffix not in (".h", ".cuh", ".cpp", ".cu"):
            continue
        used = {m for m in re.findall(r'#include "(\w+)/', path.read_text()) if (ROOT / "csrc" / m).is_dir()}
        allowed = {module, "core", "glue", *TABLE.get(module, ["", []])[1]}
        assert used <= allowed, f"{path} includes {used - allowed}"


def test_vectors_in_memory_are_read_by_lanes_h() -> None:
    """A pointer to a vector promises its alignment, which numbers in memory do not have: `read_lanes` and `write_lanes` do not."""
    for path in sorted((ROOT / "csrc").rglob("*_cpu.*")):
        assert not re.search(r"_cast<\s*Lanes<[^;()]*\*>", path.read_text()), path


def test_the_engine_of_augmentations_is_known_by_its_public_face_alone() -> None:
    engine, package = "kvision.augmentation.engine", modules()
    files = {name: path for name, path in package.items() if name.startswith(f"{engine}.")}
    for name, path in package.items():
        used = imported(path)
        if name not in files:
            assert not used & files.keys(), f"{name} imports {used & files.keys()}"
            continue
        # What the engine imports of augmentation is not one of those that it executes: these import it.
        for below in {i for i in used if i.startswith("kvision.augmentation.")} & package.keys() - files.keys():
            own = imported(package[below])
            assert not any(i.startswith(engine) for i in own), f"{name} imports {below}, which imports the engine"


def test_no_module_imports_itself_by_way_of_others() -> None:
    files = {name: path for name, path in modules().items() if path.name != "__init__.py"}
    try:
        TopologicalSorter({name: imported(path) & files.keys() for name, path in files.items()}).prepare()
    except CycleError as error:
        raise AssertionError(f"a circle: {' <- '.join(error.args[1])}") from None
