"""`python -m kvision.migrate FILES...`: what changes for Python files that use Kornia when they import kvision instead.

For every name of Kornia that a file imports or uses, it says: same; different, with the rows of docs/differences.md that
name it; or not in kvision yet. Folders are searched for .py files. Files are read, never run or changed.
"""

from __future__ import annotations

import argparse
import ast
import functools
import importlib
import inspect
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

SAME, DIFFERENT, MISSING = "same", "different", "not in kvision yet"

STAR = "\\* "  # in front of the rows of docs/differences.md that `kvision.patch_kornia` reads

# Sections of docs/differences.md and the modules that they describe.
_SECTIONS = {
    "Augmentation": ("augmentation",),
    "Filters": ("filters",),
    "Geometry": ("geometry",),
    "Color": ("color",),
    "Enhance": ("enhance",),
    "Feature": ("feature",),
    "Losses and metrics": ("losses", "metrics"),
    "Morphology and contrib": ("morphology", "contrib"),
}


@dataclass(frozen=True)
class Difference:
    """A row of docs/differences.md: the modules and names it concerns (`f`, `Class.member`), and what both libraries do.

    `values` is true for the rows with a star: calls that both libraries serve give other values, beyond rounding.
    """

    line: int
    modules: tuple[str, ...]
    names: frozenset[str]
    where: str
    kornia: str
    kvision: str
    values: bool = False


@dataclass(frozen=True)
class Use:
    """A name of Kornia in a file: its path below `kornia`, and the keywords it is called with there."""

    line: int
    path: tuple[str, ...]
    keywords: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return ".".join(("kornia", *self.path))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m kvision.migrate", description=__doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    counts: Counter[str] = Counter()
    rows = differences()
    failed = False
    for path in python_files(parser.parse_args(arguments).files):
        try:
            uses = kornia_uses(path.read_text())
        except (OSError, SyntaxError, UnicodeDecodeError) as error:
            print(f"kvision.migrate: {path}: {error}", file=sys.stderr)
            failed = True
            continue
        if uses:
            counts.update(report(path, uses, rows))
    print(", ".join(f"{counts[status]} {status}" for status in (SAME, DIFFERENT, MISSING)))
    return 2 if failed else int(counts[MISSING] > 0)


def python_files(paths: Sequence[Path]) -> Iterator[Path]:
    for path in paths:
        yield from sorted(path.rglob("*.py")) if path.is_dir() else [path]


def report(path: Path, uses: Sequence[Use], rows: Sequence[Difference]) -> Iterator[str]:
    """Print what changes in one file, and yield the status of each name."""
    print(path)
    by_name: dict[str, list[Use]] = defaultdict(list)
    for use in uses:
        by_name[use.name].append(use)
    for name, same_name in sorted(by_name.items()):
        value, length = resolve(same_name[0].path)
        if isinstance(value, ModuleType) and length == len(same_name[0].path):
            continue  # the names that are used from this module are listed
        status, notes = judge(same_name, rows)
        lines = ", ".join(str(line) for line in sorted({use.line for use in same_name}))
        print(f"    {name}: {status} (line {lines})")
        for note in notes:
            print(f"        {note}")
        yield status
    modules = {use.path[0] for use in uses if use.path}
    general = [row for row in rows if not row.names and modules & set(row.modules)]
    for row in general:
        if row.values:
            print(f"    docs/differences.md:{row.line}: {row.where}: {row.kornia} -> {row.kvision}")
    general = [row for row in general if not row.values]
    if general:
        print(
            "    rows of docs/differences.md on types, borders and errors of these modules in general: lines", end=" "
        )
        print(", ".join(str(row.line) for row in general))


def judge(uses: Sequence[Use], rows: Sequence[Difference]) -> tuple[str, list[str]]:
    """The status of one name, and a line for each of its differences."""
    path = uses[0].path
    value, length = resolve(path)
    if length < len(path):
        return MISSING, [f"instead: {text}" for names, text in replacements() if names & set(path)]
    notes: list[str] = []
    keywords = {keyword for use in uses for keyword in use.keywords}
    if unknown := sorted(keywords - accepted_keywords(value)):
        notes.append(f"no argument {', '.join(unknown)}")
    for row in rows:
        if concerns(row, path):
            notes.append(f"docs/differences.md:{row.line}: {row.where}: {row.kornia} -> {row.kvision}")
    return (DIFFERENT if notes else SAME), notes


def concerns(row: Difference, path: Sequence[str]) -> bool:
    """Whether a row is about this function or class, about a member of this class, or about the class of this member."""
    if len(path) > 1 and path[0] not in row.modules:
        return False
    own = {path[-1], ".".join(path[-2:]), *path[-2:-1]}
    return any(name in own or name.startswith(path[-1] + ".") for name in row.names)


