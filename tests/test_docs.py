"""The pages of the documentation: examples that run, links and paths that exist, every public name with its arguments.

python tests/test_docs.py    # renews the descriptions in docs/reference from the first sentences of the docstrings
"""

from __future__ import annotations

import importlib
import inspect
import re
import shutil
import subprocess
import sys
from enum import Enum
from pathlib import Path

import pytest
import torch

import fresh
import kvision as K
from benchmarks.sample_calls import sample_calls, sample_modules
from kvision import _backend
from test_public_api import arguments, public_modules, public_names, surface

pytestmark = pytest.mark.programs

ROOT = Path(__file__).parents[1]
FOLDERS = (
    "",
    "benchmarks",
    "docs",
    "docs/notes",
    "docs/reference",
    "docs/reference/geometry",
    "docs/reference/tv",
    "examples/cpp",
    "third_party",
)
PAGES = [str(path.relative_to(ROOT)) for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.md"))]
FOLDER = ROOT / "docs" / "reference"
REFERENCE = "".join(path.read_text() for path in sorted(FOLDER.rglob("*.md")))


@pytest.fixture
def photo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """photo.jpg in the working folder."""
    data = pytest.importorskip("skimage.data")
    monkeypatch.chdir(tmp_path)
    K.io.write_image("photo.jpg", K.image_to_tensor(data.astronaut()))


def examples(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


def test_readme_example_runs(photo: None) -> None:
    (example,) = examples("README.md")
    names: dict[str, object] = {}
    exec(example, names)
    assert names["image"].grad.abs().sum() > 0
    assert K.io.load_image("edges.png").shape == (3, 512, 512)


GUIDES = [str(path.relative_to(ROOT)) for path in sorted(ROOT.glob("docs/*.md")) if "```python" in path.read_text()]


@pytest.mark.parametrize("page", GUIDES)
def test_guides_run(page: str, photo: None) -> None:
    """Every block of Python, in the order of the page."""
    program = "\n".join(examples(page))
    if "patch_kornia" in program:  # changes Kornia for the whole process
        pytest.importorskip("kornia")
        result = fresh.run(program)
        assert result.returncode == 0, result.stderr
    else:
        exec(program, {"__name__": "guide"})


# Blocks that take a minute or packages of their own are marked py: they run after those of the page that are marked python.
@pytest.mark.slow
@pytest.mark.tracing
@pytest.mark.parametrize("package", ["pipeline.pt2", "pipeline.onnx"])
def test_blocks_that_take_longer_run(package: str, photo: None) -> None:
    page = (ROOT / "docs/deployment.md").read_text()
    (block,) = (block for block in re.findall(r"```py\n(.*?)```", page, re.DOTALL) if package in block)
    if package == "pipeline.onnx":
        for library in ("onnx", "onnxscript", "onnxruntime"):
            pytest.importorskip(library)
    elif shutil.which("c++") is None:
        pytest.skip("AOTInductor needs a C++ compiler")
    names: dict[str, object] = {"__name__": "guide"}
    exec("\n".join([*examples("docs/deployment.md"), block]), names)
    assert Path(package).stat().st_size > 0
    if package == "pipeline.pt2":
        torch.testing.assert_close(names["run"](names["image"]), names["pipeline"](names["image"]))


@pytest.mark.slow
@pytest.mark.skipif("cpu" in _backend.unserved, reason="libkvision.so was not built")
def test_blocks_of_cpp_compile(cmake: str, tmp_path: Path) -> None:
    """The CMake and C++ of the guides, as one program; that of cpp.md runs, the other one needs files of Python."""
    programs, projects = [], []
    for page in ("docs/cpp.md", "docs/deployment.md"):
        text = (ROOT / page).read_text()
        programs += re.findall(r"```cpp\n(.*?)```", text, re.DOTALL)
        projects += re.findall(r"```cmake\n(.*?)```", text, re.DOTALL)
    assert len(programs) == len(projects) == 2
    includes = [line for program in programs for line in program.splitlines() if line.startswith("#include")]
    direct, saved = ("\n".join(x for x in program.splitlines() if not x.startswith("#")) for program in programs)
    functions = f"int main() {{\n{direct}\n}}\nvoid run_saved(torch::Tensor image) {{\n{saved}\n}}\n"
    (tmp_path / "app.cpp").write_text("\n".join([*includes, functions]))
    head = "cmake_minimum_required(VERSION 3.20)\nproject(app LANGUAGES CXX)\nadd_executable(app app.cpp)\n"
    (tmp_path / "CMakeLists.txt").write_text(head + "\n".join(projects))
    command = [sys.executable, "-m", "kvision.info", "--cmake-prefix-path"]
    prefixes = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    subprocess.run([cmake, "-S", tmp_path, "-B", tmp_path, f"-DCMAKE_PREFIX_PATH={prefixes}"], check=True)
    subprocess.run([cmake, "--build", tmp_path], check=True)
    subprocess.run([tmp_path / "app"], check=True)


def test_every_block_says_its_language() -> None:
    """The tests above read these; other blocks, of the shell, are indented."""
    for path in sorted(ROOT.glob("docs/*.md")):
        fences = re.findall(r"^```(.*)$", path.read_text(), re.MULTILINE)
        assert set(fences[0::2]) <= {"python", "py", "cpp", "cmake"} and not any(fences[1::2]), path.name
        assert "py" not in fences or path.name == "deployment.md"


def test_commands_are_no_part_of_a_list() -> None:
    """An indented block right after a list would become a paragraph of its last point on the site."""
    inside = r"^(?:[-*]|\d+\.) .+\n(?: +\S.*\n)*\n {4}(?:python|pip|torchrun|make|cmake|git) .*"
    for page in PAGES:
        assert not re.findall(inside, (ROOT / page).read_text(), re.MULTILINE), page


def test_coverage_of_kornia_is_as_written() -> None:
    """Modules that docs/migrating_from_kornia.md lists as missing are missing; the others exist."""
    rows = re.findall(
        r"^\| `(\w+)` \| (\d+) \| (\d+) \| (.*?) ?\|$",
        (ROOT / "docs/migrating_from_kornia.md").read_text(),
        re.MULTILINE,
    )
    assert len(rows) == 16
    for module, in_kornia, here, missing in rows:
        assert hasattr(K, module) or module == "core" or missing == "all", module
        assert (int(here) == 0) == (missing == "all") and (int(here) == int(in_kornia)) == (missing == ""), module
        assert not hasattr(K, module) or missing != "all", f"{module} has names now: renew the table"


def test_python_is_python() -> None:
    for page in PAGES:
        for example in examples(page):
            compile(example, page, "exec")


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)", (ROOT / page).read_text()):
            if not target.startswith("http"):
                assert (ROOT / page).parent.joinpath(target).exists(), f"{page}: {target}"


def test_the_site_has_every_page() -> None:
    """mkdocs.yml lists the pages of docs; docs/README.md is for readers of the repository."""
    listed = set(re.findall(r"[\w/]+\.md$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    pages = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
    assert pages - {"README.md"} <= listed


def test_paths_exist() -> None:
    """Paths in backticks on a page exist if their first folder is one of this repository."""
    folders = "|".join(path.name for path in ROOT.iterdir() if path.is_dir() and path.name not in ("build", "out"))
    for page in PAGES:
        for path in re.findall(rf"`((?:{folders})/[\w./-]*\w)`", (ROOT / page).read_text()):
            assert (ROOT / path).exists() or list(ROOT.glob(path + "*")), f"{page}: {path}"


def test_every_public_name_is_in_the_reference() -> None:
    """Functions with their arguments as they are."""
    described = set(re.findall(r"`([^`\n]+)`", REFERENCE.replace('"', "'")))
    names = {entry.partition("(")[0] for entry in described}
    missing = []
    for module in public_modules():
        for name in public_names(module):
            value = getattr(module, name)
            if name not in names:
                missing.append(f"{module.__name__}.{name}")
            elif inspect.isfunction(value):
                call = name + re.sub(r"<([\w.]+): [^>]*>", r"\1", arguments(value))  # a default that is an Enum
                missing += [call] if call not in described else []
    assert not missing, "not in docs/reference, or with other arguments: " + ", ".join(missing)


def test_the_reference_has_no_other_names() -> None:
    public = {line.partition("(")[0].rpartition(".")[2] for line in surface()}
    documented = set(re.findall(r"^\| `([A-Za-z_]\w*)\(", REFERENCE, re.MULTILINE))
    of_tensors = set(dir(torch.Tensor))  # which an Image has, too
    assert documented <= public | of_tensors, documented - public


def renew_descriptions(page: Path) -> None:
    """Write the first sentence of each docstring into the tables of a page."""
    module = importlib.import_module(".".join(("kvision", *page.relative_to(FOLDER).with_suffix("").parts)))

    def renewed(row: re.Match[str]) -> str:
        value = getattr(module, row[2], None)
        summary = " ".join((inspect.getdoc(value) or "").split("\n\n")[0].split())
        hand_written = not summary or ":math:" in summary or (inspect.isclass(value) and issubclass(value, Enum))
        # A method of a class on the page that has the name of a function.
        hand_written |= inspect.isfunction(value) and "()" in row[1] and bool(inspect.signature(value).parameters)
        return row[0] if hand_written else row[1] + re.sub(r":\w+:(`[^`]+`)", r"\1", summary) + " |"

    page.write_text(re.sub(r"^(\| `(\w+)(?:\([^\n]*?\))?` \| )(.*) \|$", renewed, page.read_text(), flags=re.MULTILINE))


if __name__ == "__main__":
    for page in sorted(FOLDER.rglob("*.md")):
        if page.stem != "kvision":
            renew_descriptions(page)


def test_every_function_and_augmentation_of_images_has_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """`make docs` renders them."""
    monkeypatch.syspath_prepend(str(ROOT / "docs/site"))
    strips = importlib.import_module("strips").entries()
    modules = ("augmentation", "color", "enhance", "filters", "image", "morphology")
    calls = [call for call in (*sample_calls(), *sample_modules()) if call.name.startswith(modules) and call.axes]
    inputs = {call.name: next(iter(call.axes.values())).axes for call in calls}
    images = {name for name, axes in inputs.items() if re.match(r"(B )?[C134] H", axes)}
    images |= {
        f"geometry.{n}" for n in public_names(K.geometry) if re.search("warp_(affine|persp)|crop_|resize|pyr[du]", n)
    }
    volumes = {name for name in images if re.search("3d|3D$", name)}
    assert images - volumes - strips.keys() == {
        "color.normals_to_rgb255",
        "color.rgb255_to_normals",
        "color.rgb255_to_rgb",
        "color.rgb_to_frames",
        "color.rgb_to_rgb255",
        "enhance.adjust_hue_raw",
        "enhance.adjust_saturation_raw",
        "enhance.image_histogram2d",
        "enhance.integral_tensor",
    }  # whose pictures are those of others, or none


def test_the_page_of_conventions_is_its_tests() -> None:
    """`python tests/interchange/rows.py` writes it."""
    rows = importlib.import_module("interchange.rows")
    assert rows.PAGE.read_text() == rows.page() and rows.page().count("\n| ") > 90 + len(rows.SUBJECTS)
