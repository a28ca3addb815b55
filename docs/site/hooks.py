"""What MkDocs does for the site besides its plugins.

- Pages of the repository that are not below docs/ (CHANGELOG.md, CONTRIBUTING.md, ...) and the examples become pages.
- Links between files of the repository become links of the site; those to other files become their text.
- A page of docs/reference gets, below its tables, the docstring of every name in them, through mkdocstrings. Where these are many,
  each of its sections is a page, of a family of functions.
- Names in the reference have picture strips (strips.py), and lead to their sources, which are pages as well.
"""

from __future__ import annotations

import ast
import functools
import html as html_text
import importlib
import inspect
import posixpath
import re
import sys
from pathlib import Path
from typing import Any, NamedTuple

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

import kvision as K

sys.path.insert(0, str(Path(__file__).parent))
import search
import strips

ROOT = Path(__file__).parents[2]
SOURCES = Path(K.__file__).parent
PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", "benchmarks/README.md", "third_party/README.md")
CPP = ("edges.cpp", "CMakeLists.txt", "save_pipeline.py", "run_pipeline.cpp")
LANGUAGES = {".py": "python", ".cpp": "cpp", ".txt": "cmake"}
# The strips of the list of examples.
THUMBNAILS = {
    "attack_on_matching": "geometry.warp_perspective",
    "augmentation": "augmentation.RandomAffine",
    "autoencoder": "augmentation.RandomGaussianNoise",
    "calibration": "geometry.undistort_image",
    "depth_estimation": "filters.spatial_gradient",
    "feature_matching": "feature.gftt_response",
    "image_registration": "geometry.homography_warp",
    "process_folder": "enhance.equalize_clahe",
    "segmentation_losses": "contrib.connected_components",
    "structure_from_motion": "geometry.reproject_image",
    "train_distributed": "augmentation.auto.RandAugment",
    "train_from_jpegs": "augmentation.RandomResizedCrop",
}
FEWEST = 16  # names of a page of the reference whose sections get pages of their own
FURTHER = {"augmentation": ("auto", "auto.operations")}  # modules whose names a page of the reference has as well


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for path in PAGES:
        files.append(File.generated(config, path, content=(ROOT / path).read_text()))
    examples = sorted((ROOT / "examples").glob("*.py"))
    for path in examples:
        files.append(_example_page(config, path.stem, example(path)))
    sources = [listing(ROOT / "examples/cpp" / name) for name in CPP]
    text = "# C++\n\nA complete CMake project; [cpp.md](../docs/cpp.md) and [deployment.md](../docs/deployment.md) explain it.\n\n"
    files.append(_example_page(config, "cpp", text + "\n".join(sources)))
    files.append(File.generated(config, "examples/index.md", content=list_of_examples(examples)))
    for name, data in strips.strips().items():
        files.append(File.generated(config, strips.uri(name), content=data))
    files.append(File.generated(config, "reference/pictures.md", content=strips.overview(reference_of)))
    for page, family in families().items():
        files.append(File.generated(config, page, content=family.text))
    sources = sorted({source_of(anchor)[0] for anchor in pages_by_anchor() if anchor})
    files.append(File.generated(config, "source/index.md", content=list_of_sources(sources)))
    for path in sources:
        files.append(_unlisted_page(config, source_uri(path), source_page(path)))
    return files


def _example_page(config: MkDocsConfig, stem: str, content: str) -> File:
    """A page that the list of examples links to."""
    return _unlisted_page(config, f"examples/{stem}.md", content)


def _unlisted_page(config: MkDocsConfig, uri: str, content: str) -> File:
    """A page without a line in the navigation."""
    return File.generated(config, uri, content=content, inclusion=InclusionLevel.NOT_IN_NAV)


def reference_of(name: str) -> str:
    """The address of a function in the reference, from a page there."""
    last = name.split(".")[-1]
    anchor = f"kvision.{name}"
    if name.startswith("geometry."):
        anchor = f"{'.'.join(getattr(K.geometry, last).__module__.split('.')[:3])}.{last}"
    return f"{posixpath.relpath(pages_by_anchor()[anchor], 'reference')}#{anchor}"


