"""The demo from start to end, on small images."""

from __future__ import annotations

import re
import time
import timeit
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch

import fresh
import kvision as K

pytest.importorskip("cv2")
pytest.importorskip("PIL")
pytest.importorskip("tqdm")

from PIL import ImageFont

from kvision.demo import __main__ as demo
from kvision.demo import attack, augmentation, contact_sheet, gallery, sheet
from kvision.demo.restore import restore
from kvision.io import load_image, write_image

pytestmark = pytest.mark.programs

OPERATORS = ["gaussian blur", "motion blur", "sobel", "laplacian", "canny", "median", "bilateral", "unsharp mask"]
OPERATORS += ["hue", "lab", "plasma", "sepia", "saturation", "contrast", "gamma", "equalize", "clahe"]
OPERATORS += ["rotation", "perspective", "elastic", "pixels", "pyramid detail"]
OPERATORS += ["dilation", "erosion", "opening", "outline", "mosaic"]
OPERATORS += ["key points", "matches"]


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "SIDE", 48)
    monkeypatch.setattr(demo, "STEPS", 10)
    for name, value in (("HEIGHT", 60), ("FEATURES", 60), ("ITERATIONS", 2)):
        monkeypatch.setattr(attack, name, value)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One call of each is timed; how calls take turns has a test of its own."""

    def once(calls: Sequence[Callable[[], Any]], device: torch.device) -> list[list[float]]:
        return [[timeit.timeit(call, number=1) * 1e3] for call in calls]

    monkeypatch.setattr(sheet, "in_turns", once)


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "wide picture.png", tmp_path / "tall.jpg"]
    write_image(paths[0], torch.rand(3, 30, 70))
    write_image(paths[1], torch.rand(3, 90, 50))
    return paths


def test_makes_a_gallery_a_file_per_result_and_a_table(photos, quick, tmp_path, device, capsys):
    out = tmp_path / "results" / "here"
    assert demo.main([*map(str, photos), "--out", str(out), "--device", device.type]) == 0

    made = {path.name for path in out.iterdir()}
    results = [name.replace(" ", "_") for name in [*OPERATORS, "restored"]]
    names = [f"{photo}_{result}.png" for photo in ("1_wide picture", "2_tall") for result in results]
    pages = {f"gallery_{name}.jpg" for name in ("augmentation", "color", "features", "filters", "geometry", "shapes")}
    assert made == {*pages, *names}
    assert all((out / page).stat().st_size < 1_000_000 for page in pages)
    assert load_image(out / "2_tall_sobel.png").shape == (3, 48, 48)
    gallery = load_image(out / "gallery_filters.jpg")
    assert gallery.shape[2] > 9 * 48 and gallery.std() > 0.05

    printed, progress = capsys.readouterr()
    assert "writing       : 100%" in progress
    rows = re.findall(r"^(\S.*?) {2,}(native|reference) +([\d.]+) +([\d.]+|-)$", printed, re.MULTILINE)
    assert [row[0] for row in rows] == OPERATORS
    assert all(float(ms) >= 0 for _, _, ms, _ in rows) and any(float(ms) > 0 for _, _, ms, _ in rows)
    without_opencv = {"plasma", "sepia", "saturation", "contrast", "elastic", "pixels", "pyramid detail", "mosaic"}
    without_opencv |= {"matches"}
    assert {row[0] for row in rows if row[3] == "-"} == without_opencv
    before, after = map(float, re.search(r"loss (\S+) -> (\S+),", printed).groups())
    assert after < before
    assert re.search(r"^attacked: \d+ matches under a homography of our choice, PSNR [\d.]+ dB$", printed, re.MULTILINE)
    assert printed.rstrip().splitlines()[-1].startswith(f"gallery: {out}/gallery_{{")


@pytest.mark.slow
def test_says_which_backend_served(photos, quick, tmp_path, capsys):
    with K.backend("reference"):
        demo.main([str(photos[0]), "--out", str(tmp_path / "out"), "--device", "cpu"])
    printed = capsys.readouterr().out
    assert "native" not in printed and printed.count("reference") == len(OPERATORS) + 1


def test_takes_sample_photographs_by_default(quick, tmp_path, capsys, monkeypatch):
    pytest.importorskip("skimage")
    monkeypatch.setattr(demo, "SAMPLES", demo.SAMPLES[:1])
    monkeypatch.setattr(demo, "STEPS", 1)
    assert demo.main(["--out", str(tmp_path)]) == 0
    assert (tmp_path / "1_astronaut_canny.png").exists()


@pytest.mark.parametrize("content", [None, b"", b"not an image", b"\x89PNG\r\n\x1a\n cut short"])
def test_a_bad_file_is_named_without_a_traceback(content, photos, tmp_path, capsys):
    bad = tmp_path / "bad.png"
    if content is not None:
        bad.write_bytes(content)
    assert demo.main([str(photos[0]), str(bad), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith("kvision.demo: ") and str(bad) in message and message.count("\n") == 1


@pytest.mark.parametrize(
    "package, name",
    [
        ("tqdm", "tqdm"),
        pytest.param("PIL", "PIL", marks=pytest.mark.slow),
        pytest.param("skimage", "scikit-image", marks=pytest.mark.slow),
    ],
)
def test_missing_package_is_reported_with_its_command(package: str, name: str, tmp_path: Path) -> None:
    program = f"""
