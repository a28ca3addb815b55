"""Two photos that are changed a little until they match, by examples/attack_on_matching.py where it is next to the package."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import torch
from torch import Tensor

from kvision.demo import gallery
from kvision.demo.features import RIGHT, at, enlarged, reduced

PROGRAM = Path(__file__).parents[3] / "examples" / "attack_on_matching.py"
HEIGHT, FEATURES, ITERATIONS = 240, 500, 100


class Attacked(NamedTuple):
    """Both photos side by side, (1, H, 2 W): as they were, changed, and (3, H, 2 W) with their matches."""

    originals: Tensor
    changed: Tensor
    matched: Tensor
    matches: int
    psnr: float

    @property
    def figures(self) -> str:
        return f"{self.matches} matches under a homography of our choice, PSNR {self.psnr:.1f} dB"


def attack(photos: Sequence[Tensor], device: torch.device, progress: Callable[[int, int], None]) -> Attacked:
    """Attack the first two photos, or two of scikit-image if there are none. `progress` is told iterations done and all."""
    spec = importlib.util.spec_from_file_location(PROGRAM.stem, PROGRAM)
    assert spec is not None and spec.loader is not None
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    originals = program.pictures([photo[None] for photo in photos[:2]], HEIGHT, device)
    extractor = program.Extractor(FEATURES).to(device)
    homography = program.wanted_homography(0, originals[0])
    outcome = program.attack(extractor, *originals, homography, iterations=ITERATIONS, progress=progress)
    changed = torch.cat([outcome.first, outcome.second], 3)[0]
    return Attacked(
        torch.cat(originals, 3)[0], changed, draw(changed, *outcome.points), outcome.inliers, min(outcome.psnr)
    )


def draw(both: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Two images side by side, (1, H, 2 W), with lines between points (N, 2) of either."""
    image = enlarged(both.expand(3, -1, -1))
    moved = y + y.new_tensor([both.shape[2] // 2, 0])
    for start, end in zip(at(x).tolist(), at(moved).tolist()):
        cv2.line(image, start, end, RIGHT, 1, cv2.LINE_AA)
    return reduced(image)


def section(attacked: Attacked) -> gallery.Section:
    columns = [
        ("photos without a match", ""),
        ("changed", f"{attacked.psnr:.1f} dB"),
        ("", f"{attacked.matches} matches"),
    ]
    cells = [gallery.picture(x) for x in (attacked.originals, attacked.changed, attacked.matched)]
    return gallery.Section(
        "Two photos attacked through detector and descriptor until they match", columns, [("", cells)]
    )
