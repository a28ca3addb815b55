"""`show`: pictures with their labels and captions, in files, notebooks and windows."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.image import display, drawing, show
from kvision.io import load_image

pytestmark = pytest.mark.interface
ORANGE = torch.tensor([255, 140, 0])[:, None, None] / 255


@pytest.fixture
def sheets(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The sheets that calls display, and the captions on them."""
    seen: list[Any] = []
    sheet_of = drawing.sheet_of

    def recorded(cells: Any, columns: int, gap: int, captions: Any) -> Tensor:
        seen.append((cells, list(captions)))
        return sheet_of(cells, columns, gap, captions)

    monkeypatch.setattr(drawing, "sheet_of", recorded)
    monkeypatch.setattr(display, "_display", lambda sheet: None)
    return seen


@pytest.mark.skipif(sys.version_info < (3, 11), reason="frames do not know the columns of their calls")
def test_captions_are_the_expressions_of_the_call(sheets: list[Any]) -> None:
    image = torch.rand(3, 8, 8)
    K.show(image, K.filters.box_blur(image[None], 3), image[None].expand(2, -1, -1, -1))
    K.show(
        image * 4 - 1,  # stretched
        columns=2,
    )
    arguments = [image, image]
    K.show(*arguments)
    exec("show(x)", {"show": K.show, "x": image})
    texts = [captions for _, captions in sheets]
    assert texts[0] == [
        "image",
        "K.filters.box_blur(image[None], 3)",
        *(f"image[None].expand(2, -1, -1, -1)[{i}]" for i in (0, 1)),
    ]
    assert texts[1][0].startswith("image * 4 - 1: -") and texts[2] == ["0", "1"] and texts[3] == ["0"]


def test_values_are_drawn_as_they_are_or_stretched(sheets: list[Any]) -> None:
    ramp = torch.arange(64.0).view(1, 8, 8)
    unit = ramp / 63
    alpha = torch.cat([unit.expand(3, -1, -1), torch.zeros(1, 8, 8)])
    nan = torch.where(ramp == 5, torch.nan, unit)
    array = (255 * unit.expand(3, -1, -1)).byte().movedim(0, -1).numpy()
    show(unit, 2 * ramp - 63, ramp.long(), array, [unit[0], unit.to(torch.bfloat16)], alpha, nan, unit > 2, size=8)
    cells, captions = sheets[0]
    for cell in cells[:5]:
        torch.testing.assert_close(cell, unit.expand(3, -1, -1), rtol=0, atol=1 / 255)
    assert (cells[6] == 1).all() and cells[7][0, 0, 5] == 0 and not cells[8].any()
    assert (
        captions[1].endswith(": -63 to 63")
        and captions[2].endswith(": 0 to 63")
        and captions[7].endswith(", 1 not finite")
    )
    show(torch.rand(2, 3, 2, 8, 8), torch.rand(5, 8, 8), captions=[*"abcdefg"], size=8)
    cells, captions = sheets[1]
    assert len(cells) == 17 and captions[1] == "a, channel 1" and captions[16] == "g, channel 4"


def test_labels_are_drawn_on_their_images(sheets: list[Any]) -> None:
    image, mask = torch.full((3, 32, 32), 0.5), torch.zeros(32, 32, dtype=torch.long)
    mask[8:16, 4:20] = 1
    box, point = torch.tensor([[4.0, 8.0, 20.0, 16.0]]), torch.tensor([[11.5, 11.5]])
    corners = torch.tensor([[[3.5, 7.5], [19.5, 7.5], [19.5, 15.5], [3.5, 15.5]]])
    for one, many in (
        (dict(masks=mask), dict(masks=[None, mask.numpy()])),
        (dict(boxes=box), dict(boxes=[None, box.tolist()])),
        (dict(boxes=corners), dict(boxes=[None, corners])),
        (dict(keypoints=point), dict(keypoints=[None, point])),
    ):
        show(image, size=32, **one)
        show(image, image, size=32, **many)
        (cell,), (plain, last) = (cells for cells, _ in sheets[-2:])
        assert torch.equal(plain, image) and torch.equal(cell, last)
        changed = (cell - image).abs().amax(0) > 0.05
        rows, columns = changed.any(1).nonzero(), changed.any(0).nonzero()
        assert abs(rows[0] + rows[-1] - 23) <= 1 and abs(columns[0] + columns[-1] - 23) <= 1
    show(image.expand(2, -1, -1, -1), masks=mask.expand(2, -1, -1), boxes=box.expand(2, -1, -1), size=32)
    assert torch.equal(*sheets[-1][0])


def test_where_it_appears(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    image = torch.rand(3, 16, 24)
    K.show(image, file=tmp_path / "a.png", size=24)
    assert (load_image(tmp_path / "a.png")[:, 4:20, 4:28] - image).abs().max() < 0.01
    monkeypatch.setattr(display, "_in_window", lambda sheet: False)
    monkeypatch.setattr(display.tempfile, "tempdir", str(tmp_path))
    K.show(image)
    (made,) = tmp_path.glob("kvision-*.png")
    assert capsys.readouterr().out == f"kvision.show: {made}\n"
    shown: list[Any] = []
    ipython = ModuleType("IPython")
    ipython.get_ipython = lambda: SimpleNamespace(kernel=None)  # type: ignore[attr-defined]
    output = ModuleType("IPython.display")
    output.Image, output.display = (lambda data: data), shown.append  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", output)
    K.show(image)
    assert shown[0] == made.read_bytes()


def test_windows_of_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    shown: list[Any] = []
    monkeypatch.setattr(pyplot, "show", lambda: shown.append(pyplot.gcf().axes[0].images[0].get_array()))
    sheet = torch.rand(3, 16, 24)
    monkeypatch.setattr(pyplot, "get_backend", lambda: "agg")
    assert not display._in_window(sheet) and not shown
    monkeypatch.setattr(pyplot, "get_backend", lambda: "QtAgg")
    assert display._in_window(sheet)
    np.testing.assert_allclose(shown[0], sheet.movedim(0, -1))
    pyplot.close("all")


IMAGE = torch.rand(3, 8, 8)


@pytest.mark.parametrize(
    ("args", "kwargs", "error", "message"),
    [
        ((), {}, ValueError, "expected at least one image, got none"),
        ((3,), {}, TypeError, r"expected images\[0\] to be a Tensor, .*, got int"),
        ((IMAGE, [[IMAGE]]), {}, TypeError, r"expected images\[1\] to be a Tensor, .*, got list"),
        ((IMAGE[0, 0],), {}, ValueError, r"expected images\[0\] of shape \(H, W\), .*, got \(8,\)"),
        ((IMAGE,), {"boxes": torch.rand(2, 5)}, ValueError, "expected boxes of 1 images, got those of 2"),
        (
            (IMAGE,),
            {"boxes": [torch.rand(2, 5)]},
            ValueError,
            r"expected boxes\[0\] of shape \(N, 4\) or \(N, 4, 2\), got \(2, 5\)",
        ),
        ((IMAGE, IMAGE), {"masks": IMAGE}, ValueError, "expected masks of 2 images, got those of 3"),
        ((IMAGE,), {"captions": ["a", "b"]}, ValueError, "expected 1 captions"),
        ((IMAGE,), {"size": 0}, ValueError, "expected size to be a positive int, got 0"),
    ],
)
def test_errors(args: Any, kwargs: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match="show: " + message):
        K.show(*args, **kwargs)