def first_paragraph(path: Path) -> str:
    return " ".join((ast.get_docstring(ast.parse(path.read_text())) or "").split("\n\n")[0].split())


def title(stem: str) -> str:
    return stem.replace("_", " ").capitalize()


def example(path: Path) -> str:
    documentation = ast.get_docstring(ast.parse(path.read_text())) or ""
    # An indented line of a command stays one; the source follows.
    return f"# {title(path.stem)}\n\n{documentation}\n\n{listing(path)}"


def listing(path: Path) -> str:
    return f'```` {{.{LANGUAGES[path.suffix]} title="{path.relative_to(ROOT)}"}}\n{path.read_text()}````\n'


def list_of_examples(paths: list[Path]) -> str:
    lines = ["# Examples", "", "Programs to read and to run on your own images.", ""]
    for path in paths:
        picture = f"![](../{strips.uri(THUMBNAILS[path.stem])}){{ .thumbnail }}<br>" if path.stem in THUMBNAILS else ""
        lines.append(f"- {picture}[{title(path.stem)}]({path.name}): {first_paragraph(path)}")
    return "\n".join(
        [*lines, "- [C++](cpp): a CMake project that calls kvision, and one that runs saved pipelines.", ""]
    )


# --- links --------------------------------------------------------------------------------------------------------------

LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s#]*)(#[^)\s]*)?\)")


def repository_path(uri: str) -> str:
    """Where the source of a page of the site is in the repository."""
    if uri in families():
        uri = families()[uri].source
    return uri if uri in PAGES or uri.startswith("examples/") else f"docs/{uri}"


def site_uri(path: str) -> str:
    """The page of the site that shows a file of the repository."""
    if path.startswith("docs/"):
        return {"docs/README.md": "index.md", "docs/reference": "reference/kvision.md"}.get(path, path[len("docs/") :])
    if path.startswith("examples"):
        page = path.removesuffix(".py")
        return f"{page}.md" if not path.startswith("examples/cpp") else "examples/cpp.md"
    if path.startswith("python/kvision/"):
        return f"source/{path.removeprefix('python/kvision/').removesuffix('.py')}.md"
    return {"README.md": "index.md", "benchmarks": "benchmarks/README.md", "python/kvision": "source/index.md"}.get(
        path, path
    )


def translate_links(text: str, page: Page, files: Files) -> str:
    folder = posixpath.dirname(repository_path(page.file.src_uri))

    def translated(link: re.Match[str]) -> str:
        mark, words, target, anchor = link[1], link[2], link[3], link[4] or ""
        if not target or re.match(r"\w+:", target):
            return link[0]
        uri = site_uri(posixpath.normpath(posixpath.join(folder, target)))
        if files.get_file_from_path(uri) is None:
            return words if (ROOT / folder / target).exists() else link[0]  # the second is an error of strict mode
        return f"{mark}[{words}]({posixpath.relpath(uri, posixpath.dirname(page.file.src_uri) or '.')}{anchor})"

    parts = re.split(r"(^ *````?.*?^ *````?$|`[^`\n]+`)", text, flags=re.MULTILINE | re.DOTALL)
    return _outside_of_code(parts, lambda part: LINK.sub(translated, part))


def _outside_of_code(parts: list[str], change: Any) -> str:
    # A link whose words are code is split by the code, so blocks alone are kept apart.
    joined, out = "", []
    for part in parts:
        if part.lstrip().startswith("```"):
            out += [change(joined), part]
            joined = ""
        else:
            joined += part
    return "".join([*out, change(joined)])


# --- reference ----------------------------------------------------------------------------------------------------------

ROW = re.compile(r"^\| `([A-Za-z_]\w*)(\([^\n]*?\))?` \|", re.MULTILINE)


@functools.cache
def definitions(path: str) -> dict[str, int]:
    """The functions and classes that a file defines, and their lines."""
    body = ast.parse(Path(path).read_text()).body
    return {node.name: node.lineno for node in body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}