def resolve(path: Sequence[str]) -> tuple[Any, int]:
    """The object at `path` below kvision, and how many names of the path lead to something."""
    value: Any = importlib.import_module("kvision")
    for i, name in enumerate(path):
        if isinstance(value, ModuleType) and not hasattr(value, name):
            try:
                importlib.import_module(f"{value.__name__}.{name}")
            except ImportError:
                return value, i
        if not hasattr(value, name) or name.startswith("_"):
            return value, i
        value = getattr(value, name)
    return value, len(path)


def resolves(path: Sequence[str]) -> bool:
    return resolve(path)[1] == len(path)


def accepted_keywords(value: Any) -> set[str]:
    """The keywords that a call of `value` accepts; every one that can be asked for, where that is not known."""
    try:
        parameters = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):
        return _AnyName()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return _AnyName()
    return {p.name for p in parameters if p.kind is not p.POSITIONAL_ONLY}


class _AnyName(set[str]):
    """A set that holds every string."""

    def __rsub__(self, other: Any) -> set[str]:
        return set()


def kornia_uses(source: str) -> list[Use]:
    """Every use of a name of Kornia in a Python source, in the order of its lines."""
    visitor = _Visitor()
    visitor.visit(ast.parse(source))
    return sorted(visitor.uses, key=lambda use: (use.line, use.path))


class _Visitor(ast.NodeVisitor):
    """Collects imports of Kornia, and chains of attributes and calls that begin with an imported name."""

    def __init__(self) -> None:
        self.uses: list[Use] = []
        self.imported: dict[str, tuple[str, ...]] = {}  # name in the file -> path below kornia

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            root, *path = alias.name.split(".")
            if root != "kornia":
                continue
            if path:
                self.uses.append(Use(node.lineno, tuple(path)))
            self.imported[alias.asname or root] = tuple(path) if alias.asname else ()

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        root, *path = (node.module or "").split(".")
        if root != "kornia" or node.level:
            return
        for alias in node.names:
            if alias.name == "*":
                self.uses.append(Use(node.lineno, tuple(path)))
            else:
                self.imported[alias.asname or alias.name] = (*path, alias.name)
                self.uses.append(Use(node.lineno, (*path, alias.name)))

    def visit_Call(self, node: ast.Call) -> None:
        path = self.path_of(node.func)
        if path:
            keywords = tuple(keyword.arg for keyword in node.keywords if keyword.arg)
            self.uses.append(Use(node.lineno, path, keywords))
        else:
            self.visit(node.func)
        for child in (*node.args, *node.keywords):
            self.visit(child)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        path = self.path_of(node)
        if path:
            self.uses.append(Use(node.lineno, path))
        else:
            self.visit(node.value)

    def path_of(self, node: ast.expr) -> tuple[str, ...] | None:
        """The path below kornia that `a.b.c` stands for, or None."""
        attributes: list[str] = []
        while isinstance(node, ast.Attribute):
            attributes.append(node.attr)
            node = node.value
        if not isinstance(node, ast.Name) or node.id not in self.imported:
            return None
        return (*self.imported[node.id], *reversed(attributes))


def differences(text: str | None = None) -> list[Difference]:
    """The rows of docs/differences.md that compare with Kornia."""
    rows: list[Difference] = []
    modules: tuple[str, ...] = ()
    from_kornia = False
    for number, line in enumerate((differences_page() if text is None else text).splitlines(), 1):
        if line.startswith("## "):
            modules = _SECTIONS.get(line[3:].strip(), ())
        elif line.startswith("#"):
            from_kornia = "From Kornia" in line
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if from_kornia and line.startswith("|") and len(cells) == 3 and cells[0] != "where" and "---" not in line:
            quoted = re.findall(r"`(\w+(?:\.\w+)?)(?:\([^`]*\))?`", cells[0])
            names = frozenset(name for name in quoted if any(resolves((m, *name.split("."))) for m in modules))
            where, kornia, kvision = cells
            starred = where.startswith(STAR)
            rows.append(Difference(number, modules, names, where.removeprefix(STAR), kornia, kvision, starred))
    return rows


@functools.cache
def replacements() -> list[tuple[frozenset[str], str]]:
    """The rows of docs/differences.md on what kvision does not carry: names of Kornia, and what to use instead."""
    table = differences_page().partition("## Not in kvision")[2]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| ")]
    # The last part of a dotted name: `tracking.HomographyTracker`.
    return [(frozenset(re.findall(r"`(?:\w+\.)*(\w+)`", name)), text) for name, text in rows[1:]]


def differences_page() -> str:
    """docs/differences.md of the package, or of the repository where kvision is installed editable."""
    package = Path(__file__).parent
    for path in (package / "differences.md", package.parents[1] / "docs" / "differences.md"):
        if path.exists():
            return path.read_text()
    raise FileNotFoundError("kvision.migrate: docs/differences.md is missing from this installation")


if __name__ == "__main__":
    sys.exit(main())
