"""Boxes and key points: Kornia's values in every form, gradients, tracing, overlap as an oracle computes it."""

import itertools
import pickle
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
MODES = ("xyxy", "xyxy_plus", "xywh", "vertices", "vertices_plus")
MODES3D = ("xyzxyz", "xyzxyz_plus", "xyzwhd", "vertices", "vertices_plus")


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


class TestBoxes(CompositionTests):
    cases = {
        "corners": Case(lambda b: G.Boxes.from_tensor(b, validate_boxes=False).data, ((2, 5, 4),)),
        "transform": Case(lambda b, M: G.Boxes(b).transform_boxes(M).to_tensor("xywh"), ((2, 5, 4, 2), (2, 3, 3))),
        "area": Case(lambda b: G.Boxes(b).compute_area(), ((2, 5, 4, 2),)),
        "filtered": Case(
            lambda b: G.Boxes(b).filter_boxes_by_area(0.1).translate(b[:, 0, 0]).to_tensor(), ((2, 5, 4, 2),)
        ),
        "clamp": Case(lambda b, a: G.Boxes(b).clamp(a / 2, (0.7, 0.8)).data, ((2, 5, 4, 2), (2, 2))),
        "merge": Case(lambda b, c: G.Boxes(b).merge(G.Boxes(c)).data, ((2, 5, 4, 2), (2, 3, 4, 2))),
        "mask": Case(lambda b: G.Boxes(4 * b).to_mask(4, 5), ((2, 3, 4, 2),), differentiable=False),
        "space": Case(lambda b, M: G.Boxes3D(b).transform_boxes(M).to_tensor("xyzwhd"), ((2, 5, 8, 3), (2, 4, 4))),
        "video": Case(lambda b: G.VideoBoxes.from_tensor(b, False).to_tensor("xyxy"), ((2, 3, 5, 4, 2),)),
        "keypoints": Case(lambda k, M: G.Keypoints(k).transform_keypoints(M).data, ((2, 5, 2), (2, 3, 3))),
        "keypoints3d": Case(lambda k, p: G.Keypoints3D(k).pad(p).data, ((2, 5, 3), (2, 6))),
        "bbox_generator": Case(G.bbox_generator, ((2,),) * 4),
        "bbox_generator3d": Case(G.bbox_generator3d, ((2,),) * 6),
        "infer_bbox_shape3d": Case(lambda b: torch.stack(G.infer_bbox_shape3d(b), -1), ((2, 8, 3),)),
        "transform_bbox": Case(lambda b, M: G.transform_bbox(M, b, "xywh"), ((2, 5, 4), (2, 3, 3))),
        "bbox_to_mask": Case(lambda b: G.bbox_to_mask(4 * b, 5, 4), ((2, 4, 2),), differentiable=False),
        "bbox_to_mask3d": Case(lambda b: G.bbox_to_mask3d(4 * b, (3, 4, 5)), ((2, 8, 3),), differentiable=False),
    }
    compiled = ("filtered", "mask")


def every_form(boxes: Tensor, pads: Tensor, M: Tensor) -> list[Tensor]:
    """Of Boxes and VideoBoxes."""
    found = []
    for mode in MODES:
        found.append(G.Boxes.from_tensor(G.Boxes(boxes).to_tensor(mode), mode, validate_boxes=False).to_tensor(mode))
        found.append(G.VideoBoxes.from_tensor(boxes[:, None], False).to_tensor(mode))
    there = G.Boxes(boxes).transform_boxes(M).pad(pads).unpad(pads).translate(pads[:, :2])
    kept = there.clamp(pads[:, :2], (9, 9)).merge(there).filter_boxes_by_area(1.0, 9.0).trim(True)
    there[:1] = there[1:]
    for some in (there, kept, kept.clone()[0], there.to(dtype=torch.float32)):
        found += [some.data, some.compute_area(), *some.get_boxes_shape()]
    return [*found, there.to_mask(7, 8)]