def documented_path(module: Any, name: str) -> str | None:
    """Where the docstring of a name is, None where the sources do not define it under a name of its own."""
    value = getattr(module, name, None)
    if not (inspect.isfunction(value) or inspect.isclass(value)) or not value.__module__.startswith("kvision"):
        return None
    source = inspect.getsourcefile(value)
    if source is None or name != value.__qualname__ or name not in definitions(source) or not inspect.getdoc(value):
        return None
    return f"{value.__module__}.{value.__qualname__}"


def anchor_of(uri: str, name: str) -> str | None:
    """The public name of a row of a page of docs/reference, which is the anchor of its docstring; None where it has none."""
    dotted = uri.removeprefix("reference/").removesuffix(".md").replace("/", ".")
    package = "kvision" if dotted == "kvision" else f"kvision.{dotted}"
    for module in (package, *(f"{package}.{further}" for further in FURTHER.get(dotted, ()))):
        if documented_path(importlib.import_module(module), name):
            return f"{module}.{name}"
    return None


class Family(NamedTuple):
    """A section of a page of docs/reference, as a page of the site."""

    source: str  # the page that has it
    title: str
    text: str


@functools.cache
def families() -> dict[str, Family]:
    """The pages of families of functions, by their address: sections with docstrings of reference pages with many."""
    found = {}
    for path in sorted((ROOT / "docs/reference").rglob("*.md")):
        uri = str(path.relative_to(ROOT / "docs"))
        if sum(anchor_of(uri, row[1]) is not None for row in ROW.finditer(path.read_text())) < FEWEST:
            continue
        head, *sections = re.split(r"^## ", path.read_text(), flags=re.MULTILINE)
        for section in sections:
            title, _, text = section.partition("\n")
            if any(anchor_of(uri, row[1]) for row in ROW.finditer(text)):
                slug = re.sub(r"\W+", "-", title.lower()).strip("-")
                module = head.partition("\n")[0].removeprefix("# ")
                found[f"{uri.removesuffix('.md')}/{slug}.md"] = Family(uri, title, f"# {module}: {title}\n{text}")
    return found


@functools.cache
def pages_by_anchor() -> dict[str, str]:
    """The pages of docstrings, by their anchors."""
    found: dict[str, str] = {}
    for page, (source, _, text) in families().items():
        for row in ROW.finditer(text):
            found.setdefault(anchor_of(source, row[1]) or "", page)
    for path in sorted((ROOT / "docs/reference").rglob("*.md")):
        uri = str(path.relative_to(ROOT / "docs"))
        for row in ROW.finditer(path.read_text()):
            found.setdefault(anchor_of(uri, row[1]) or "", uri)
    return found


def add_docstrings(text: str, page: str) -> str:
    """The text of a page with rows that lead to docstrings, and those of its own names below."""
    source = families()[page].source if page in families() else page
    blocks: dict[str, str] = {}

    def linked(row: re.Match[str]) -> str:
        anchor = anchor_of(source, row[1])
        if anchor is None:
            return row[0]
        if pages_by_anchor()[anchor] != page:
            return f"| [`{row[1]}`]({posixpath.relpath(pages_by_anchor()[anchor], posixpath.dirname(page))}#{anchor}) |"
        module, _, name = anchor.rpartition(".")
        is_class = inspect.isclass(getattr(importlib.import_module(module), name))
        blocks[anchor] = (
            f"::: {anchor}\n    options:\n      heading: {anchor}\n      toc_label: {name}\n"
            f"      members: {'null' if is_class else 'false'}\n"  # null: those that pass the filters
        )
        return f"| [`{name}`](#{anchor}) |"

    text = ROW.sub(linked, text)
    return "\n".join([text, "", "## Names in detail", "", *blocks.values()]) if blocks else text


def with_families(nav: Any) -> Any:
    """The navigation with the pages of families below that of their module."""
    if isinstance(nav, list):
        return [with_families(entry) for entry in nav]
    if isinstance(nav, dict):
        return {title: with_families(entry) for title, entry in nav.items()}
    pages = [{family.title: page} for page, family in families().items() if family.source == nav]
    if not pages:
        return nav
    title = (ROOT / "docs" / nav).read_text().partition("\n")[0].removeprefix("# ")
    return {title: [nav, *pages]}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    config.nav = with_families(config.nav)
    return config


