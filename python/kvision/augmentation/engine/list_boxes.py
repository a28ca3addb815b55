"""Boxes and points of the images of a list, moved by the launches of a batch where they follow matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision.augmentation import labels
from kvision.augmentation.engine.label_moves import LabelMoves
from kvision.augmentation.engine.stages import ByMatrix, Chain
from kvision.augmentation.labels import BOX_FORMATS
from kvision.constants import DataKey


def follow_matrices(run: Any) -> bool:
    """Whether boxes and points follow a run on a list by the matrices of its warps, and none is removed."""
    for number, step, _ in run.label_steps:
        moving = [run.modules[n] for n in ([number] if step is None else step.geometric)]
        if not all(m.keeps_positions or (step and m._warps_points and not m.removes_boxes) for m in moving):
            return False
    return True


def are_boxes_or_points(key: DataKey, values: Any) -> bool:
    """Whether values are boxes (N, 4) or corners (N, 4, 2) of each image, as the key says, or points (N, 2)."""
    if not isinstance(values, (list, tuple, Tensor)) or not all(isinstance(x, Tensor) and x.dim() for x in values):
        return False
    form = (2,) if key == DataKey.KEYPOINTS else (4, 2) if key == DataKey.BBOX else (4,)
    kinds = {(x.dtype, x.device) for x in values if len(x)}
    return len(kinds) <= 1 and all(x.shape[1:] == form for x in values)


def move_each(key: DataKey, values: Sequence[Tensor], run: Any) -> list[Tensor]:
    """Boxes or points (N, ...) of each image after a run on a list. Each is a sample by itself, so that none is padded."""
    counts = [len(x) for x in values]
    if not any(counts):
        return list(values)
    rows = on_device(torch.tensor([b for b, n in enumerate(counts) for _ in range(n)], device="cpu"), run.device)
    moves = LabelMoves(
        Chain([ByMatrix(matrix.index_select(0, rows)) for _, step, matrix in run.label_steps if step]), ()
    )
    batch = torch.cat([x for x in values if len(x)])[:, None]
    if key == DataKey.KEYPOINTS:
        moved = labels.move_points(batch, lambda points: moves.move_points(points)[0], 2)
    else:
        moved = labels.move_boxes(batch, BOX_FORMATS[key], moves.move_boxes)[0]
    each = iter(moved[:, 0].split([n for n in counts if n]))
    return [next(each) if n else x for n, x in zip(counts, values)]
