"""kvision.migrate: the names of Kornia that it finds in a source, and its report about them."""

from __future__ import annotations

from pathlib import Path

import pytest

from kvision import migrate

pytestmark = pytest.mark.interface

PAGE = """
# Where results differ

## Geometry

### From Kornia 0.9: images

| where | Kornia 0.9 | kvision |
| --- | --- | --- |
| integers | error | computed |
| `remap` with `align_corners=False` | not exact | exact |
| `Boxes.pad`, `Boxes.clamp` | in place | new boxes |

### From OpenCV

| where | OpenCV | kvision |
| --- | --- | --- |
| `resize` | bytes | floats |
"""


def names(source: str) -> list[tuple[int, str]]:
    return [(use.line, use.name) for use in migrate.kornia_uses(source)]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import kornia\nkornia.filters.sobel(x)", [(2, "kornia.filters.sobel")]),
        ("import kornia as K\ny = K.geometry.transform.remap", [(2, "kornia.geometry.transform.remap")]),
        ("import kornia.geometry as G\nG.resize(x, 2)", [(1, "kornia.geometry"), (2, "kornia.geometry.resize")]),
        ("import kornia.color\nkornia.color.sepia(x)", [(1, "kornia.color"), (2, "kornia.color.sepia")]),
        ("from kornia.losses import ssim_loss as s\ns(a, b)", [(1, "kornia.losses.ssim_loss"), (2, "kornia.losses.ssim_loss")]),
        ("from kornia import filters\nfilters.Sobel()(x)", [(1, "kornia.filters"), (2, "kornia.filters.Sobel")]),
        ("from kornia.color import *", [(1, "kornia.color")]),
        ("import kornia\nf(kornia.sobel)(kornia.remap(x))", [(2, "kornia.remap"), (2, "kornia.sobel")]),
        ("from kornia.geometry import Boxes as B\nB.pad(x)", [(1, "kornia.geometry.Boxes"), (2, "kornia.geometry.Boxes.pad")]),
        ("import torch\nfrom .kornia import sobel\nimport kornia_rs\ntorch.nn.functional.pad(x)", []),
    ],
)  # fmt: skip
def test_finds_the_names_of_kornia(source: str, expected: list[tuple[int, str]]) -> None:
    assert names(source) == expected


def judged(source: str, page: str | None = PAGE) -> dict[str, tuple[str, list[str]]]:
    uses = migrate.kornia_uses(source)
    rows = migrate.differences(page)
    return {use.name: migrate.judge([other for other in uses if other.name == use.name], rows) for use in uses}


def test_says_what_is_the_same_what_differs_and_what_is_missing() -> None:
    result = judged(
        "import kornia as K\nK.geometry.hflip(x)\nK.geometry.remap(x)\nK.geometry.no_such_name(x)\nK.nowhere.f()"
    )
    assert result["kornia.geometry.hflip"] == (migrate.SAME, [])
    status, notes = result["kornia.geometry.remap"]
    assert status == migrate.DIFFERENT
    assert notes == ["docs/differences.md:11: `remap` with `align_corners=False`: not exact -> exact"]
    assert result["kornia.geometry.no_such_name"][0] == migrate.MISSING
    assert result["kornia.nowhere.f"][0] == migrate.MISSING
    for path in ("tracking.HomographyTracker", "onnx.ONNXSequential", "feature.LoFTR", "models.detection.rtdetr"):
        status, notes = judged(f"import kornia\nkornia.{path}()")[f"kornia.{path}"]
        assert status == migrate.MISSING and len(notes) == 1 and notes[0].startswith("instead: ")


def test_members_differ_by_themselves_and_with_their_class() -> None:
    result = judged("from kornia.geometry import Boxes\nboxes = Boxes.from_tensor(x)\nBoxes.pad(boxes)")
    assert result["kornia.geometry.Boxes"][0] == migrate.DIFFERENT
    assert result["kornia.geometry.Boxes.from_tensor"][0] == migrate.SAME
    assert result["kornia.geometry.Boxes.pad"][0] == migrate.DIFFERENT


def test_other_libraries_and_general_rows_do_not_count() -> None:
    assert judged("import kornia\nkornia.geometry.resize(x, 2)")["kornia.geometry.resize"] == (migrate.SAME, [])
    assert [row.line for row in migrate.differences(PAGE) if not row.names] == [10]


def test_an_unknown_keyword_is_named() -> None:
    status, notes = judged("import kornia\nkornia.filters.sobel(x, normalized=True, radius=3)")["kornia.filters.sobel"]
    assert status == migrate.DIFFERENT and notes == ["no argument radius"]
    assert judged("import kornia\nkornia.filters.Sobel(eps=0.0)")["kornia.filters.Sobel"][0] == migrate.SAME


@pytest.mark.parametrize(
    "call, words",
    [
        ("augmentation.AugmentationSequential(data_keys=None)", "names of dict entries with a suffix"),
        ("augmentation.ImageSequential(f)", "`to_pil`, `show`, `save` of"),
        ("augmentation.RandomCutMixV2(cut_size=(0.1, 0.4))", "bounds the side of the window"),
        ("augmentation.Normalize(0.5, 0.5)", "uint8 images"),
        ("augmentation.RandomRotation(30.0)", "in the state dict -> not in the state dict"),
        ("filters.box_blur(x, 3)", "uint8 images"),
        ("geometry.ScalePyramid()", "in the state dict -> not in the state dict"),
    ],
)
def test_what_bites_first_is_named(call: str, words: str) -> None:
    status, notes = judged(f"import kornia\nkornia.{call}", page=None)[f"kornia.{call.partition('(')[0]}"]
    assert status == migrate.DIFFERENT and any(words in note for note in notes), notes


def test_the_page_of_differences_has_rows_for_every_module() -> None:
    """Headings and tables of docs/differences.md have the format that the script parses, and its names exist."""
    rows = migrate.differences()
    modules = {module for row in rows for module in row.modules}
    assert modules == {module for section in migrate._SECTIONS.values() for module in section}
    assert all(row.modules for row in rows) and len(rows) > 150


def test_the_command_reports_files_and_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "a.py").write_text(
        "from kornia.geometry import hflip, remap\nhflip(x)\nremap(x, y, z)\nimport kornia.augmentation\n"
    )
    (tmp_path / "package" / "b.py").write_text("print('no Kornia here')\n")
    assert migrate.main([str(tmp_path / "package")]) == 0
    printed = capsys.readouterr().out
    assert "kornia.geometry.hflip: same (line 1, 2)" in printed and "b.py" not in printed
    assert "kornia.geometry.remap: different (line 1, 3)" in printed and "docs/differences.md:" in printed
    assert "random numbers: several numbers of torch's CPU generator" in printed
    assert printed.endswith("1 same, 1 different, 0 not in kvision yet\n")

    (tmp_path / "c.py").write_text("import kornia\nkornia.no_such_module.f(x)\n")
    assert migrate.main([str(tmp_path / "c.py")]) == 1
    assert "kornia.no_such_module.f: not in kvision yet (line 2)" in capsys.readouterr().out


@pytest.mark.parametrize("content", [None, b"def f(:", b"\xff\xfe"])
def test_unreadable_file_is_named(content: bytes | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.py"
    if content is not None:
        path.write_bytes(content)
    assert migrate.main([str(path)]) == 2
    assert str(path) in capsys.readouterr().err