# --- sources ------------------------------------------------------------------------------------------------------------


def source_of(anchor: str) -> tuple[Path, int]:
    """The file and the line that define a public name."""
    module, _, name = anchor.rpartition(".")
    path = inspect.getsourcefile(getattr(importlib.import_module(module), name))
    assert path is not None
    return Path(path), definitions(path)[name]


def source_uri(path: Path) -> str:
    return f"source/{path.relative_to(SOURCES).with_suffix('.md')}"


def source_page(path: Path) -> str:
    """A file of Python whose lines have anchors; the search leaves it out."""
    name = path.relative_to(SOURCES)
    return (
        f"---\nsearch: {{exclude: true}}\nhide: [navigation, toc]\n---\n\n# {name}\n\n"
        f'```` {{.python linenums="1"}}\n{path.read_text()}````\n'
    )


def list_of_sources(paths: list[Path]) -> str:
    """The page of the files that define public names, by folder."""
    lines = ["---", "search: {exclude: true}", "---", "", "# Source", ""]
    lines.append("The files of Python that define public names. Kernels have their names: those of")
    lines.append("`filters/edges/sobel.py` are `csrc/filters/edges/sobel*` in the repository.")
    folder = None
    for path in paths:
        name = path.relative_to(SOURCES)
        if name.parent != folder:
            folder = name.parent
            lines += ["", f"## {Path('kvision', folder)}", ""]
        lines.append(f"- [{name.name}]({posixpath.relpath(source_uri(path), 'source')})")
    return "\n".join([*lines, ""])


HEADING = re.compile(r'<h3 id="kvision\.[\w.]+"[^>]*class="doc doc-heading".*?</h3>', re.DOTALL)


def with_source_and_strip(heading: re.Match[str], page: Page, files: Files) -> str:
    """The heading of a name in the reference, the way to its source, and its strip."""
    identifier = re.search(r'id="(kvision\.[\w.]+)"', heading[0])
    assert identifier is not None
    path, line = source_of(identifier[1])
    file = files.get_file_from_path(source_uri(path))
    assert file is not None
    target = f"{get_relative_url(file.url, page.url)}#__codelineno-0-{line}"
    head = f'{heading[0]}<p class="source"><a href="{target}">{path.relative_to(SOURCES)}:{line}</a></p>'
    module, _, name = identifier[1].rpartition(".")
    value = getattr(importlib.import_module(module), name)
    parts = module.split(".")[1:]
    found = strips.name_of(".".join(parts), value) or strips.name_of(parts[0] if parts else "", value)
    if found is None:
        return head
    call = html_text.escape(strips.entries()[found])
    source = get_relative_url(strips.uri(found), page.url)
    return (
        f'{head}<figure class="strip"><img src="{source}" alt="{found}" loading="lazy">'
        f"<figcaption><code>{call}</code></figcaption></figure>"
    )


GALLERY = re.compile(r"<div class=\"gallery\".*?</div>", re.DOTALL)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    def figures(block: re.Match[str]) -> str:
        return (
            re.sub(
                r'(<img alt="([^"]*)"[^>]*?/?>)\s*',
                r"<figure>\1<figcaption><code>\2</code></figcaption></figure>",
                block[0],
            )
            .replace("<p>", "<div>")
            .replace("</p>", "</div>")
        )

    if page.file.src_uri.startswith("reference/"):
        if "doc-object doc-module" in html:
            raise PluginError(f"{page.file.src_uri} describes a file where a function of its name is meant")
        html = HEADING.sub(lambda heading: with_source_and_strip(heading, page, files), html)
    return GALLERY.sub(figures, html)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    if page.file.src_uri.startswith("source/"):
        return markdown  # has no links of the repository
    text = translate_links(markdown, page, files)
    if page.file.src_uri.startswith("reference/") and page.file.src_uri != "reference/pictures.md":
        text = add_docstrings(text, page.file.src_uri)
    return text


def on_post_build(config: MkDocsConfig) -> None:
    search.index(Path(config.site_dir))