import runpy, sys
sys.modules[{package!r}] = None
sys.argv = ["kvision.demo", "--device", "cpu", "--out", {str(tmp_path)!r}]
runpy.run_module("kvision.demo", run_name="__main__")
"""
    result = fresh.run("import warnings; warnings.simplefilter('ignore')" + program)
    assert result.returncode == 1
    assert result.stderr == f'kvision.demo needs {name}: pip install ".[demo]"\n'
    if package == "tqdm":
        program = program.replace('"--device"', '"--help", "--device"')
        program = program.replace(
            "import runpy, sys", "import runpy, sys\nsys.modules |= dict.fromkeys(['PIL', 'cv2', 'skimage'])"
        )
        result = fresh.run(program)
        assert result.returncode == 0 and result.stdout.startswith("usage: python -m kvision.demo")


def test_an_output_folder_that_is_a_file_is_named(photos, capsys):
    assert demo.main([str(photos[0]), "--out", str(photos[1])]) == 2
    assert str(photos[1]) in capsys.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_missing_device_is_reported(photos, capsys):
    assert demo.main([str(photos[0]), "--device", "cuda"]) == 2
    assert "CUDA" in capsys.readouterr().err


def test_says_when_the_machine_is_busy() -> None:
    """By the middle operator, whose calls take 2.34 times the quickest one here."""
    quiet, loaded = (sheet.Column("", "", torch.zeros(0), None, "native", 1.0, None, ratio) for ratio in (1.1, 2.34))
    assert demo.busy([quiet, quiet, loaded]) == ""
    assert " 2.3 times the quickest" in demo.busy([quiet, loaded, loaded])


def test_runs_on_one_thread_where_other_work_has_the_cores(photos, tmp_path, device, capsys, monkeypatch) -> None:
    threads = torch.get_num_threads()
    assert 0 < sheet.cores_left(0.05) < threads + 0.5
    monkeypatch.setattr(demo, "cores_left", lambda: 0.2 * threads)
    try:
        assert demo.main([str(photos[0]), "--out", str(tmp_path), "--device", device.type]) == 0
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(threads)
    assert f"The machine is busy: torch gets {0.2 * threads:.1f} of {threads} cores." in capsys.readouterr().out


def test_calls_take_turns() -> None:
    calls = []
    times = sheet.in_turns([lambda i=i: (calls.append(i), time.sleep(0.01)) for i in range(2)], torch.device("cpu"))
    turns = [call for i, call in enumerate(calls) if i == 0 or calls[i - 1] != call]
    assert turns == 4 * [0, 1] and min(map(len, times)) >= 4


def test_restoring_lowers_the_loss_and_brings_the_photo_back():
    x = torch.zeros(1, 3, 40, 40)
    x[..., 10:30, 10:30] = 1
    restored = restore(x, range(60))
    assert len(restored.losses) == 61 and restored.losses[-1] < restored.losses[0] / 100
    assert restored.restored_psnr > restored.blurred_psnr + 3
    assert restored.restored.min() >= 0 and restored.restored.max() <= 1


@pytest.mark.parametrize("name", ["astronaut", "mine"])
def test_draws_of_augmentations_have_their_labels(name: str) -> None:
    photo = torch.rand(3, 48, 48)
    mask, boxes, points = augmentation.labels(name, 48)
    for i, (x, y, right, bottom) in enumerate(boxes.round().long().tolist()):
        inside = mask[0] == i + 1
        assert inside.any() and inside[y:bottom, x:right].sum() == inside.sum()
    assert ((points > 0) & (points < 47)).all()
    rows = augmentation.rows(48)
    assert len(rows) == 12
    drawn = [(row, augmentation.cells(row, photo, name)) for row in rows[-2:]]
    section = augmentation.section(drawn, name)
    columns = augmentation.DRAWS + 1
    assert len(section.columns) == columns and all(len(cells) == columns for _, cells in section.rows)
    assert {cell.size for _, cells in section.rows for cell in cells} == {(augmentation.CELL, augmentation.CELL)}
    assert section.notes == [row.call for row in rows[-2:]] and "RandomCrop((42, 42))" in section.notes[-1]


@pytest.mark.slow
def test_captions_are_no_wider_than_their_columns() -> None:
    font = ImageFont.load_default(18)
    for call in ("adjust_contrast_with_mean_subtraction(x, 1.6): farther from the mean", "rgb_to_lab(x): its colors"):
        lines = gallery._wrapped(call, 200, font).split("\n")
        assert "".join(lines).replace(" ", "") == call.replace(" ", "")
        assert max(map(font.getlength, lines)) <= 200
    assert gallery._wrapped("rgb_to_lab(x): colors", 300, font) == "rgb_to_lab(x): colors"


def test_the_largest_page_has_less_than_a_megabyte(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """At the size of its pictures, which the other tests of this file reduce, and legible."""
    pytest.importorskip("skimage")
    monkeypatch.undo()
    (name, *_), (photo, *_) = demo.load([])
    drawn = [(row, augmentation.cells(row, photo, name)) for row in augmentation.rows(demo.SIDE)]
    quality = gallery.save(gallery.page("", "", [augmentation.section(drawn, name)]), tmp_path / "page.jpg")
    assert (tmp_path / "page.jpg").stat().st_size < 1_000_000 and quality >= 64


def test_makes_the_contact_sheet(quick: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("skimage")
    monkeypatch.setattr(contact_sheet, "STEPS", 2)
    assert contact_sheet.main([str(tmp_path / "results.jpg")]) == 0
    page = load_image(tmp_path / "results.jpg")
    assert page.shape[2] > page.shape[1] > 3 * contact_sheet.TILE and page.std() > 0.1