def every_form3d(boxes: Tensor, points: Tensor, M: Tensor) -> list[Tensor]:
    """Of Boxes3D and Keypoints."""
    found = []
    for mode in MODES3D:
        there = G.Boxes3D.from_tensor(G.Boxes3D(boxes).to_tensor(mode), mode, validate_boxes=False).transform_boxes(M)
        found += [there.to_tensor(mode), *there.get_boxes_shape()]
    for kind, pads, matrix in ((G.Keypoints, M[:, 0], M[:, 1:, 1:]), (G.Keypoints3D, M.flatten(1)[:, :6], None)):
        there = kind.from_tensor(points[..., : pads.shape[1] // 2]).pad(pads).unpad(pads)
        found += [there[0].data, (there if matrix is None else there.transform_keypoints(matrix)).to_tensor()]
    return [*found, G.Boxes3D(boxes).to_mask(3, 4, 5)]


def test_all_of_it_compiles_without_a_break(device):
    corners = G.Boxes.from_tensor(xyxy(2, 5)).data.to(device)
    corners3d = G.Boxes3D.from_tensor(xyxy(2, 5, axes=3)).data.to(device)
    calls = (every_form, corners, rand(2, 4), rigid(2)), (every_form3d, corners3d, rand(2, 5, 3), rigid(2, 3))
    for call, *args in calls:
        values = [v.to(device) for v in args]
        for found, expected in zip(torch.compile(call, fullgraph=True, backend="eager")(*values), call(*values)):
            assert_close(found, expected)


def test_containers_go_into_and_come_out_of_compiled_functions(device):
    M = rigid(2).to(device)
    boxes, points = G.Boxes.from_tensor(xyxy(2, 5).to(device)), G.Keypoints(rand(2, 5, 2).to(device))
    moved = torch.compile(
        lambda b, k: (b.transform_boxes(M), k.transform_keypoints(M)), fullgraph=True, backend="eager"
    )
    for found, expected in zip(moved(boxes, points), (boxes.transform_boxes(M), points.transform_keypoints(M))):
        assert type(found) is type(expected)
        assert_close(found.data, expected.data)


@pytest.fixture(scope="module")
def theirs():
    """Kornia's functions and classes of boxes."""
    pytest.importorskip("kornia")
    from kornia.geometry import bbox, boxes

    return SimpleNamespace(**vars(bbox) | vars(boxes))


# --- values ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("batch", [(), (2,)], ids=["one", "batch"])
@pytest.mark.parametrize("source, target", [*itertools.product(MODES, MODES)])
def test_forms_are_those_of_kornia(source, target, batch, theirs, device):
    given = theirs.Boxes.from_tensor(xyxy(*batch, 5)).to_tensor(source)
    ours = G.Boxes.from_tensor(given.to(device), source)
    his = theirs.Boxes.from_tensor(given, source)
    assert_close(ours.data.cpu(), his.data)
    assert_close(ours.to_tensor(target).cpu(), his.to_tensor(target))
    assert ours.mode == source
    assert_close(ours.to_tensor(), ours.to_tensor(source))


@pytest.mark.parametrize("source, target", [*itertools.product(MODES3D[:3], MODES3D)])
def test_forms_in_space_are_those_of_kornia(source, target, theirs, device):
    given = theirs.Boxes3D.from_tensor(xyxy(2, 5, axes=3)).to_tensor(source)
    ours, his = G.Boxes3D.from_tensor(given.to(device), source), theirs.Boxes3D.from_tensor(given, source)
    assert_close(ours.data.cpu(), his.data)
    assert_close(ours.to_tensor(target).cpu(), his.to_tensor(target))
    assert_close([x.cpu() for x in ours.get_boxes_shape()], list(his.get_boxes_shape()))
    assert_close(ours.to_mask(9, 20, 22).cpu(), his.to_mask(9, 20, 22))
    again = G.Boxes3D.from_tensor(ours.to_tensor("vertices"), "vertices")
    assert_close(again.data, ours.data)
    M = rigid(2, 3)
    assert_close(ours.transform_boxes(M.to(device)).data.cpu(), his.transform_boxes(M).data, 1e-9, 1e-9)


@pytest.mark.parametrize("batch", [(), (2,)], ids=["one", "batch"])
def test_methods_are_those_of_kornia(batch, theirs, device):
    given, more = xyxy(*batch, 5), xyxy(*batch, 3, seed=7)
    ours, his = G.Boxes.from_tensor(given.to(device)), theirs.Boxes.from_tensor(given)
    n = batch[0] if batch else 1
    M, move, rim = rigid(n), rand(n, 2), 5 * rand(n, 4)
    low, high = torch.full((n, 2), 8.0, dtype=torch.float64), torch.full((n, 2), 19.0, dtype=torch.float64)
    index = (torch.tensor([0]),)

    def both(call):
        found, expected = call(ours.clone(), lambda x: x.to(device)), call(his.clone(), lambda x: x)
        for a, b in zip(*((y,) if not isinstance(y, tuple) else y for y in (found, expected)), strict=True):
            a, b = (y if isinstance(y, Tensor) else y.data for y in (a, b))
            assert_close(a.cpu(), b, 1e-9, 1e-9)

    both(lambda x, on: x.get_boxes_shape())
    both(lambda x, on: x.compute_area())
    both(lambda x, on: x.to_mask(20, 25))
    both(lambda x, on: x.transform_boxes(on(M)))
    both(lambda x, on: x.transform_boxes(on(M)).to_tensor("xyxy"))
    both(lambda x, on: x.transform_boxes_(on(M)))
    both(lambda x, on: x.translate(on(move)))
    both(lambda x, on: x.pad(on(rim)))
    both(lambda x, on: x.unpad(on(rim)))
    both(lambda x, on: x.clamp(on(low), on(high)))
    both(lambda x, on: x.merge(type(x).from_tensor(on(more))))
    both(lambda x, on: x.filter_boxes_by_area(30, 90).to_tensor("xyxy"))
    both(lambda x, on: x.filter_boxes_by_area(30, 90).translate(on(move)).to_tensor("xywh"))
    both(lambda x, on: x.index_put(tuple(map(on, index)), x.data[1:2]))
    both(lambda x, on: x.index_put(tuple(map(on, index)), x[1:2]))
    both(lambda x, on: x[1:2])


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
        found = G.transform_bbox(flip.to(device), boxes.to(device), mode, restore)
        assert_close(found.cpu(), theirs.transform_bbox(flip, boxes, mode, restore))
    M = rigid(2)
    assert_close(
        G.transform_bbox(M.to(device), xyxy(2, 5, 4, axes=1).to(device)).cpu(),
        theirs.transform_bbox(M, xyxy(2, 5, 4, axes=1)),
    )


def test_a_turned_box_is_around_its_corners(device):
    turn = torch.eye(3, dtype=torch.float64)[None]
    turn[:, :2, :2] = G.angle_to_rotation_matrix(torch.tensor([45.0], dtype=torch.float64))
    found = G.transform_bbox(turn.to(device), torch.tensor([[0.0, 0, 1, 1]], dtype=torch.float64, device=device))
    half = 0.5**0.5
    assert_close(found, torch.tensor([[0, -half, 2 * half, half]], dtype=torch.float64, device=device))


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


# --- lists, videos, filtered boxes ------------------------------------------------------------------------------------


def test_lists(theirs, device):
    parts = [xyxy(3), xyxy(0), xyxy(5, seed=5)]
    ours = G.Boxes.from_tensor([p.to(device) for p in parts])
    his = theirs.Boxes.from_tensor(parts)
    assert_close(ours.data.cpu(), his.data)
    for mode in MODES:
        assert_close([x.cpu() for x in ours.to_tensor(mode)], his.to_tensor(mode))
    assert ours.to_tensor("xyxy", as_padded_sequence=True)[0, 3:].abs().max() == 0
    assert_close(ours.to_mask(20, 20).cpu(), his.to_mask(20, 20))
    assert [len(x) for x in ours[1:].to_tensor()] == [0, 5]
    assert [len(x) for x in ours[torch.tensor([2, 0], device=device)].to_tensor()] == [5, 3]
    assert_close(ours[2].to_tensor("xyxy").cpu(), parts[2])
    both = ours.merge(ours)
    assert_close([x.cpu() for x in both.to_tensor()], [torch.cat([p, p]) for p in parts])
    assert [len(x) for x in ours.merge(G.Boxes(ours.data[:, :2])).to_tensor()] == [5, 2, 7]
    assert G.Boxes.from_tensor([[1.0, 2, 3, 4]]).shape == (1, 4, 2)
    assert G.Boxes.from_tensor([]).to_tensor() == []
    points = G.Keypoints([p[:, :2].to(device) for p in parts]).transform_keypoints(torch.eye(3, device=device).double())
    assert_close([x.cpu() for x in points.to_tensor()], [p[:, :2] for p in parts])
    assert points.to_tensor(as_padded_sequence=True).shape == (3, 5, 2)


def test_trim(device):
    sizes = torch.tensor([[9.0, 1, 9, 1], [1, 1, 9, 1]], device=device)
    zero = torch.zeros_like(sizes)
    boxes = G.Boxes.from_tensor(torch.stack([zero, zero, sizes + 1, sizes + 1], -1)).filter_boxes_by_area(4)
    assert_close(boxes.trim(True).to_tensor("xywh")[..., 2], torch.tensor([[10.0, 10], [0, 10]], device=device))
    assert boxes.trim().shape == (2, 2, 4, 2)
    assert_close(boxes.trim().to_tensor("xywh")[..., 2], torch.tensor([[10.0, 10], [10, 0]], device=device))
    assert boxes[1].trim(inplace=True).shape == (1, 4, 2)


def test_videos(theirs, device):
    vertices = theirs.Boxes.from_tensor(xyxy(6, 5)).data.reshape(2, 3, 5, 4, 2)
    ours, his = G.VideoBoxes.from_tensor(vertices.to(device)), theirs.VideoBoxes.from_tensor(vertices)
    for mode in MODES:
        assert_close(ours.to_tensor(mode).cpu(), his.to_tensor(mode))
    M = rigid(6)
    moved = ours.transform_boxes(M.to(device))
    assert isinstance(moved, G.VideoBoxes)
    assert_close(moved.to_tensor("xyxy").cpu(), his.transform_boxes(M).to_tensor("xyxy"), 1e-9, 1e-9)
    assert_close([x.cpu() for x in ours.get_boxes_shape()], list(his.get_boxes_shape()))
    for key in (0, -1, slice(1, 2), torch.tensor([1, 0])):
        assert_close(ours[key].to_tensor().cpu(), his[key].to_tensor())
    ours[0] = ours[1]
    assert_close(ours.to_tensor()[0], ours.to_tensor()[1])
    small = ours.filter_boxes_by_area(max_area=50)
    assert_close(small[1].to_tensor(), small.to_tensor()[1:])


def test_objects_keep_to_themselves(device):
    """What is made of a tensor does not write to it, and only what says so changes an object."""
    tensor = xyxy(2, 5).to(device)
    vertices = G.Boxes.from_tensor(tensor).data
    before, boxes = vertices.clone(), G.Boxes(vertices)
    other = boxes.clone()
    boxes.pad(torch.ones(2, 4, device=device))
    boxes[0] = boxes[1]
    boxes.index_put((torch.tensor([0], device=device),), boxes[1:], inplace=True)
    boxes.clamp((0, 0), (5, 5), inplace=True)
    boxes.translate(torch.ones(1, 2, device=device), "fast", inplace=True)
    boxes.filter_boxes_by_area(3, inplace=True)
    boxes.merge(other, inplace=True)
    assert boxes.shape == (2, 10, 4, 2)
    assert_close(vertices, before)
    assert_close(other.data, before)
    assert boxes.type(torch.float16).dtype == boxes.to("cpu").dtype == torch.float16
    assert_close(pickle.loads(pickle.dumps(boxes)).to_tensor("xyxy"), boxes.to_tensor("xyxy"))
    assert "Boxes(" in repr(boxes)
    points = G.Keypoints3D.from_tensor(tensor[..., :3])
    moved = (
        points.clone().unpad(torch.ones(1, 6, device=device)).transform_keypoints_(torch.eye(4, device=device).double())
    )
    assert_close(moved.data + 1, points.data)


# --- non-maxima suppression -----------------------------------------------------------------------------------------


def greedy(boxes: Tensor, scores: Tensor, threshold: float) -> list[int]:
    kept: list[int] = []
    overlaps = K.metrics.mean_iou_bbox(boxes, boxes)
    for i in scores.argsort(descending=True, stable=True).tolist():
        if not any(overlaps[i, j] > threshold for j in kept):
            kept.append(i)
    return kept


@pytest.mark.parametrize("threshold", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("n", [0, 1, 2, 50, 300])
def test_nms_is_greedy(n, threshold, device, monkeypatch):
    boxes, scores = xyxy(n), (10 * rand(n, seed=6)).round()
    found = G.nms(boxes.to(device), scores.to(device), threshold)
    assert found.tolist() == greedy(boxes, scores, threshold)
    monkeypatch.setattr("kvision.geometry.bbox.NMS_BLOCK", 37)
    assert G.nms(boxes.to(device), scores.to(device), threshold).tolist() == found.tolist()


def test_nms_of_a_chain(device):
    """Each box excludes the next one alone: as many rounds as there are boxes."""
    x = torch.arange(100.0, device=device)
    boxes = torch.stack([x, 0 * x, x + 1.5, 0 * x + 1], -1)
    assert G.nms(boxes, -x, 0.1).tolist() == list(range(0, 100, 2))
    assert G.nms(0 * boxes, -x, 0.1).tolist() == list(range(100))  # no area, no overlap


BOX = xyxy(2, 5)
BAD = [
    (lambda: G.Boxes(BOX), ValueError, r"Boxes: expected boxes of shape \(\*, 4, 2\), got \(2, 5, 4\)"),
    (lambda: G.Boxes(torch.ones(4, 2)), ValueError, r"Boxes: expected boxes of shape \(N, 4, 2\) or \(B, N, 4, 2\)"),
    (lambda: G.Boxes(torch.ones(1, 4, 2).int()), TypeError, "Boxes: expected boxes to be floating point"),
    (lambda: G.Boxes.from_tensor(BOX, "yxyx"), ValueError, "Boxes: mode must be one of xyxy, xyxy_plus, xywh"),
    (lambda: G.Boxes.from_tensor(BOX, 3), TypeError, "Boxes: expected mode to be a str"),
    (lambda: G.Boxes.from_tensor(3.0), TypeError, "Boxes: expected boxes to be a Tensor or a list, got float"),
    (lambda: G.Boxes.from_tensor(BOX[0, 0]), ValueError, r"expected boxes of shape \(N, 4\) or \(B, N, 4\) in mode 'xyxy'"),
    (lambda: G.Boxes.from_tensor(-BOX), ValueError, "Boxes: expected boxes of positive size"),
    (lambda: G.Boxes.from_tensor(BOX / 0), ValueError, "Boxes: expected boxes that are finite"),
    (lambda: G.Boxes.from_tensor(BOX).to_tensor("xy"), ValueError, "mode must be one of"),
    (lambda: G.Boxes.from_tensor(BOX).to_mask(0, 3), ValueError, "Boxes.to_mask: expected height"),
    (lambda: G.Boxes.from_tensor(BOX).transform_boxes(torch.eye(4)), ValueError, r"expected M of shape \(\*, 3, 3\)"),
    (lambda: G.Boxes.from_tensor(BOX).transform_boxes(torch.eye(3).expand(3, 3, 3)), ValueError, r"\(3, 3\) or \(2, 3, 3\)"),
    (lambda: G.Boxes.from_tensor(BOX).translate(torch.ones(3, 2)), ValueError, "translate: expected size with 1 or 2 rows"),
    (lambda: G.Boxes.from_tensor(BOX).translate(torch.ones(2, 2), "slow"), ValueError, "translate: method must be one of"),
    (lambda: G.Boxes.from_tensor(BOX).pad(torch.ones(2, 2)), ValueError, r"Boxes.pad: expected padding_size of shape \(B, 4\)"),
    (lambda: G.Boxes.from_tensor(BOX).merge(BOX), TypeError, "Boxes.merge: expected boxes to be Boxes, got Tensor"),
    (lambda: G.Boxes.from_tensor(BOX).merge(G.Boxes.from_tensor(BOX[:1])), ValueError, "merge: expected boxes of as many images"),
    (lambda: G.Boxes.from_tensor(BOX).to(dtype=torch.int32), TypeError, "Boxes.to: expected dtype to be floating point"),
    (lambda: G.VideoBoxes.from_tensor(torch.ones(2, 3, 4, 2)), ValueError, r"VideoBoxes: .* \(B, T, N, 4, 2\)"),
    (lambda: G.Boxes3D.from_tensor(BOX), ValueError, r"Boxes3D: expected boxes of shape \(\*, 6\)"),
    (lambda: G.Keypoints(torch.ones(3)), ValueError, r"Keypoints: expected keypoints of shape \(\*, 2\)"),
    (lambda: G.bbox_generator(*torch.ones(3), torch.ones(1).int()), TypeError, "bbox_generator: expected tensors of one type"),
    (lambda: G.bbox_to_mask(BOX, 3, 4), ValueError, r"bbox_to_mask: expected boxes of shape \(B, 4, 2\)"),
    (lambda: G.transform_bbox(torch.eye(3), BOX), ValueError, r"transform_bbox: expected trans_mat of shape \(B, 3, 3\)"),
    (lambda: G.transform_bbox(torch.eye(3)[None], BOX[..., :3]), ValueError, r"of shape \(N, 4\), \(B, N, 4\) or"),
    (lambda: G.transform_bbox(torch.eye(3).expand(3, 3, 3), BOX), ValueError, "trans_mat with 1 or 2 matrices"),
    (lambda: G.nms(BOX[0], torch.ones(3), 0.5), ValueError, r"nms: expected scores of shape \(5,\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
