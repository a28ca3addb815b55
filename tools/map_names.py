"""Map every operator to its kernel, reference, test and page by equal folders and stems. Fails if one is missing.

    python tools/map_names.py          # what is missing
    python tools/map_names.py sobel    # where everything about an operator or a public function is

An operator is registered by one Python file (register("name"), python/kvision/F/S.py) and declared by one C++ file
(KV_OPERATOR(name), csrc/F/T_op.cpp, or csrc/F/T/T*_op.cpp where T has many files). Folder F is the same;
tests/F/test_S.py tests it, and docs/reference has a page of F.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REFERENCES, KERNELS, TESTS, PAGES = (ROOT / f for f in ("python/kvision", "csrc", "tests", "docs/reference"))
REGISTERED = re.compile(
    r'\b(?:_?register(?:_added|_eraser|_filter|_fit|_formula|_list(?:_backward)?|_warp)?|FastPath|ListOperator)\(\s*"(\w+)"'
)
DECLARED = re.compile(r"^KV_OPERATOR\(\s*(\w+)\s*,", re.MULTILINE)
TABULATED = re.compile(r"^  _\((\w+), [\w:<>]+,", re.MULTILINE)  # a row of a table of formulas in a header
SOURCES = (".cpp", ".cu", ".cuh", ".h", ".md", ".py")
MAX_FILES = 40  # of a folder

# Operators and functions exempt from these rules -> the reason.
EXCEPTIONS = {
    **dict.fromkeys(
        (
            *("homography_dlt", "homography_dlt_backward", "homography_lines_dlt", "homography_lines_dlt_backward"),
            *("pose_dlt", "pose_dlt_backward", "normalize_points", "normalize_points_backward"),
        ),
        "all direct linear transformations share one kernel of geometry/solvers",
    ),
    **dict.fromkeys(
        ("ms_ssim", "ms_ssim_backward", "ms_ssim_backward_both"),
        "shares the windows of metrics/ssim, as does ssim_loss",
    ),
    **dict.fromkeys(
        (
            *("losses/focal", "losses/hausdorff", "losses/lovasz", "losses/ms_ssim", "losses/mutual_information"),
            *("losses/overlap", "losses/smoothness", "metrics/endpoint_error"),
        ),
        "test_losses.py, test_segmentation.py and test_metrics.py compare the module's functions in one table",
    ),
    "contrib/connected_components": "test_contrib.py",
    "enhance/add_weighted": "test_all.py, the table of pointwise functions",
    "enhance/clahe": "test_equalize.py: both equalize",
    "geometry/_correspondence_errors": "the kernel of two folders: homography/test_errors.py and epipolar/test_distances.py",
    "feature/_laf_units": "test_laf.py: all formulas of frames",
    "geometry/solvers/_two_view_fits": "test_ransac.py, which alone calls it",
    "geometry/solvers/_minimal": "test_ransac.py, which alone calls it",
    **dict.fromkeys(("resize_list", "resize_list_backward"), "defined beside resize, which they are for lists"),
    "copy_rows": "the engine joins batches by it, the kernel lies with those of lists",
    "augmentation/sample_rows": "container/test_choices.py: the choices that it serves",
    "geometry/transform/sampling": "test_warp.py: the kernels of warps and remap",
}


def registered() -> dict[str, Path]:
    """Operator -> the Python file, relative to the package, that registers it. f-strings count by their start."""
    return {
        name: path.relative_to(REFERENCES).with_suffix("")
        for path in sorted(REFERENCES.rglob("*.py"))
        if path.name != "_ops.py"
        for name in REGISTERED.findall(path.read_text())
    }


def declared() -> dict[str, Path]:
    """Operator -> the stem, relative to csrc, of the C++ files that have its kernel. Formulas are rows of tables."""
    kernels = {
        name: path.relative_to(KERNELS).with_suffix("")
        for path in sorted(KERNELS.rglob("*.h"))
        if "formula" in path.name
        for name in TABULATED.findall(path.read_text())
    }
    return kernels | {
        name: path.relative_to(KERNELS).with_name(path.name.removesuffix("_op.cpp"))
        for path in sorted(KERNELS.rglob("*_op.cpp"))
        for name in DECLARED.findall(path.read_text())
    }


def owner(name: str, references: dict[str, Path]) -> Path | None:
    """The file that registers an operator, by its name or by the name without a suffix that a helper adds."""
    for suffix in ("", "_backward", "_matrix_backward", "_kernel_backward", "_by_formula"):
        if file := references.get(name.removesuffix(suffix)):
            return file
    return None


def page(reference: Path) -> Path | None:
    """The page of the file, of its folder, or of a parent folder."""
    for folder in (reference, *reference.parents[:-1]):
        for file in (PAGES / f"{folder}.md", PAGES / folder / "README.md", PAGES / folder / "index.md"):
            if file.exists():
                return file
    return None


def test(reference: Path) -> Path:
    return TESTS / reference.parent / f"test_{reference.name.lstrip('_')}.py"


def problems() -> list[str]:
    messages, references, kernels = [], registered(), declared()
    for name, kernel in kernels.items():
        reference = owner(name, references)
        folders = [kernel.parent, *([kernel.parent.parent] if kernel.name.startswith(kernel.parent.name) else [])]
        if reference is None:
            messages.append(f"{name}: declared by csrc/{kernel}_op.cpp, registered by no Python file")
        elif reference.parent not in folders and "formula" not in kernel.name:  # one table serves several folders
            messages.append(f"{name}: kernel in csrc/{kernel.parent}, reference in python/kvision/{reference.parent}")
    for name in sorted(set(references) - set(kernels)):
        if not name.startswith("_"):
            messages.append(f"{name}: registered by python/kvision/{references[name]}.py, declared by no C++ file")
    for reference in sorted(set(references.values())):
        if not test(reference).exists():
            messages.append(f"{reference}: no test {test(reference).relative_to(ROOT)}")
        if page(reference) is None:
            messages.append(f"{reference}: no page below docs/reference")
    for tree in (KERNELS, REFERENCES, TESTS, PAGES, ROOT / "include"):
        files = Counter(p.parent for p in tree.rglob("*") if p.suffix in SOURCES)
        messages += [
            f"{f.relative_to(ROOT)}: {n} files, at most {MAX_FILES}" for f, n in files.items() if n > MAX_FILES
        ]
    return messages


def show(word: str) -> None:
    for name, kernel in declared().items():
        if word in name:
            reference = owner(name, registered())
            rest = [f"python/kvision/{reference}.py", test(reference), page(reference)] if reference else []
            print(name, f"csrc/{kernel}*", *(str(p).removeprefix(f"{ROOT}/") for p in rest), sep="\n  ")


def main() -> int:
    if len(sys.argv) > 1:
        show(sys.argv[1])
        return 0
    messages = problems()
    new = [p for p in messages if p.split(": ")[0] not in EXCEPTIONS]
    stale = set(EXCEPTIONS) - {p.split(": ")[0] for p in messages}
    print(*new, *(f"{name}: an exception that is none any more" for name in sorted(stale)), sep="\n")
    print(f"{len(declared())} operators mapped, {len(EXCEPTIONS)} exceptions, {len(new) + len(stale)} problems")
    return 1 if new or stale else 0


if __name__ == "__main__":
    sys.exit(main())
