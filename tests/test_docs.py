"""The Python examples and the links of the pages a reader meets first."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import kvision as K

ROOT = Path(__file__).parents[1]
PAGES = ["README.md", "CONTRIBUTING.md", "docs/README.md", "docs/design.md", "third_party/README.md"]


def test_readme_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = pytest.importorskip("skimage.data")
    monkeypatch.chdir(tmp_path)
    K.io.write_image("photo.jpg", K.image_to_tensor(data.astronaut()))
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    names: dict[str, object] = {}
    exec(example, names)
    assert names["image"].grad.abs().sum() > 0
    assert K.io.load_image("edges.png").shape == (3, 512, 512)


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    text = (ROOT / page).read_text()
    for target in re.findall(r"\]\(([^)#]+)", text):
        if not target.startswith("http"):
            assert (ROOT / page).parent.joinpath(target).exists(), target


@pytest.mark.parametrize("page", PAGES)
def test_paths_exist(page: str) -> None:
    """Files a page names in backticks, of this repository by their first folder."""
    folders = "|".join(path.name for path in ROOT.iterdir() if path.is_dir() and path.name not in ("build", "out"))
    for path in re.findall(rf"`((?:{folders})/[\w./-]*\w)`", (ROOT / page).read_text()):
        assert (ROOT / path).exists() or list(ROOT.glob(path + "*")), path
