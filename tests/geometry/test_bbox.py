"""Functions of boxes, and overlap as an oracle computes it."""

import itertools
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry


def rand(*shape: int, seed: int = 3) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def xyxy(*shape: int, axes: int = 2, seed: int = 3) -> Tensor:
    near = 20 * rand(*shape, axes, seed=seed)
    return torch.cat([near, near + 2 + 10 * rand(*shape, axes, seed=seed + 1)], -1)


def rigid(batch: int, axes: int = 2) -> Tensor:
    M = torch.eye(axes + 1, dtype=torch.float64).repeat(batch, 1, 1)
    M[:, :axes] += 0.1 * rand(batch, axes, axes + 1, seed=9)
    M[:, axes, 0] = 1e-3
    return M


class TestBbox(CompositionTests):
    cases = {
        "bbox_generator": Case(G.bbox_generator, ((2,),) * 4),
        "bbox_generator3d": Case(G.bbox_generator3d, ((2,),) * 6),
        "infer_bbox_shape3d": Case(lambda b: torch.stack(G.infer_bbox_shape3d(b), -1), ((2, 8, 3),)),
        "transform_bbox": Case(lambda b, M: G.transform_bbox(M, b, "xywh"), ((2, 5, 4), (2, 3, 3))),
        "bbox_to_mask": Case(lambda b: G.bbox_to_mask(4 * b, 5, 4), ((2, 4, 2),), differentiable=False),
        "bbox_to_mask3d": Case(lambda b: G.bbox_to_mask3d(4 * b, (3, 4, 5)), ((2, 8, 3),), differentiable=False),
    }
    compiled = ()


@pytest.fixture(scope="module")
def theirs():
    """Kornia's functions and classes of boxes."""
    pytest.importorskip("kornia")
    from kornia.geometry import bbox, boxes

    return SimpleNamespace(**vars(bbox) | vars(boxes))


def test_bbox_functions_are_those_of_kornia(theirs, device):
    starts, sizes = 4 * rand(3, 5), 4 * rand(3, 5, seed=8) + 1
    box = theirs.bbox_generator(*starts[:2], *sizes[:2])
    space = theirs.bbox_generator3d(*starts, *sizes)
    assert_close(G.bbox_generator(*starts[:2].to(device), *sizes[:2].to(device)).cpu(), box)
    assert_close(G.bbox_generator3d(*starts.to(device), *sizes.to(device)).cpu(), space)
    assert_close([x.cpu() for x in G.infer_bbox_shape(box.to(device))], list(theirs.infer_bbox_shape(box)))
    assert_close([x.cpu() for x in G.infer_bbox_shape3d(space.to(device))], list(theirs.infer_bbox_shape3d(space)))
    assert_close(G.bbox_to_mask(box.to(device), 9, 8).cpu(), theirs.bbox_to_mask(box, 9, 8))
    whole = space.round()
    assert_close(G.bbox_to_mask3d(whole.to(device), (6, 7, 8)).cpu(), theirs.bbox_to_mask3d(whole, (6, 7, 8)))
    assert G.bbox_generator(*torch.tensor([3, 4, 5, 6], device=device)).shape == (1, 4, 2)
    flip = torch.tensor([[[-2.0, 0, 10], [0, 1, 3], [0, 0, 1]]], dtype=torch.float64)
    for mode, restore in itertools.product(("xyxy", "xywh"), (None, False)):
        boxes = xyxy(1, 5)
        result = G.transform_bbox(flip.to(device), boxes.to(device), mode, restore)
        assert_close(result.cpu(), theirs.transform_bbox(flip, boxes, mode, restore))
    M = rigid(2)
    assert_close(
        G.transform_bbox(M.to(device), xyxy(2, 5, 4, axes=1).to(device)).cpu(),
        theirs.transform_bbox(M, xyxy(2, 5, 4, axes=1)),
    )


def test_rotated_box_bounds_its_corners(device):
    turn = torch.eye(3, dtype=torch.float64)[None]
    turn[:, :2, :2] = G.angle_to_rotation_matrix(torch.tensor([45.0], dtype=torch.float64))
    result = G.transform_bbox(turn.to(device), torch.tensor([[0.0, 0, 1, 1]], dtype=torch.float64, device=device))
    half = 0.5**0.5
    assert_close(result, torch.tensor([[0, -half, 2 * half, half]], dtype=torch.float64, device=device))


def test_validation():
    box = G.bbox_generator(*torch.tensor([1.0, 2, 3, 4]))
    assert G.validate_bbox(box)
    assert G.validate_bbox(box[None])
    crooked = box.clone()
    crooked[0, 1, 0] += 1
    assert not G.validate_bbox(crooked)
    assert not G.validate_bbox(box[0])
    assert not G.validate_bbox(box * torch.nan)
    space = G.bbox_generator3d(*torch.tensor([1.0, 2, 3, 4, 5, 6]))
    assert G.validate_bbox3d(space)
    for vertex, axis in itertools.product(range(8), range(3)):
        crooked = space.clone()
        crooked[0, vertex, axis] += 1
        with pytest.raises(ValueError, match="validate_bbox3d: expected boxes with parallel edges"):
            G.validate_bbox3d(crooked)


BOX = xyxy(2, 5)
BAD = [
    (lambda: G.bbox_generator(*torch.ones(3), torch.ones(1).int()), TypeError, "bbox_generator: expected tensors of one type"),
    (lambda: G.bbox_to_mask(BOX, 3, 4), ValueError, r"bbox_to_mask: expected boxes of shape \(B, 4, 2\)"),
    (lambda: G.transform_bbox(torch.eye(3), BOX), ValueError, r"transform_bbox: expected trans_mat of shape \(B, 3, 3\)"),
    (lambda: G.transform_bbox(torch.eye(3)[None], BOX[..., :3]), ValueError, r"of shape \(N, 4\), \(B, N, 4\) or"),
    (lambda: G.transform_bbox(torch.eye(3).expand(3, 3, 3), BOX), ValueError, "trans_mat with 1 or 2 matrices"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
