"""Boxes and points against the pixels of results. What pixels read is known from an image of the coordinates of its pixels."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A
from op_tests import THOROUGH

pytestmark = pytest.mark.interface


def coordinate_image(height: int, width: int, device: torch.device) -> Tensor:
    """x, y and 1 of each pixel, (1, 3, H, W). Interpolation of these gives the position that is read."""
    y, x = (
        torch.arange(height, device=device, dtype=torch.float32),
        torch.arange(width, device=device, dtype=torch.float32),
    )
    return torch.stack(
        [x.expand(height, width), y[:, None].expand(height, width), torch.ones_like(x).expand(height, width)]
    )[None]


def pixels_around(result: Tensor, box: Tensor) -> Tensor | None:
    """The bounding rectangle of the pixels of a result (3, H, W) that read from inside an xyxy box."""
    x, y, known = result
    reads = (known > 0.999) & (x >= box[0] - 0.5) & (x <= box[2] - 0.5) & (y >= box[1] - 0.5) & (y <= box[3] - 0.5)
    rows, columns = reads.nonzero().unbind(1)
    if not len(rows):
        return None
    return torch.stack([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]).float()


def position_read(result: Tensor, position: Tensor) -> Tensor | None:
    """What a result (3, H, W) reads at a position, where the map is one to one and nearly linear around it; None elsewhere."""
    column, row = (int(n) for n in position.floor())
    if not (2 <= column < result.shape[2] - 4 and 2 <= row < result.shape[1] - 4):
        return None
    x, y, known = result[:, row - 2 : row + 4, column - 2 : column + 4]
    determinant = x.diff(dim=1)[1:] * y.diff(dim=0)[:, 1:] - x.diff(dim=0)[:, 1:] * y.diff(dim=1)[1:]
    curvature = max(float(t.diff(n=2, dim=dim).abs().max()) for t in (x, y) for dim in (0, 1))
    if known.min() < 0.999 or not (determinant > 0.1).all() or curvature > 0.15:
        return None
    right, down = position - position.floor()
    cell = torch.stack([x, y], -1)[2:4, 2:4]
    along = cell[:, 0] + right * (cell[:, 1] - cell[:, 0])
    return along[0] + down * (along[1] - along[0])


def overlap(a: Tensor, b: Tensor) -> float:
    inside = (torch.minimum(a[2:], b[2:]) - torch.maximum(a[:2], b[:2])).clamp(min=0).prod()
    return float(inside / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - inside))


def check_labels(
    children: Any, size: tuple[int, int], box: tuple[int, int], seed: int, device: torch.device, **options: Any
) -> list[float]:
    """Overlaps of moved boxes with the pixels of theirs. Points are checked here."""
    height, width = size
    generator = torch.Generator().manual_seed(seed)
    corner = torch.rand(12, 2, generator=generator) * torch.tensor([width - box[0], height - box[1]])
    boxes = torch.cat([corner, corner + torch.tensor(box)], -1).to(device)
    points = (torch.rand(24, 2, generator=generator) * torch.tensor([width - 1, height - 1])).to(device)
    augment = A.AugmentationSequential(*children, data_keys=["input", "bbox_xyxy", "keypoints"], **options)
    result, moved, positions = augment(coordinate_image(height, width, device), boxes[None], points[None], seed=seed)
    is_read_once = len(children) == 1 or augment.resample == "once"
    visible, (x, y, known) = augment.visible_points[0][0], result[0]
    reads = torch.stack([torch.where(known > 0.999, x, torch.inf), y], -1)
    for point, position, shown in zip(points, positions[0], visible):
        miss = (reads - point).norm(dim=-1)
        at = int(miss.argmin())
        if shown and float(miss.min()) < 1:
            nearest = torch.tensor([at % miss.shape[1], at // miss.shape[1]], device=device)
            assert (position - nearest).norm() <= 1.75, (point, position, nearest)  # 1.5 from one that is as near
            read = position_read(result[0], position) if is_read_once else None
            assert read is None or (read - point).norm() <= 0.05, (point, position, read)
        elif not shown:
            assert miss.min() > 0.2, (point, position)
    truths = [pixels_around(result[0], one) for one in boxes]
    return [overlap(a, b) for a, b in zip(moved[0], truths) if b is not None and (b[2:] - b[:2]).min() > 20]


CHAINS = {
    "elastic": lambda: [A.RandomElasticTransform(p=1.0)],
    "thin plate": lambda: [A.RandomThinPlateSpline(p=1.0)],
    "fisheye": lambda: [A.RandomFisheye((-0.3, 0.3), (-0.3, 0.3), (0.9, 2.0), p=1.0)],
    "distortions": lambda: [A.GridDistortion(p=1.0), A.OpticalDistortion((0.1, 0.2), p=1.0), A.Swirl(p=1.0)],
    "chain": lambda: [
        A.RandomAffine(20.0, (0.1, 0.1), p=1.0),
        A.RandomElasticTransform(p=1.0),
        A.RandomThinPlateSpline(0.1, p=1.0),
        A.RandomResizedCrop((300, 400), scale=(0.5, 0.9)),
    ],
}


@pytest.mark.parametrize("name, options", [*((name, {}) for name in CHAINS), ("chain", {"resample": "once"})], ids=str)
def test_labels_are_where_pixels_read_them(name: str, options: dict[str, Any], device: torch.device) -> None:
    overlaps = check_labels(CHAINS[name](), (600, 1100), (200, 160), 3, device, **options)
    assert len(overlaps) > 3 and min(overlaps) >= 0.9


SIZES = (256, 256), (720, 1280), (640, 640), (1024, 1024), (1080, 1920), (2160, 3840)


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES if THOROUGH else SIZES[:2], ids=str)
def test_boxes_under_the_default_elastic_transform(size: tuple[int, int], device: torch.device) -> None:
    overlaps = sorted(
        x for seed in range(12) for x in check_labels(CHAINS["elastic"](), size, (200, 160), seed, device)
    )
    print(f"{size}: {len(overlaps)} boxes, overlaps of at least {overlaps[0]:.3f}")
    assert overlaps[0] >= 0.8 and overlaps[len(overlaps) // 100] >= 0.9


def test_samples_that_no_map_moves_keep_their_bits(device: torch.device) -> None:
    boxes = torch.rand(6, 5, 2, device=device)
    boxes = torch.cat([30 * boxes, 30 * boxes + 20], -1)
    points = 60 * torch.rand(6, 5, 2, device=device)
    children = A.RandomElasticTransform(p=0.5), A.RandomHorizontalFlip(p=0.0), A.RandomThinPlateSpline(p=0.2)
    augment = A.AugmentationSequential(*children, data_keys=["input", "bbox_xyxy", "keypoints"])
    _, moved, positions = augment(torch.rand(6, 1, 64, 64, device=device), boxes, points, seed=2)
    moves = torch.stack([item.data["batch_prob"] > 0.5 for item in augment._params]).any(0)
    assert 0 < moves.sum() < 6
    assert torch.equal(moved[~moves], boxes[~moves]) and not torch.equal(moved[moves], boxes[moves])
    assert torch.equal(positions[~moves], points[~moves])
    assert augment.visible_points[0][~moves].all()


def test_points_of_maps_have_gradients(device: torch.device) -> None:
    points = torch.tensor([[[20.0, 30], [40, 12]]], device=device, dtype=torch.float64, requires_grad=True)
    augment = A.AugmentationSequential(A.RandomThinPlateSpline(0.1, p=1.0), data_keys=["input", "keypoints"])
    moved = augment(torch.zeros(1, 1, 48, 64, device=device), points, seed=1)[1]
    (gradient,) = torch.autograd.grad(moved[..., 0].sum(), points)
    shifted = augment(points.detach() + torch.tensor([0.25, 0.0], device=device), data_keys=["keypoints"])
    torch.testing.assert_close(gradient[..., 0], (shifted - moved.detach())[..., 0] * 4, rtol=0.03, atol=0.03)


def displacements(elastic: Any, batch: int, size: int, device: torch.device) -> Tensor:
    elastic(torch.zeros(batch, 1, size, size, device=device), seed=0)
    return elastic.displacements_of(elastic._execution, elastic.flags, torch.zeros(1, device=device))


def test_elastic_windows_that_scale_with_the_image(device: torch.device) -> None:
    """Displacements are as large, relative to the image, in all sizes; and large images do not fold."""
    extent = [
        float(displacements(A.RandomElasticTransform(scale_window=True, p=1.0), 8, size, device).std()) / size
        for size in (64, 256, 512)
    ]
    assert max(extent) < 1.2 * min(extent)
    folds = []
    for scales in (True, False):
        moved = displacements(A.RandomElasticTransform(scale_window=scales, p=1.0), 1, 1024, device)
        (xx, xy), (yx, yy) = moved[0, :, :-1].diff(dim=-1), moved[0, ..., :-1].diff(dim=-2)
        folds.append(float(((1 + xx) * (1 + yy) - xy * yx < 0).float().mean()))
    assert folds[0] < 0.002 and 0.1 < folds[1] < 0.17, folds
    tensor = A.RandomElasticTransform(sigma=torch.tensor([[32.0, 32.0]]), scale_window=True, p=1.0)
    image = torch.rand(1, 1, 64, 80)
    expected = A.RandomElasticTransform(scale_window=True, p=1.0)(image, seed=1)
    torch.testing.assert_close(tensor(image, seed=1), expected, rtol=0, atol=1e-4)


# --- clipping at each step ------------------------------------------------------------------------------------------


class Shift(A.GeometricAugmentationBase2D):
    """Columns to the right."""

    def __init__(self, columns: float) -> None:
        super().__init__(p=1.0)
        self.columns = columns

    def compute_transformation(self, input: Tensor, params: Any, flags: Any) -> Tensor:
        matrix = torch.tensor([[1.0, 0, self.columns], [0, 1, 0], [0, 0, 1]], device=input.device)
        return matrix.expand(len(input), 3, 3)


def test_boxes_that_left_and_came_back(device: torch.device) -> None:
    """What a shift has moved out of the image is gone, also if the next one moves back."""
    boxes = torch.tensor([[[1.0, 2, 9, 4], [8, 1, 9, 3]]], device=device)

    def moved(**options: Any) -> Any:
        augment = A.AugmentationSequential(Shift(4.0), Shift(-4.0), data_keys=["input", "bbox_xyxy"], **options)
        return augment(torch.zeros(1, 1, 8, 10, device=device), boxes)[1], augment

    assert torch.equal(moved(clip_boxes=True)[0], boxes)
    clipped, augment = moved(clip_boxes="each")
    assert clipped.tolist() == [[[1, 2, 6, 4], [0, 0, 0, 0]]] and augment.kept_boxes[0].tolist() == [[True, False]]
    assert moved(clip_boxes="each", min_box_visibility=0.6)[1].kept_boxes[0].tolist() == [[True, False]]
    assert moved(clip_boxes="each", min_box_visibility=0.7)[1].kept_boxes[0].tolist() == [[False, False]]
    with pytest.raises(ValueError, match="expected clip_boxes to be a bool or 'each', got 'all'"):
        moved(clip_boxes="all")


def test_boxes_that_begin_outside_and_come_in(device: torch.device) -> None:
    """Of a batch, a list and an image alone: what no step has moved is not cut off, whatever others of the call got."""
    augment = A.AugmentationSequential(
        A.RandomApply(Shift(4.0)),
        A.RandomApply(Shift(3.0)),
        data_keys=["input", "bbox_xyxy", "keypoints"],
        clip_boxes="each",
    )
    x, seeds = torch.zeros(16, 1, 8, 12, device=device), torch.arange(16, device=device)
    boxes = torch.tensor([[[-3.0, 2, 2, 4]]], device=device).repeat(16, 1, 1)
    points = torch.tensor([[[-3.0, 2]]], device=device).repeat(16, 1, 1)
    _, moved, _ = augment(x, boxes, points, seed=seeds)
    (visible,) = augment.visible_points
    _, of_list, _ = augment([own[..., :width] for own, width in zip(x, [12, 11] * 8)], [*boxes], [*points], seed=seeds)
    assert {tuple(box[0].tolist()) for box in moved} == {(0, 2, 2, 4), (1, 2, 6, 4), (0, 2, 5, 4), (4, 2, 9, 4)}
    assert torch.equal(moved, torch.stack([*of_list])) and torch.equal(
        visible, torch.stack([*augment.visible_points[0]])
    )
    for i in range(16):
        assert torch.equal(augment(x[i : i + 1], boxes[:1], points[:1], seed=seeds[i : i + 1])[1], moved[i : i + 1])
        assert torch.equal(augment.visible_points[0], visible[i : i + 1])


def test_boxes_of_samples_of_several_sizes_are_cut_off_at_their_own_edges(device: torch.device) -> None:
    """Between the turns of a choice, as they are alone."""
    order = A.RandomOrder(A.Resize((32, 40)), Shift(9.0), Shift(-9.0))
    augment = A.AugmentationSequential(order, data_keys=["input", "bbox_xyxy"], clip_boxes="each")
    x, seeds = torch.zeros(8, 1, 16, 20, device=device), torch.arange(8, device=device)
    boxes = torch.tensor([[[2.0, 4.0, 18.0, 14.0]]], device=device).repeat(8, 1, 1)
    _, moved = augment(x, boxes, seed=seeds)
    assert len({*moved.flatten(1).unbind(0)}) > 1
    for i in range(8):
        torch.testing.assert_close(augment(x[i : i + 1], boxes[:1], seed=seeds[i : i + 1])[1], moved[i : i + 1])


def test_boxes_clipped_at_each_step_are_tight(device: torch.device) -> None:
    children = A.RandomAffine(40.0, (0.3, 0.3), p=1.0), A.RandomPerspective(0.3, p=1.0), A.RandomAffine(40.0, p=1.0)
    image = coordinate_image(120, 160, device)
    boxes = torch.tensor([[30.0, 20, 130, 70], [80, 60, 158, 118]], device=device)
    augment = A.AugmentationSequential(*children, data_keys=["input", "bbox_xyxy"], clip_boxes="each")
    for seed in range(4):
        result, moved = augment(image, boxes[None], seed=seed)
        for box, kept, before in zip(moved[0], augment.kept_boxes[0][0], boxes):
            truth = pixels_around(result[0], before)
            if truth is None:
                assert not kept or (box[2:] - box[:2]).min() < 6
            else:
                assert kept and (box - truth).abs().max() < 4, (seed, box, truth)  # pixels at edges are faint
